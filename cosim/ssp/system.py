"""Systems of FMUs from SSP packages, simulated as they are, with no estimator."""

from pathlib import Path

from .package import SystemStructure
from .run import SystemRun, simulate
from .settings import settings_of


class System(SystemStructure):
    """A system of FMUs that can be simulated.

    System.from_ssp(Path("drive.ssp")).simulate(stop_time=10.0, step_size=0.01)["plant.phi"]
    """

    def simulate(
        self, stop_time: float | None = None, step_size: float | None = None, out: Path | None = None
    ) -> SystemRun:
        """Step all FMUs in parallel, with no estimator, and record their outputs. Times in s.

        Raises SspError where neither the package nor the arguments say how long and in what steps, WiringError,
        SlaveError where an FMU cannot be loaded or initialised: there is no row then.
        """
        given = {"stop_time": stop_time, "macro_step": step_size}
        run = simulate(self, settings_of(self, {k: v for k, v in given.items() if v is not None}), out)
        if run.fault is not None and not len(run.time):
            raise run.fault
        return run
