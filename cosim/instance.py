"""An FMI 2.0 co-simulation FMU loaded into this process.

Instance is the only place that knows FMI 2.0's calls. Its methods and their arguments name no FMI version: an
FMI 3.0 instance is a second class with the same methods.
"""

import ctypes
import math
import os
import struct
from collections.abc import Sequence
from ctypes import byref, c_double, c_int, c_size_t, c_uint, c_void_p
from typing import Any, Final, NamedTuple, TypeAlias

import fmpy
from fmpy import fmi1, fmi2

from .errors import SlaveError, one_line

STATUS: Final = ("ok", "warning", "discard", "error", "fatal", "pending")
_WARNING: Final = 1
_UNFILLED: Final = -(2**31)  # what an Integer or Boolean that a get left alone reads as; reported as NaN

Value: TypeAlias = float | int | bool | str


class Variable(NamedTuple):
    """A scalar variable of a model description, as far as calls need it."""

    name: str
    type: str
    """'Real', 'Integer', 'Boolean' or 'String'; an enumeration is an Integer."""
    reference: int
    """The value reference."""


class Identity(NamedTuple):
    """Which FMU to load, and how."""

    folder: str
    """Where the FMU is unpacked."""
    model_identifier: str
    guid: str
    instance_name: str
    has_plain_log: bool
    """Log texts are not formats with arguments; see MessageLog."""


class MessageLog:
    """The FMU's gravest log message, and of equals the newest, since the last clear.

    FMI's logger is variadic; FMPy's native proxy formats the message. PythonFMU however passes the model's own text as
    the format and never arguments, so that a "%s" in it would read random memory: its texts are taken as they are.
    """

    _open: "dict[int, MessageLog]" = {}

    def __init__(self, has_plain_text: bool) -> None:
        self.text = ""
        self._status = -1
        self._has_plain_text = has_plain_text
        self._open[id(self)] = self
        self.callbacks = fmi2.fmi2CallbackFunctions()
        self.callbacks.logger = _LOGGER
        self.callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        self.callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
        self.callbacks.componentEnvironment = id(self)
        if not has_plain_text:
            from fmpy.logging import addLoggerProxy

            addLoggerProxy(byref(self.callbacks))

    def add(self, status: int, message: bytes) -> None:
        if status >= self._status:
            text = message.decode("utf-8", "replace")
            self.text = text.replace("%%", "%") if self._has_plain_text else text
            self._status = status

    def clear(self) -> None:
        self.text, self._status = "", -1

    def close(self) -> None:
        self._open.pop(id(self), None)

    def reason(self) -> str:
        """The message in one line: of a Python traceback its last line, of a PythonFMU exception the exception."""
        lines = [line.strip() for line in self.text.splitlines() if line.strip()]
        if any(line.startswith("Traceback (most recent call last)") for line in lines):
            lines = lines[-1:]
        elif len(lines) > 1 and lines[0].startswith("Fatal py exception encountered"):
            lines = lines[1:]
        return one_line(" ".join(lines))


def _receive_message(environment: int | None, instance: bytes, status: int, category: bytes, message: bytes) -> None:
    log = MessageLog._open.get(environment or 0)  # pyright: ignore[reportPrivateUsage]
    if log is not None:
        log.add(status, message or b"")
    else:  # the proxy is one for the whole process: an FMU that somebody else runs through FMPy
        fmi1.printLogMessage(c_void_p(environment), instance, status, category, message)


_LOGGER: Final = fmi2.fmi2CallbackLoggerTYPE(_receive_message)


class Block:
    """The variables of one type among those that are set or got together, in arrays that live as long as the FMU."""

    def __init__(self, kind: str, variables: Sequence[Variable], positions: Sequence[int]) -> None:
        self.getter, self.setter = f"get_{kind.lower()}", f"set_{kind.lower()}"
        self.is_real = kind == "Real"
        self.positions = tuple(positions)
        references = [variables[i][2] for i in positions]
        self._references = (c_uint * len(positions))(*references)
        self._values: Any = ((c_double if self.is_real else c_int) * len(positions))()
        self._pack = struct.Struct(f"{len(positions)}{'d' if self.is_real else 'i'}")
        self._memory = memoryview(self._values).cast("B")
        self._unfilled = self._pack.pack(*([math.nan if self.is_real else _UNFILLED] * len(positions)))
        self.arguments = (ctypes.addressof(self._references), len(positions), ctypes.addressof(self._values))

    def fill(self, values: Sequence[float]) -> None:
        """Put into the array what belongs to this block among all the values that are set together."""
        if not self.is_real:
            values = [int(values[i]) for i in self.positions]
        elif len(values) != len(self.positions):
            values = [values[i] for i in self.positions]
        self._pack.pack_into(self._values, 0, *values)

    def clear(self) -> None:
        """Mark every value as not filled."""
        self._memory[:] = self._unfilled

    def read(self) -> tuple[float, ...]:
        """The array's values; NaN where a get has filled nothing."""
        values = self._pack.unpack(self._memory)
        return values if self.is_real else tuple(math.nan if v == _UNFILLED else float(v) for v in values)


def blocks_of(variables: Sequence[Variable]) -> list[Block]:
    """variables grouped by type, each group in its order."""
    positions: dict[str, list[int]] = {}
    for i, variable in enumerate(variables):
        positions.setdefault(variable[1], []).append(i)
    return [Block(kind, variables, of_kind) for kind, of_kind in positions.items()]


class Instance:
    """One FMU, from loading to freeing.

    1. Instance(identity)   loads and instantiates
    2. bind                 says which variables will be set and got at communication points
    3. initialize           start values, initialization mode
    4. get, step, get_state, set_state
    5. close                terminates and frees

    Every call raises SlaveError when the FMU returns anything but OK and Warning; it must not be called afterwards.
    """

    def __init__(self, identity: Identity) -> None:
        self.name = identity.instance_name
        self._log = MessageLog(identity.has_plain_log)
        self._time: float | None = None
        self._forward_only = fmi2.fmi2True  # until a state is saved that may be gone back to
        self._inputs: list[Block] = []
        self._tunables: list[Block] = []
        self._outputs: list[Block] = []
        directory = os.getcwd()
        try:
            self._fmu = fmi2.FMU2Slave(
                guid=identity.guid,
                modelIdentifier=identity.model_identifier,
                unzipDirectory=identity.folder,
                instanceName=identity.instance_name,
            )
            self._fmu.instantiate(callbacks=self._log.callbacks, loggingOn=True)
        except Exception as error:  # FMPy raises nothing more special
            self._log.close()
            raise SlaveError(self.name, "instantiate", None, f"failed: {self._log.reason() or error}") from error
        finally:
            os.chdir(directory)  # FMPy stays in the FMU's folder when loading fails
        self._component = ctypes.cast(self._fmu.component, c_void_p)
        self._do_step = self._raw("fmi2DoStep", c_void_p, c_double, c_double, c_int)
        self._exchange = {
            name: self._raw(f"fmi2{name[:3].title()}{name[4:].title()}", c_void_p, c_void_p, c_size_t, c_void_p)
            for name in ("get_real", "get_integer", "get_boolean", "set_real", "set_integer", "set_boolean")
        }

    def bind(self, inputs: Sequence[Variable], tunables: Sequence[Variable], outputs: Sequence[Variable]) -> None:
        """Prepare the arrays for what is set and got at communication points: Real, Integer and Boolean."""
        self._inputs, self._tunables, self._outputs = blocks_of(inputs), blocks_of(tunables), blocks_of(outputs)

    def initialize(
        self, start: Sequence[tuple[str, str, int, Value]], start_time: float, stop_time: float | None
    ) -> None:
        """Set start values (name, type, value reference, value), go through initialization mode; times in s."""
        self._time = start_time
        fmu = self._fmu
        self._checked("setup_experiment", fmu.setupExperiment, None, start_time, stop_time)
        for kind in ("Real", "Integer", "Boolean", "String"):
            of_kind = [(reference, value) for _, its_kind, reference, value in start if its_kind == kind]
            if of_kind:
                references, values = zip(*of_kind, strict=True)
                self._checked(f"set_{kind.lower()}", getattr(fmu, f"set{kind}"), references, values)
        self._checked("enter_initialization_mode", fmu.enterInitializationMode)
        self._checked("exit_initialization_mode", fmu.exitInitializationMode)

    def step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> tuple[float, ...]:
        """Set tunables (if given) and inputs, step from t to t + h [s], get the outputs, all in bound order."""
        self._time = t
        self._log.clear()
        if tunables is not None:
            self._set(self._tunables, tunables)
        self._set(self._inputs, inputs)
        status = self._do_step(self._component, t, h, self._forward_only)
        if status > _WARNING:
            raise self._fault("do_step", status)
        self._time = t + h
        return self.get()

    def get(self) -> tuple[float, ...]:
        """The outputs in bound order; NaN for what the FMU did not fill."""
        for block in self._outputs:
            block.clear()
            status = self._exchange[block.getter](self._component, *block.arguments)
            if status > _WARNING:
                raise self._fault(block.getter, status)
        if len(self._outputs) == 1:
            return self._outputs[0].read()
        pairs = (pair for block in self._outputs for pair in zip(block.positions, block.read(), strict=True))
        return tuple(value for _, value in sorted(pairs))

    def get_state(self) -> bytes:
        """The FMU's state, serialised."""
        self._forward_only = fmi2.fmi2False
        state = self._checked("get_state", self._fmu.getFMUstate)
        serialised = self._checked("serialise_state", self._fmu.serializeFMUstate, state)
        self._checked("free_state", self._fmu.freeFMUstate, state)
        return serialised

    def set_state(self, serialised: bytes) -> None:
        """Go back to a state that get_state returned."""
        self._forward_only = fmi2.fmi2False
        state = self._checked("deserialise_state", self._fmu.deSerializeFMUstate, serialised)
        self._checked("set_state", self._fmu.setFMUstate, state)
        self._checked("free_state", self._fmu.freeFMUstate, state)

    def close(self) -> None:
        """Terminate, if it was initialized, and free."""
        if self._time is not None:
            self._checked("terminate", self._fmu.terminate)
        self._fmu.freeInstance()
        self._log.close()

    def _set(self, blocks: Sequence[Block], values: Sequence[float]) -> None:
        for block in blocks:
            block.fill(values)
            status = self._exchange[block.setter](self._component, *block.arguments)
            if status > _WARNING:
                raise self._fault(block.setter, status)

    def _raw(self, name: str, *arguments: Any) -> Any:
        """The FMU's C function without FMPy's checks, which cost a third of a step."""
        function = self._fmu.dll[name]  # a new object: FMPy's own keeps its argument types
        function.argtypes, function.restype = arguments, c_int
        return function

    def _checked(self, name: str, function: Any, *arguments: object) -> Any:
        self._log.clear()
        try:
            return function(*arguments)
        except fmi1.FMICallException as error:
            raise self._fault(name, error.status) from error

    def _fault(self, function: str, status: int) -> SlaveError:
        word = STATUS[status] if status < len(STATUS) else f"the illegal status {status}"
        reason = self._log.reason()
        return SlaveError(self.name, function, self._time, f"returned {word}{': ' if reason else ''}{reason}")
