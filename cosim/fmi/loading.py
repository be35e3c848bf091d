"""Loading an FMU into this process: one class for each FMI version and interface, all of them a `Binding`."""

from .binding import Binding, FmuToLoad
from .fmu_log import LogListener


def load(fmu: FmuToLoad, on_log: LogListener | None = None) -> Binding:
    """Load and instantiate an FMU; on_log is called with each message that it logs. Raises SlaveError."""
    # What an FMU's process does not need it does not import.
    if fmu.interface == "model-exchange":
        from .integrated_model import IntegratedModel

        return IntegratedModel(fmu, on_log)
    if fmu.interface == "derivatives":
        from .derivative_function import DerivativeFunction

        return DerivativeFunction(fmu, on_log)
    if fmu.fmi_version == "2.0":
        from .fmi2_co_simulation import Fmi2CoSimulation

        return Fmi2CoSimulation(fmu, on_log)
    if fmu.has_event_mode:
        from .fmi3_event_mode import Fmi3EventMode

        return Fmi3EventMode(fmu, on_log)
    from .fmi3_co_simulation import Fmi3CoSimulation

    return Fmi3CoSimulation(fmu, on_log)
