"""An FMI 3.0 co-simulation FMU loaded into this process: instance.Instance's methods, for FMI 3.0's calls."""

import ctypes
import os
from collections.abc import Callable, Sequence
from ctypes import byref, c_bool, c_double, c_size_t, c_uint, c_void_p
from types import SimpleNamespace
from typing import Any

from fmpy import fmi3, read_model_description

from ..errors import SlaveError
from .fmi2_co_simulation import LARGEST_STATE, Identity, returned
from .fmu_log import Hear, Messages
from .value_buffers import Value, Variable
from .value_buffers3 import Block3, blocks3_of, overlaid, start_arrays

_WARNING = 1


class Fmi3:
    """What every interface of FMI 3.0 has in common: loading, and calls that are checked."""

    def __init__(self, identity: Identity, make: Callable[..., Any], hear: Hear | None = None) -> None:
        """make: FMPy's class for the interface; hear: gets what the FMU logs. Raises SlaveError."""
        self.name = identity.instance_name
        self.time: float | None = None
        self.log = Messages(hear)
        self.description = read_model_description(identity.folder, validate=False)
        self.start = start_arrays(self.description)
        self.fmu = self._load(identity, make)
        self.component = ctypes.cast(self.fmu.component, c_void_p)
        self._exchange: dict[str, Any] = {}

    def call(self, name: str, function: Any, *arguments: object) -> None:
        """Call a C function with the instance. Raises SlaveError unless it returns OK or Warning."""
        status = function(self.component, *arguments)
        if status > _WARNING:
            raise self.fault(name, status)

    def set(self, blocks: Sequence[Block3], values: Sequence[float]) -> None:
        """Set the variables of the blocks, whose values are given in bound order."""
        for block in blocks:
            block.fill(values)
            self.call(f"set_{block.setter[7:].lower()}", self._accessor(block.setter), *block.arguments)

    def get(self, blocks: Sequence[Block3]) -> tuple[float, ...]:
        """Values of the blocks' variables in bound order; NaN for what the FMU did not fill."""
        for block in blocks:
            block.clear()
            self.call(f"get_{block.getter[7:].lower()}", self._accessor(block.getter), *block.arguments)
        if len(blocks) == 1:
            return tuple(blocks[0].read())
        pairs = (pair for block in blocks for pair in zip(block.positions, block.read(), strict=True))
        return tuple(float(value) for _, value in sorted(pairs))

    def set_start(self, start: Sequence[tuple[str, str, int, Value]]) -> None:
        """Set start values (name, type, handle, value), whole arrays at a time, and remember them."""
        numbers = {number: float(value) for _, _, number, value in start if not isinstance(value, str)}
        self.start = overlaid(self.start, numbers)
        variables = [Variable(name, kind, number) for name, kind, number, value in start if not isinstance(value, str)]
        blocks = blocks3_of(variables, self.start)
        for block in blocks:
            block.start(self.start)
        self.set(blocks, list(numbers.values()))
        for _, _, number, value in start:
            if isinstance(value, str):
                text = (ctypes.c_char_p * 1)(value.encode())
                references = (c_uint * 1)(number)
                self.call("set_string", self.raw("fmi3SetString", *[c_void_p, c_size_t] * 2), references, 1, text, 1)

    def raw(self, name: str, *arguments: Any) -> Any:
        """The FMU's C function without FMPy's checks; arguments: types behind the instance."""
        try:
            function = self.fmu.dll[name]  # a new object: FMPy's own keeps its argument types
        except AttributeError as error:
            raise SlaveError(self.name, "instantiate", None, f"failed: the FMU has no function {name}") from error
        function.argtypes, function.restype = (c_void_p, *arguments), c_uint  # no negative status
        return function

    def fault(self, function: str, status: int) -> SlaveError:
        """What a status other than OK and Warning means, told in one line."""
        return SlaveError(self.name, function, self.time, returned(status, self.log.reason()))

    def enter_initialization(self, start_time: float, stop_time: float | None) -> None:
        """Enter initialization mode; times in s."""
        enter = self.raw("fmi3EnterInitializationMode", c_bool, c_double, c_double, c_bool, c_double)
        end = 0.0 if stop_time is None else stop_time
        self.call("enter_initialization_mode", enter, False, 0.0, start_time, stop_time is not None, end)

    def exit_initialization(self) -> None:
        """Exit initialization mode."""
        self.call("exit_initialization_mode", self.raw("fmi3ExitInitializationMode"))

    def close(self) -> None:
        """Terminate, if it was initialized, and free."""
        if self.time is not None:
            self.call("terminate", self.raw("fmi3Terminate"))
        self.fmu.freeInstance()

    def _accessor(self, name: str) -> Any:
        if name not in self._exchange:
            self._exchange[name] = self.raw(name, c_void_p, c_size_t, c_void_p, c_size_t)
        return self._exchange[name]

    def _load(self, identity: Identity, make: Callable[..., Any]) -> Any:
        directory = os.getcwd()
        try:
            fmu = _lenient(make)(
                guid=identity.guid,
                modelIdentifier=identity.model_identifier,
                unzipDirectory=identity.folder,
                instanceName=identity.instance_name,
            )
            fmu.instantiate(loggingOn=True, logMessage=lambda _, status, __, text: self.log.add(status, text or b""))
        except Exception as error:  # FMPy raises nothing more special
            raise SlaveError(self.name, "instantiate", None, f"failed: {self.log.reason() or error}") from error
        finally:
            os.chdir(directory)  # FMPy stays in the FMU's folder when loading fails
        return fmu


def _lenient(make: Any) -> Any:
    """FMPy's class, for an FMU that lacks functions which are not called.

    The standard wants all of them, those of other interfaces too; Simulink's FMUs, for one, have only their own.
    """

    def load(self: Any) -> None:
        dll, self.dll = self.dll, _Library(self.dll)
        make._loadFunctions(self)
        self.dll = dll

    return type(make.__name__, (make,), {"_loadFunctions": load})


class _Library:
    """A shared library, with a stand-in for each function that it lacks."""

    def __init__(self, dll: ctypes.CDLL) -> None:
        self._dll = dll

    def __getattr__(self, name: str) -> Any:
        try:
            return getattr(self._dll, name)
        except AttributeError:
            return SimpleNamespace()


class Instance3:
    """One FMU, from loading to freeing: see instance.Instance."""

    def __init__(self, identity: Identity, hear: Hear | None = None) -> None:
        self._fmi = Fmi3(identity, fmi3.FMU3Slave, hear)
        self._inputs: list[Block3] = []
        self._tunables: list[Block3] = []
        self._outputs: list[Block3] = []
        self._no_state_before = True  # until a state is saved that may be gone back to
        self._do_step = self._fmi.raw("fmi3DoStep", c_double, c_double, c_bool, *[c_void_p] * 4)
        self._flags, self._end = [c_bool() for _ in range(3)], c_double()
        self._results = [byref(flag) for flag in self._flags] + [byref(self._end)]

    def bind(self, inputs: Sequence[Variable], tunables: Sequence[Variable], outputs: Sequence[Variable]) -> None:
        """Prepare the arrays for what is set and got at communication points."""
        groups = (blocks3_of(variables, self._fmi.start) for variables in (inputs, tunables, outputs))
        self._inputs, self._tunables, self._outputs = groups
        self._start_blocks()

    def initialize(
        self, start: Sequence[tuple[str, str, int, Value]], start_time: float, stop_time: float | None
    ) -> None:
        """Set start values (name, type, handle, value), go through initialization mode; times in s."""
        self.enter_initialization(start, start_time, stop_time)
        self.exit_initialization()

    def enter_initialization(
        self, start: Sequence[tuple[str, str, int, Value]], start_time: float, stop_time: float | None
    ) -> None:
        """The first half of initialize."""
        self._fmi.time = start_time
        self._fmi.set_start(start)
        self._start_blocks()
        self._fmi.enter_initialization(start_time, stop_time)

    def propagate(self, inputs: Sequence[float] | None) -> tuple[float, ...]:
        """In initialization mode: set the inputs, where given, and get the outputs."""
        if inputs is not None:
            self._fmi.set(self._inputs, inputs)
        return self.get()

    def exit_initialization(self) -> None:
        """The second half of initialize."""
        self._fmi.exit_initialization()

    def step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> tuple[float, ...]:
        """Set tunables (if given) and inputs, step from t to t + h [s], get the outputs, all in bound order."""
        fmi = self._fmi
        fmi.time = t
        fmi.log.clear()
        if tunables is not None:
            fmi.set(self._tunables, tunables)
        fmi.set(self._inputs, inputs)
        self._end.value = t + h
        fmi.call("do_step", self._do_step, t, h, self._no_state_before, *self._results)
        _, is_ended, is_early = (flag.value for flag in self._flags)
        if is_ended or is_early:
            why = "asked to end the simulation" if is_ended else f"returned early, at {self._end.value:g} s"
            raise SlaveError(fmi.name, "do_step", t, why)
        fmi.time = t + h
        return fmi.get(self._outputs)

    def get(self) -> tuple[float, ...]:
        """The outputs in bound order; NaN for what the FMU did not fill."""
        return self._fmi.get(self._outputs)

    def get_state(self) -> bytes | int:
        """The FMU's state, serialised; only its size where that is above LARGEST_STATE."""
        fmi, state, size = self._fmi, c_void_p(), c_size_t()
        self._no_state_before = False
        fmi.call("get_state", fmi.raw("fmi3GetFMUState", c_void_p), byref(state))
        fmi.call("serialise_state", fmi.raw("fmi3SerializedFMUStateSize", c_void_p, c_void_p), state, byref(size))
        saved = self._serialised(state, size) if size.value <= LARGEST_STATE else size.value
        fmi.call("free_state", fmi.raw("fmi3FreeFMUState", c_void_p), byref(state))
        return saved

    def _serialised(self, state: c_void_p, size: c_size_t) -> bytes:
        buffer = ctypes.create_string_buffer(size.value)
        serialise = self._fmi.raw("fmi3SerializeFMUState", c_void_p, c_void_p, c_size_t)
        self._fmi.call("serialise_state", serialise, state, buffer, size)
        return buffer.raw

    def set_state(self, serialised: bytes) -> None:
        """Go back to a state that get_state returned."""
        fmi, state = self._fmi, c_void_p()
        self._no_state_before = False
        deserialise = fmi.raw("fmi3DeserializeFMUState", c_void_p, c_size_t, c_void_p)
        fmi.call("deserialise_state", deserialise, serialised, len(serialised), byref(state))
        fmi.call("set_state", fmi.raw("fmi3SetFMUState", c_void_p), state)
        fmi.call("free_state", fmi.raw("fmi3FreeFMUState", c_void_p), byref(state))

    def close(self) -> None:
        """Terminate, if it was initialized, and free."""
        self._fmi.close()

    def _start_blocks(self) -> None:
        for block in (*self._inputs, *self._tunables):
            block.start(self._fmi.start)
