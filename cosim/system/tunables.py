"""Tunable parameters at a communication point: those of FMUs where one has changed are set, and read back."""

from collections.abc import Mapping, Sequence
from math import isclose
from typing import Final

from ..errors import ScenarioError
from ..variable_name import VariableName

_READ_BACK: Final = 1e-6
"""Relative tolerance of a value read back: an FMU may hold single precision."""
_SMALLEST: Final = 1.2e-38
"""Smallest normal number of single precision: what is smaller may read back as 0."""


def is_taken(read: float, written: float) -> bool:
    """Return whether a value read back is the one that was written, as far as single precision holds it."""
    return isclose(read, written, rel_tol=_READ_BACK, abs_tol=_SMALLEST)


class TunableWriter:
    """Keeps the values set last, so that none is set twice."""

    def __init__(self, references: Sequence[VariableName]) -> None:
        """references: of the parameters, `component.variable`; a component's own in the order of its wiring."""
        self._places: dict[str, list[int]] = {}
        for i, reference in enumerate(references):
            self._places.setdefault(reference.component, []).append(i)
        self._written: dict[str, list[float]] = {}

    def changed(self, values: Sequence[float]) -> dict[str, list[float]]:
        """Return the values by component, of those components where one is new; values: of all references."""
        now = {name: [values[i] for i in places] for name, places in self._places.items()}
        changed = {name: v for name, v in now.items() if self._written.get(name) != v}
        self._written |= changed
        return changed


class ReadBackCheck:
    """Check that FMUs have taken the parameters set in a step, by their values among the outputs after it.

    An FMU that stores a parameter and does not use it passes.
    """

    def __init__(self, references: Sequence[VariableName], names: Sequence[str]) -> None:
        """references: of the parameters, a component's first ones in the order of its wiring; names: of all outputs."""
        place = {name: i for i, name in enumerate(names)}
        self._places: dict[str, list[tuple[str, int]]] = {}
        for reference in references:
            self._places.setdefault(reference.component, []).append((reference, place[reference]))

    def check(self, written: Mapping[str, Sequence[float]], values: Sequence[float]) -> None:
        """Raise ScenarioError for a parameter that was not taken; written: by component; values: of all outputs."""
        for component, its in written.items():
            for (name, place), value in zip(self._places.get(component, ()), its, strict=False):
                read = values[place]
                if not is_taken(read, value):
                    text = f"{name} reads back as {read:.9g}, but {value:.9g} was set"
                    raise ScenarioError(f"{text}: the FMU does not take it")
