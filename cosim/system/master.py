"""The co-simulation master, which steps the FMUs and passes outputs to inputs. It knows nothing of tuning.

At each communication point the groups step one after another, the FMUs of a group at the same time. An input takes
the newest value of its source: of this point where the source's group has stepped already, else of the step before.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from ..errors import SlaveError, WiringError, told_at
from ..fmi.types import Value
from ..units import IDENTITY, Linear


class Steppable(Protocol):
    """Interface that the master needs of a slave; `cosim.slaves.slave.Slave` has it."""

    def bind(self, inputs: Sequence[str], tunables: Sequence[str], outputs: Sequence[str]) -> None: ...
    def initialize(self, start: Mapping[str, Value], start_time: float, stop_time: float | None) -> None: ...
    def enter_initialization(self, start: Mapping[str, Value], start_time: float, stop_time: float | None) -> None: ...
    def propagate(self, inputs: Sequence[float] | None) -> Sequence[float]: ...
    def exit_initialization(self) -> None: ...
    def get(self) -> Sequence[float]: ...
    def begin_step(self, inputs: Sequence[float], t: float, h: float, tunables: Sequence[float] | None) -> None: ...
    def end_step(self) -> Sequence[float]: ...


@dataclass(frozen=True)
class Wiring:
    """One FMU's part in the co-simulation."""

    sources: Mapping[str, str]
    """Source of each connected input, `component.output`."""
    tunables: tuple[str, ...]
    """Tunable parameters that are written while it runs."""
    outputs: tuple[str, ...]
    """Variables read at every communication point."""
    start: Mapping[str, Value]
    """Start values."""
    conversions: Mapping[str, Linear] = field(default_factory=dict[str, Linear])
    """Conversion from the source's unit to the input's, by input, where they differ."""
    disturbances: tuple[str, ...] = ()
    """Inputs that are not connected, but changed from outside: see `Master.disturb`."""


class Master:
    """Steps the FMUs. `values` holds the newest value of every output, in the order of `names`."""

    def __init__(
        self, slaves: Mapping[str, Steppable], wiring: Mapping[str, Wiring], groups: Sequence[Sequence[str]]
    ) -> None:
        self._slaves, self._wiring, self._groups = slaves, wiring, groups
        self.names = tuple(f"{name}.{output}" for name, w in wiring.items() for output in w.outputs)
        self.values = [0.0] * len(self.names)
        self.inputs: dict[str, dict[str, float]] = {}
        """Values of each FMU's connected inputs in its last step, by name."""
        self.offsets: dict[str, Sequence[float]] = {}
        """Values added to all connected inputs of an FMU, by its name."""
        place = {name: i for i, name in enumerate(self.names)}
        for name, w in wiring.items():
            unknown = next((source for source in w.sources.values() if source not in place), None)
            if unknown:
                raise WiringError(f"{name}: no output '{unknown}' to take an input from.")
        self._sources = {
            name: [(place[source], w.conversions.get(target, IDENTITY)) for target, source in w.sources.items()]
            for name, w in wiring.items()
        }
        self._disturbances = {
            name: [float(w.start.get(own, 0.0)) for own in w.disturbances] for name, w in wiring.items()
        }
        self._first = {name: place[f"{name}.{w.outputs[0]}"] if w.outputs else 0 for name, w in wiring.items()}

    def initialize(self, start_time: float, stop_time: float, is_propagated: bool = False) -> None:
        """Bind and initialise every FMU, and read its outputs at start_time [s]. Raises WiringError, SlaveError.

        is_propagated: in initialization mode inputs take their sources' initial outputs, in as many rounds as there
        are FMUs, as libcosim does; otherwise they keep their start values until the first step.
        """
        for name, slave in self._slaves.items():
            w = self._wiring[name]
            slave.bind((*w.sources, *w.disturbances), w.tunables, w.outputs)
        for name, slave in self._slaves.items():
            start = slave.enter_initialization if is_propagated else slave.initialize
            with told_at(f"components.{name}.start"):
                try:
                    start(self._wiring[name].start, start_time, stop_time)
                except SlaveError as fault:
                    if fault.function == "set":  # refused before it reached the FMU
                        raise WiringError(f"{fault.reason}.") from fault
                    raise
        if is_propagated:
            self._propagate()
        for name, slave in self._slaves.items():
            self._take(name, slave.get())

    def disturb(self, values: Mapping[str, Sequence[float]]) -> None:
        """Set disturbances from the next step on; values: of each FMU that has any, in the order of its wiring."""
        for name, its in values.items():
            self._disturbances[name][:] = its

    def begin(self, t: float, h: float, tunables: Mapping[str, Sequence[float]]) -> None:
        """Step every group but the last from t [s] by h [s]; then `values` all belong to t.

        tunables: values for those FMUs whose parameters change now, in the order of their wiring. Raises SlaveError.
        """
        for group in self._groups[:-1]:
            self._step(group, t, h, tunables)

    def finish(self, t: float, h: float, tunables: Mapping[str, Sequence[float]]) -> None:
        """Step the last group; then its `values` belong to t + h. Raises SlaveError."""
        self._step(self._groups[-1], t, h, tunables)

    def _propagate(self) -> None:
        for name, slave in self._slaves.items():
            self._take(name, slave.propagate(None))
        for _ in self._slaves:
            inputs = {name: [*self._inputs(name), *self._disturbances[name]] for name in self._slaves}
            for name, slave in self._slaves.items():
                self._take(name, slave.propagate(inputs[name]))
        for slave in self._slaves.values():
            slave.exit_initialization()

    def _step(self, group: Sequence[str], t: float, h: float, tunables: Mapping[str, Sequence[float]]) -> None:
        for name in group:
            inputs = self._inputs(name)
            self.inputs[name] = dict(zip(self._wiring[name].sources, inputs, strict=True))
            self._slaves[name].begin_step([*inputs, *self._disturbances[name]], t, h, tunables.get(name))
        for name in group:
            self._take(name, self._slaves[name].end_step())

    def _inputs(self, name: str) -> list[float]:
        values = self.values
        inputs = [values[i] if to is IDENTITY else to(values[i]) for i, to in self._sources[name]]
        offsets = self.offsets.get(name)
        return inputs if offsets is None else [u + d for u, d in zip(inputs, offsets, strict=True)]

    def _take(self, name: str, outputs: Sequence[float]) -> None:
        first = self._first[name]
        self.values[first : first + len(outputs)] = outputs
