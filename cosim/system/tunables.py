"""Selection of the tunable parameters to set at a communication point: those of FMUs where one has changed."""

from collections.abc import Sequence

from ..variable_name import VariableName


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
