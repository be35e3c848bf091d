"""The closed loop of shadows: FMUs that are set to saved states, and simulated from there."""

from collections.abc import Mapping, Sequence
from math import hypot, inf, isclose
from typing import Any, Final, NamedTuple, Protocol

from ..errors import SlaveError
from ..slaves.slave import Slave
from ..variable_name import VariableName
from .master import Master, Steppable, Wiring

_ROUNDING: Final = 1e-9


class Course(NamedTuple):
    """The steps that are simulated, and what is written before the first of them."""

    times: Sequence[float]
    """Communication points [s], the end of the last step not among them."""
    macro_step: float
    """Length of each step [s]."""
    tunables: Mapping[str, Sequence[float]]
    """Values of the tunables of each FMU that has any, in the order of its wiring."""
    offsets: Mapping[str, Sequence[float]]
    """Values added to all connected inputs of an FMU, by its name."""
    limit: float
    """Tracking error above which the loop has diverged."""


class Shadows(Protocol):
    """Interface of a closed loop of shadows, in this process (`ShadowLoop`) or in another (`LoopProcess`).

    Every method raises SlaveError; after that only close may be called.
    """

    def prove(self) -> None:
        """Save and restore the state of every FMU once: one that declares that it can may fail."""
        ...

    def restore(self, states: Mapping[str, Any], values: Sequence[float]) -> None:
        """Go to these states, by FMU, at which all outputs of the loop are values."""
        ...

    def peak(self, course: Course) -> float:
        """Return the largest norm of the tracking error on the way; infinite where it diverges."""
        ...

    def close(self) -> None:
        """Close the FMUs; idempotent."""
        ...


class ShadowLoop:
    """A closed loop of slaves in this process, which somebody else closes."""

    def __init__(
        self,
        shadows: Mapping[str, Steppable],
        wiring: Mapping[str, Wiring],
        groups: Sequence[Sequence[str]],
        tracked: Sequence[tuple[str, str]],
        span: tuple[float, float],
    ) -> None:
        """tracked: pairs of outputs that shall be equal; span: start and stop time [s].

        Raises WiringError, SlaveError.
        """
        self._shadows, self._master = shadows, Master(shadows, wiring, groups)
        place = {name: i for i, name in enumerate(self._master.names)}
        self._tracked = [(place[a], place[b]) for a, b in tracked]
        self._master.initialize(*span)

    def prove(self) -> None:
        """Save and restore the state of every FMU once."""
        for shadow in self._shadows.values():
            if isinstance(shadow, Slave):
                shadow.set_state(shadow.get_state())

    def restore(self, states: Mapping[str, Any], values: Sequence[float]) -> None:
        """Go to these states, by FMU; raise SlaveError where one then has other outputs than values."""
        for name, state in states.items():
            shadow: Any = self._shadows[name]
            shadow.set_state(state)
            if isinstance(shadow, Slave) and not _same(shadow.get(), self._outputs(values, name)):
                raise SlaveError(shadow.name, "set_state", None, "leads to other outputs than those of the run")
        self._master.values[:] = values

    def peak(self, course: Course) -> float:
        """Return the largest norm of the tracking error on the way; infinite where it diverges."""
        master, h = self._master, course.macro_step
        master.offsets = dict(course.offsets)
        tunables, largest = course.tunables, 0.0
        for t in course.times:
            master.begin(t, h, tunables)
            master.finish(t, h, tunables)
            tunables = {}
            errors = [master.values[a] - master.values[b] for a, b in self._tracked]
            if not all(abs(e) <= course.limit for e in errors):
                return inf
            largest = max(largest, hypot(*errors))
        return largest

    def close(self) -> None:
        """Do nothing: whoever opened the slaves closes them."""

    def _outputs(self, values: Sequence[float], name: str) -> list[float]:
        names = self._master.names
        return [v for v, n in zip(values, names, strict=True) if VariableName(n).component == name]


def _same(found: Sequence[float], expected: Sequence[float]) -> bool:
    """Return whether outputs agree, up to rounding where an FMU computes them again."""
    pairs = zip(found, expected, strict=True)
    return all(isclose(a, b, rel_tol=_ROUNDING, abs_tol=_ROUNDING) for a, b in pairs)
