"""Where an FMU lives: in a process of its own (a Worker), or in this one."""

from collections.abc import Sequence
from typing import Any, Protocol

from ..fmi.bindings import load
from ..fmi.block import Variable
from ..fmi.instance import Identity
from ..fmi.many_steps import take_steps


class Home(Protocol):
    """Where an Instance lives: a Worker or SameProcess."""

    def bind(self, inputs: Sequence[Variable], tunables: Sequence[Variable], outputs: Sequence[Variable]) -> None: ...
    def call(self, function: str, t: float | None, *arguments: object) -> Any: ...
    def begin_step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> None: ...
    def end_step(self, t: float) -> tuple[float, ...]: ...
    def close(self, t: float | None, is_polite: bool) -> None: ...


class SameProcess:
    """An Instance in this process: a call that hangs is waited for, and a crash ends this process."""

    def __init__(self, identity: Identity) -> None:
        self._identity = identity
        self._instance = load(identity)

    def bind(self, inputs: Sequence[Variable], tunables: Sequence[Variable], outputs: Sequence[Variable]) -> None:
        self._instance.bind(inputs, tunables, outputs)

    def call(self, function: str, t: float | None, *arguments: object) -> Any:
        if function == "restart":
            self._instance.close()
            self._instance = load(self._identity)
            return None
        if function == "many_steps" and isinstance(arguments[0], bytes):
            return take_steps(self._instance.step, arguments[0])
        return getattr(self._instance, function)(*arguments)

    def begin_step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> None:
        self._step = (t, h, tuple(inputs), None if tunables is None else tuple(tunables))

    def end_step(self, t: float) -> tuple[float, ...]:
        return self._instance.step(*self._step)

    def close(self, t: float | None, is_polite: bool) -> None:
        if is_polite:
            self._instance.close()
