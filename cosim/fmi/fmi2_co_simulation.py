"""An FMI 2.0 co-simulation FMU loaded into this process.

Instance is the only place that knows FMI 2.0's calls. Its methods and their arguments name no FMI version: an
FMI 3.0 instance is a second class with the same methods.
"""

import os
from collections.abc import Callable, Sequence
from ctypes import byref, c_double, c_int, c_size_t, c_uint, c_void_p, cast
from functools import partial
from typing import Any, Final, NamedTuple, TypeAlias, TypeVar

from fmpy import fmi1, fmi2

from ..errors import SlaveError
from .fmu_log import Hear, MessageLog
from .value_buffers import Block, Value, Variable, blocks_of

STATUS: Final = ("ok", "warning", "discard", "error", "fatal", "pending")
LARGEST_STATE: Final = (1 << 28) - (1 << 12)
"""Bytes of a serialised state that is still saved: it must fit into one message between two processes."""
_WARNING: Final = 1
_Call: TypeAlias = Callable[[], int]
_Exchange: TypeAlias = tuple[Block, _Call]


class Identity(NamedTuple):
    """Which FMU to load, and how."""

    folder: str
    """Where the FMU is unpacked."""
    model_identifier: str
    guid: str
    instance_name: str
    has_plain_log: bool
    """Log texts are not formats with arguments; see MessageLog."""
    binding: str = "fmi2"
    """Which module's Instance loads it: see `load` in home."""


class Instance:
    """One FMU, from loading to freeing.

    1. Instance(identity)   loads and instantiates
    2. bind                 says which variables will be set and got at communication points
    3. initialize           start values, initialization mode
    4. get, step, get_state, set_state
    5. close                terminates and frees

    Every call raises SlaveError when the FMU returns anything but OK and Warning; it must not be called afterwards.
    """

    def __init__(self, identity: Identity, hear: Hear | None = None) -> None:
        """hear: gets what the FMU logs. Raises SlaveError."""
        self.name = identity.instance_name
        self._log = MessageLog(identity.has_plain_log, hear)
        self._time: float | None = None
        self._inputs: list[_Exchange] = []
        self._tunables: list[_Exchange] = []
        self._outputs: list[_Exchange] = []
        self._fmu = loaded(fmi2.FMU2Slave, identity, self._log)
        self._component = cast(self._fmu.component, c_void_p)
        self._t, self._h = c_double(), c_double()
        self._forward_only = c_int(fmi2.fmi2True)  # until a state is saved that may be gone back to
        self._do_step = self._raw("do_step", self._t, self._h, self._forward_only)

    def bind(self, inputs: Sequence[Variable], tunables: Sequence[Variable], outputs: Sequence[Variable]) -> None:
        """Prepare the arrays for what is set and got at communication points: Real, Integer and Boolean."""
        self._inputs = [(block, self._raw(block.setter, *block.arguments)) for block in blocks_of(inputs)]
        self._tunables = [(block, self._raw(block.setter, *block.arguments)) for block in blocks_of(tunables)]
        self._outputs = [(block, self._raw(block.getter, *block.arguments)) for block in blocks_of(outputs)]

    def initialize(
        self, start: Sequence[tuple[str, str, int, Value]], start_time: float, stop_time: float | None
    ) -> None:
        """Set start values (name, type, value reference, value), go through initialization mode; times in s."""
        self.enter_initialization(start, start_time, stop_time)
        self.exit_initialization()

    def enter_initialization(
        self, start: Sequence[tuple[str, str, int, Value]], start_time: float, stop_time: float | None
    ) -> None:
        """The first half of initialize."""
        self._time = start_time
        fmu = self._fmu
        self._checked("setup_experiment", fmu.setupExperiment, None, start_time, stop_time)
        for kind in ("Real", "Integer", "Boolean", "String"):
            of_kind = [(reference, value) for _, its_kind, reference, value in start if its_kind == kind]
            if of_kind:
                references, values = zip(*of_kind, strict=True)
                self._checked(f"set_{kind.lower()}", getattr(fmu, f"set{kind}"), references, values)
        self._checked("enter_initialization_mode", fmu.enterInitializationMode)

    def propagate(self, inputs: Sequence[float] | None) -> tuple[float, ...]:
        """In initialization mode: set the inputs, where given, and get the outputs. FMI 2.0.4, section 4.2.4."""
        if inputs is not None:
            self._set(self._inputs, inputs)
        return self.get()

    def exit_initialization(self) -> None:
        """The second half of initialize."""
        self._checked("exit_initialization_mode", self._fmu.exitInitializationMode)

    def step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> tuple[float, ...]:
        """Set tunables (if given) and inputs, step from t to t + h [s], get the outputs, all in bound order."""
        self._time = t
        self._log.clear()
        if tunables is not None:
            self._set(self._tunables, tunables)
        self._set(self._inputs, inputs)
        self._t.value, self._h.value = t, h
        status = self._do_step()
        if status > _WARNING:
            raise self._fault("do_step", status)
        self._time = t + h
        return self.get()

    def get(self) -> tuple[float, ...]:
        """The outputs in bound order; NaN for what the FMU did not fill."""
        for block, call in self._outputs:
            block.clear()
            status = call()
            if status > _WARNING:
                raise self._fault(block.getter, status)
        if len(self._outputs) == 1:
            return self._outputs[0][0].read()
        pairs = (pair for block, _ in self._outputs for pair in zip(block.positions, block.read(), strict=True))
        return tuple(value for _, value in sorted(pairs))

    def get_state(self) -> bytes | int:
        """The FMU's state, serialised; only its size where that is above LARGEST_STATE."""
        self._forward_only.value = fmi2.fmi2False
        state, size = self._checked("get_state", self._fmu.getFMUstate), c_size_t()
        self._checked("serialise_state", self._fmu.fmi2SerializedFMUstateSize, self._fmu.component, state, byref(size))
        saved: bytes | int = size.value
        if size.value <= LARGEST_STATE:
            saved = self._checked("serialise_state", self._fmu.serializeFMUstate, state)
        self._checked("free_state", self._fmu.freeFMUstate, state)
        return saved

    def set_state(self, serialised: bytes) -> None:
        """Go back to a state that get_state returned."""
        self._forward_only.value = fmi2.fmi2False
        state = self._checked("deserialise_state", self._fmu.deSerializeFMUstate, serialised)
        self._checked("set_state", self._fmu.setFMUstate, state)
        self._checked("free_state", self._fmu.freeFMUstate, state)

    def close(self) -> None:
        """Terminate, if it was initialized, and free."""
        if self._time is not None:
            self._checked("terminate", self._fmu.terminate)
        self._fmu.freeInstance()
        self._log.close()

    def _set(self, exchanges: Sequence[_Exchange], values: Sequence[float]) -> None:
        for block, call in exchanges:
            block.fill(values)
            status = call()
            if status > _WARNING:
                raise self._fault(block.setter, status)

    def _raw(self, name: str, *arguments: Any) -> _Call:
        """The FMU's C function of that name with its arguments, which must be ctypes objects.

        Without FMPy's checks, and with nothing to look up or convert: half the time of the call.
        """
        function = self._fmu.dll["fmi2" + name.title().replace("_", "")]  # a new object: FMPy's has argument types
        function.restype = c_uint  # a negative status is none either, and greater than a warning like this
        return partial(function, self._component, *arguments)

    def _checked(self, name: str, function: Any, *arguments: object) -> Any:
        return checked(self.name, name, self._time, self._log, function, *arguments)

    def _fault(self, function: str, status: int) -> SlaveError:
        return SlaveError(self.name, function, self._time, returned(status, self._log.reason()))


_Fmu = TypeVar("_Fmu", fmi2.FMU2Slave, fmi2.FMU2Model)


def loaded(kind: type[_Fmu], identity: Identity, log: MessageLog) -> _Fmu:
    """The FMU's library, loaded and instantiated. Raises SlaveError; the log is closed then."""
    directory = os.getcwd()
    try:
        fmu = kind(
            guid=identity.guid,
            modelIdentifier=identity.model_identifier,
            unzipDirectory=identity.folder,
            instanceName=identity.instance_name,
        )
        fmu.instantiate(callbacks=log.callbacks, loggingOn=True)
    except Exception as error:  # FMPy raises nothing more special
        log.close()
        reason = f"failed: {log.reason() or error}"
        raise SlaveError(identity.instance_name, "instantiate", None, reason) from error
    finally:
        os.chdir(directory)  # FMPy stays in the FMU's folder when loading fails
    return fmu


def checked(
    instance: str, name: str, t: float | None, log: MessageLog, function: Callable[..., Any], *arguments: object
) -> Any:
    """What a method of FMPy's returns. Raises SlaveError unless the FMU returns OK or Warning."""
    log.clear()
    try:
        result = function(*arguments)
        status = result if isinstance(result, int) and result < 0 else None  # none, and FMPy lets it pass
    except fmi1.FMICallException as error:
        raise SlaveError(instance, name, t, returned(error.status, log.reason())) from error
    if status is not None:
        raise SlaveError(instance, name, t, returned(status, log.reason()))
    return result


def returned(status: int, reason: str) -> str:
    """What a status other than OK and Warning means, in words, with the reason that was logged."""
    number = c_int(status).value
    word = STATUS[number] if 0 <= number < len(STATUS) else f"the illegal status {number}"
    return f"returned {word}{': ' if reason else ''}{reason}"
