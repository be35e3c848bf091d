"""Where an FMU's code runs: in a process of its own (`FmuProcess`), or in this one, where it is trusted."""

from collections.abc import Sequence
from functools import partial
from typing import Any, Protocol

from ..fmi.bindings import load
from ..fmi.fmi2_co_simulation import Identity
from ..fmi.fmu_log import pass_on
from ..fmi.step_batch import take_steps
from ..fmi.value_buffers import Variable


class Host(Protocol):
    """What calls an FMU's binding for a Slave: an FmuProcess or an InProcessFmu."""

    def bind(self, inputs: Sequence[Variable], tunables: Sequence[Variable], outputs: Sequence[Variable]) -> None: ...
    def call(self, function: str, t: float | None, *arguments: object) -> Any: ...
    def begin_step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> None: ...
    def end_step(self, t: float) -> tuple[float, ...]: ...
    def close(self, t: float | None, is_polite: bool) -> None: ...


class InProcessFmu:
    """An FMU that is trusted with this process: a call that hangs is waited for, and a crash ends this process."""

    def __init__(self, identity: Identity) -> None:
        self._load = partial(load, identity, partial(pass_on, identity.instance_name))
        self._binding = self._load()

    def bind(self, inputs: Sequence[Variable], tunables: Sequence[Variable], outputs: Sequence[Variable]) -> None:
        self._binding.bind(inputs, tunables, outputs)

    def call(self, function: str, t: float | None, *arguments: Any) -> Any:
        if function == "restart":
            self._binding.close()
            self._binding = self._load()
            return None
        if function == "many_steps":
            return take_steps(self._binding.step, *arguments)
        return getattr(self._binding, function)(*arguments)

    def begin_step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> None:
        self._step = (t, h, tuple(inputs), None if tunables is None else tuple(tunables))

    def end_step(self, t: float) -> tuple[float, ...]:
        return self._binding.step(*self._step)

    def close(self, t: float | None, is_polite: bool) -> None:
        if is_polite:  # one that has failed is not called again: a PythonFMU one that raised has damaged its memory
            self._binding.close()
