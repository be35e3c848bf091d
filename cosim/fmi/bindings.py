"""Which class loads an FMU: one for each FMI version and interface, all with the methods of instance.Instance."""

from collections.abc import Sequence
from typing import Protocol

from .block import Value, Variable
from .fmu_log import Hear
from .instance import Identity, Instance


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
        from .instance3 import Instance3

        return Instance3(identity, hear)
    if identity.binding == "fmi3-exchange":
        from .exchange3 import Exchange3

        return Exchange3(identity, hear)
    if identity.binding == "fmi2-exchange":
        from .exchange2 import Exchange2

        return Exchange2(identity, hear)
    return Instance(identity, hear)
