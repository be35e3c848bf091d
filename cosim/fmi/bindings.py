"""Which class loads an FMU: one for each FMI version and interface, all with the methods of instance.Instance."""

from collections.abc import Sequence
from typing import Protocol

from .fmi2_co_simulation import Identity, Instance
from .fmu_log import Hear
from .value_buffers import Value, Variable


class Binding(Protocol):
    """What Instance does, whichever FMI version is behind it."""

    def bind(self, inputs: Sequence[Variable], tunables: Sequence[Variable], outputs: Sequence[Variable]) -> None: ...
    def initialize(
        self, start: Sequence[tuple[str, str, int, Value]], start_time: float, stop_time: float | None
    ) -> None: ...
    def step(
        self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None
    ) -> tuple[float, ...]: ...
    def close(self) -> None: ...


def load(identity: Identity, hear: Hear | None = None) -> Binding:
    """The FMU, loaded and instantiated; hear gets what it logs. Raises SlaveError."""
    if identity.binding == "fmi3":
        from .fmi3_co_simulation import Instance3

        return Instance3(identity, hear)
    if identity.binding == "fmi3-exchange":
        from .fmi3_model_exchange import Exchange3

        return Exchange3(identity, hear)
    if identity.binding == "fmi2-exchange":
        from .fmi2_model_exchange import Exchange2

        return Exchange2(identity, hear)
    return Instance(identity, hear)
