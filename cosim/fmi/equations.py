"""The equations of a model-exchange FMU of either version, and the event mode that both have."""

from collections.abc import Sequence
from typing import Any, Protocol

from ..errors import SlaveError
from .binding import FmuToLoad, StartValues
from .fmu_log import LogListener
from .held_values import MOST_EVENTS
from .value_buffers import ScalarVariable


class Equations(Protocol):
    """The calls that integrate one model, or evaluate it; arrays are ctypes' of doubles."""

    name: str
    n_states: int
    n_indicators: int
    has_step_events: bool

    @property
    def time(self) -> float | None: ...
    def bind(
        self, inputs: Sequence[ScalarVariable], tunables: Sequence[ScalarVariable], outputs: Sequence[ScalarVariable]
    ) -> None: ...
    def enter_initialization(self, start: StartValues, start_time: float, stop_time: float | None) -> None: ...
    def exit_initialization(self) -> None: ...
    def set_inputs(self, values: Sequence[float]) -> None: ...
    def set_tunables(self, values: Sequence[float]) -> None: ...
    def outputs(self) -> tuple[float, ...]: ...
    def enter_event_mode(self) -> None: ...
    def update_discrete_states(self) -> tuple[bool, bool, float | None]: ...
    def enter_continuous_time_mode(self) -> None: ...
    def set_time(self, t: float) -> None: ...
    def set_states(self, x: Any) -> None: ...
    def get_states(self, x: Any) -> None: ...
    def get_rates(self, rates: Any, *, may_discard: bool = True) -> bool: ...
    def get_indicators(self, z: Any) -> bool: ...
    def get_nominals(self, nominals: Any) -> None: ...
    def completed_step(self) -> tuple[bool, bool]: ...
    def get_state(self) -> bytes | int: ...
    def set_state(self, serialised: bytes) -> None: ...
    def state_places(self) -> dict[int, int]: ...
    def slope(self, parameter: int) -> list[float]: ...
    def close(self) -> None: ...
    def clear_log(self) -> None: ...


def equations_of(fmu: FmuToLoad, on_log: LogListener | None) -> Equations:
    """Load and instantiate a model-exchange FMU. Raises SlaveError."""
    if fmu.fmi_version == "2.0":  # what an FMU's process does not need it does not import
        from .fmi2_equations import Fmi2Equations

        return Fmi2Equations(fmu, on_log)
    from .fmi3_equations import Fmi3Equations

    return Fmi3Equations(fmu, on_log)


def leave_event_mode(model: Equations) -> float | None:
    """Update the discrete states until they have settled, and enter continuous-time mode; return the next event's time.

    Raises SlaveError where they do not settle, or the FMU asks to end the simulation.
    """
    for _ in range(MOST_EVENTS):
        is_unsettled, is_over, t = model.update_discrete_states()
        if is_over:
            raise fault(model, "update_discrete_states", "asked to end the simulation")
        if not is_unsettled:
            model.enter_continuous_time_mode()
            return t
    raise fault(model, "update_discrete_states", f"has not ended after {MOST_EVENTS} calls")


def fault(model: Equations, function: str, reason: str) -> SlaveError:
    """Return the error of a call that an FMU has failed in."""
    return SlaveError(model.name, function, model.time, reason)
