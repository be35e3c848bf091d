"""Hosts of an FMU's code: a process of its own (`FmuProcess`), or this one, where it is trusted."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol

from ..fmi.binding import Binding, FmuToLoad
from ..fmi.fmu_log import log_message
from ..fmi.loading import load
from ..fmi.renewal import Renewal
from ..fmi.step_batch import take_steps
from ..fmi.trial_batch import take_trials
from ..fmi.value_buffers import ScalarVariable


class Host(Protocol):
    """A caller of an FMU's binding on behalf of a Slave: FmuProcess or InProcessFmu."""

    def bind(
        self, inputs: Sequence[ScalarVariable], tunables: Sequence[ScalarVariable], outputs: Sequence[ScalarVariable]
    ) -> None: ...
    def call(self, function: str, t: float | None, *arguments: object) -> Any: ...
    def begin_step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> None: ...
    def end_step(self, t: float) -> tuple[float, ...]: ...
    def close(self, t: float | None, is_polite: bool) -> None: ...


class InProcessFmu:
    """An FMU that runs in this process: a call that hangs blocks it, and a crash ends it."""

    def __init__(self, fmu: FmuToLoad, after_call: Callable[[], None] | None = None) -> None:
        """after_call: called after each call of the FMU."""
        self._after_call = after_call or (lambda: None)
        self._load = partial(load, fmu, partial(log_message, fmu.instance_name))
        self._binding = self._load()
        self._renewal = Renewal(self._renewed)

    def bind(
        self, inputs: Sequence[ScalarVariable], tunables: Sequence[ScalarVariable], outputs: Sequence[ScalarVariable]
    ) -> None:
        self._bound = (inputs, tunables, outputs)
        self._binding.bind(*self._bound)
        self._after_call()

    def call(self, function: str, t: float | None, *arguments: Any) -> Any:
        if function == "restart":
            self._binding.close()
            self._binding = self._load()
            return None
        if function == "many_steps":
            return take_steps(self._binding.step, *arguments)
        if function == "trials":
            return take_trials(self._binding, self._renewal, *arguments)
        result = getattr(self._binding, function)(*arguments)
        self._after_call()
        return result

    def _renewed(self) -> Binding:
        self._binding.close()
        self._binding = self._load()
        self._binding.bind(*self._bound)
        return self._binding

    def begin_step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> None:
        self._step = (t, h, tuple(inputs), None if tunables is None else tuple(tunables))

    def end_step(self, t: float) -> tuple[float, ...]:
        values = self._binding.step(*self._step)
        self._after_call()
        return values

    def close(self, t: float | None, is_polite: bool) -> None:
        if is_polite:  # one that has failed is not called again: a PythonFMU one that raised has damaged its memory
            self._binding.close()
