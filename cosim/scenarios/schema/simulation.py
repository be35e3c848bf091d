"""Tables of a scenario file on the co-simulation: times and steps, components, limits of a run."""

from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, model_validator

from ...errors import one_line
from .table import MOST, StartValue, Table

_MOST_STEPS: Final = 1e9
MOST_COMPONENTS: Final = 64
"""FMUs that are started without being asked for."""


class SimulationSettings(Table):
    """Times, steps and coupling of the co-simulation, and the treatment of its FMUs."""

    name: str = Field(min_length=1, max_length=100, pattern=r"^[A-Za-z0-9_-]+$")
    """Name of the scenario, and of its run folders."""
    description: str = ""
    """One line for the report."""
    start_time: float = 0.0
    """Time of the first communication point [s]."""
    stop_time: float
    """Time of the last communication point [s], after start_time; as in FMI, either may be negative."""
    macro_step: float = Field(gt=0.0)
    """Time from one communication point to the next [s]."""
    coupling: Literal["sequential", "parallel"] = "sequential"
    """Sequential: controllers step first, and the others use their outputs at once. Parallel: all step together."""
    isolation: Literal["process", "none"] = "process"
    """Each FMU in a process of its own, or all of them in this process."""
    timeout: float = Field(default=10.0, ge=0.001, le=MOST)
    """Longest time that one call of an FMU may take [s], at least 1 ms."""
    checkpoint: int = Field(default=500, ge=0, le=MOST)
    """Communication points from one checkpoint of a run folder to the next, for `retune resume`; 0: none."""
    memory_limit: float = Field(default=0.0, ge=0.0)
    """Memory that the process of one FMU may hold [MB]; 0: half of the machine's memory. Linux only."""
    environment: tuple[Annotated[str, Field(pattern=r"^[^=]+$")], ...] = ()
    """Environment variables that the FMUs' processes are given beside PATH and the like; `*` for any text."""
    most_components: int = Field(default=MOST_COMPONENTS, ge=1, le=1000)
    """Most FMUs that are started, each in a process of its own."""
    out_of_range: Literal["fault", "warning"] = "fault"
    """Treatment of an input or output outside its declared min and max; one that is not finite is always a fault."""

    @model_validator(mode="after")
    def _spans_whole_steps(self) -> Self:
        steps = (self.stop_time - self.start_time) / self.macro_step
        if self.stop_time <= self.start_time:
            raise ValueError(f"stop_time, {self.stop_time:g} s, must be after start_time, {self.start_time:g} s")
        if steps >= _MOST_STEPS:
            raise ValueError(f"it spans {steps:.3g} steps of macro_step: fewer than {_MOST_STEPS:g} can be made")
        if steps < 1.0 - 1e-6 or abs(steps - round(steps)) > 1e-6 * max(1.0, steps):
            raise ValueError(
                f"stop_time - start_time must be a whole multiple of macro_step, "
                f"got {self.stop_time - self.start_time:g} s and {self.macro_step:g} s"
            )
        return self

    def check_size(self, n_fmus: int) -> None:
        """Raise ValueError where there are more FMUs than shall be started."""
        if n_fmus > self.most_components:
            more = f"scenario.most_components is {self.most_components}: give --set scenario.most_components={n_fmus}"
            raise ValueError(f"it has {n_fmus} FMUs, each in a process of its own, and {more}")

    @property
    def title(self) -> str:
        """Name and description, on one line that can be printed."""
        return one_line(f"{self.name}: {self.description}" if self.description else self.name)

    @property
    def slave_options(self) -> dict[str, Any]:
        """Keyword arguments of open_slave."""
        return self.model_dump(include={"isolation", "timeout", "memory_limit", "environment", "out_of_range"})

    @property
    def n_steps(self) -> int:
        """Number of macro steps."""
        return round((self.stop_time - self.start_time) / self.macro_step)

    def time(self, k: int) -> float:
        """Return the time of communication point k [s]: a product, so that rounding does not add up."""
        return self.start_time + k * self.macro_step


class ComponentSettings(Table):
    """One FMU, or a CSV file that is played back."""

    fmu: str | None = Field(default=None, min_length=1)
    """Name of a built-in FMU, or a path to a file, relative to the scenario's."""
    fmi: Literal[2, 3] = 2
    """FMI version of a built-in FMU; a file says its own."""
    table: str | None = Field(default=None, pattern=r"\.[cC][sS][vV]$")
    """Instead of an FMU: path of a CSV file whose columns are played back over time."""
    start: dict[str, StartValue] = {}
    """Start values set before initialisation."""
    tolerance: float | None = Field(default=None, gt=0.0, allow_inf_nan=False)
    """Relative tolerance for the FMU's own solver; without it that of the FMU's default experiment, if any."""

    @model_validator(mode="after")
    def _is_one_of_them(self) -> Self:
        if (self.fmu is None) == (self.table is None):
            raise ValueError("must have either 'fmu' or 'table'")
        if self.fmu and self.fmu.lower().endswith(".csv"):
            raise ValueError(f"fmu: must be an FMU; a table is played back by table = '{self.fmu}'")
        if self.table and (self.start or self.tolerance):
            raise ValueError("a table takes no start values, and no tolerance")
        return self

    @property
    def file(self) -> str:
        """Its FMU or table."""
        return self.fmu or self.table or ""

    @property
    def file_key(self) -> str:
        """Key that names its file."""
        return "table" if self.fmu is None else "fmu"


class RunLimits(Table):
    """Limits at which a run is stopped."""

    divergence: float = Field(default=100.0, gt=0.0)
    """A tracked error above this ends the run as diverged, in the tracked output's unit."""
