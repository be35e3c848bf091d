"""Where an FMU lives: in a process of its own (a Worker), or in this one."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol

from ..fmi.bindings import load
from ..fmi.fmi2_co_simulation import Identity
from ..fmi.fmu_log import pass_on
from ..fmi.step_batch import take_steps
from ..fmi.value_buffers import Variable
from .exit_guard import ExitGuard
from .surroundings import FloatingPoint, kept, tell_changes


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
        self._name = identity.instance_name
        self._hear = partial(pass_on, self._name)
        self._floating_point = FloatingPoint()
        self._exits = ExitGuard(self._name)
        try:
            self._instance = self._guarded("instantiate", None, partial(load, identity, self._hear))
        except BaseException:
            self._exits.close()
            raise

    def bind(self, inputs: Sequence[Variable], tunables: Sequence[Variable], outputs: Sequence[Variable]) -> None:
        self._instance.bind(inputs, tunables, outputs)

    def call(self, function: str, t: float | None, *arguments: object) -> Any:
        if function == "restart":
            return self._guarded(function, t, self._restart)
        if function == "many_steps" and isinstance(arguments[0], bytes):
            return self._guarded(function, t, partial(take_steps, self._instance.step, arguments[0]))
        return self._guarded(function, t, getattr(self._instance, function), *arguments)

    def begin_step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> None:
        self._step = (t, h, tuple(inputs), None if tunables is None else tuple(tunables))

    def end_step(self, t: float) -> tuple[float, ...]:
        floating_point = self._floating_point
        floating_point.save()
        self._exits.inside = "do_step", self._step[0]
        try:
            return self._instance.step(*self._step)
        finally:
            self._exits.inside = None
            if floating_point.restore():
                tell_changes(self._name, ["the floating-point state"])

    def close(self, t: float | None, is_polite: bool) -> None:
        if is_polite:  # one that has failed is not called again: a PythonFMU one that raised has damaged its memory
            self._guarded("terminate", t, self._instance.close)
        self._exits.close()

    def _guarded(self, function: str, t: float | None, call: Callable[..., Any], *arguments: object) -> Any:
        self._exits.inside = function, t
        try:
            with kept(self._name):
                return call(*arguments)
        finally:
            self._exits.inside = None

    def _restart(self) -> None:
        self._instance.close()
        self._instance = load(self._identity, self._hear)
