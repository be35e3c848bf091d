"""The calls that both interfaces of FMI 3.0 make: loading an FMU, and functions whose status is checked."""

import ctypes
import os
from collections.abc import Callable, Mapping, Sequence
from ctypes import byref, c_bool, c_double, c_size_t, c_uint, c_void_p
from types import SimpleNamespace
from typing import Any

from fmpy import read_model_description

from ..errors import SlaveError
from .binding import LARGEST_STATE, WARNING, FmuToLoad, StartValues, failure
from .fmu_log import LogListener, Messages
from .value_buffers import ScalarVariable
from .value_buffers3 import ValueBuffer3, buffers3_of, overlaid, start_arrays


class Fmi3Calls:
    """Base class of both interfaces of FMI 3.0: loading, and calls whose status is checked."""

    def __init__(
        self, fmu: FmuToLoad, make: Callable[..., Any], on_log: LogListener | None = None, **options: bool
    ) -> None:
        """make: FMPy's class for the interface; on_log: called with each message of the FMU; options: of instantiation.

        Raises SlaveError.
        """
        self.name = fmu.instance_name
        self.time: float | None = None
        self._tolerance = fmu.tolerance
        self.log = Messages(on_log)
        self.description = read_model_description(fmu.folder, validate=False)
        self.start = start_arrays(self.description)
        self.fmu = self._load(fmu, make, options)
        self.instance = ctypes.cast(self.fmu.component, c_void_p)
        self._accessors: dict[str, Any] = {}

    def call(self, name: str, function: Any, *arguments: object) -> None:
        """Call a C function with the instance. Raises SlaveError unless it returns OK or Warning."""
        self.check(name, function(self.instance, *arguments))

    def check(self, name: str, status: int) -> None:
        """Raise SlaveError for a status other than OK and Warning."""
        if status > WARNING:
            raise self.fault(name, status)

    def set(self, buffers: Sequence[ValueBuffer3], values: Sequence[float]) -> None:
        """Set the variables of the buffers, whose values are given in bound order."""
        for buffer in buffers:
            buffer.fill(values)
            self.call(f"set_{buffer.setter[7:].lower()}", self._accessor(buffer.setter), *buffer.arguments)

    def get(self, buffers: Sequence[ValueBuffer3]) -> tuple[float, ...]:
        """Return the values of the buffers' variables in bound order; NaN for what the FMU did not fill."""
        for buffer in buffers:
            buffer.clear()
            self.call(f"get_{buffer.getter[7:].lower()}", self._accessor(buffer.getter), *buffer.arguments)
        if len(buffers) == 1:
            return tuple(buffers[0].read())
        pairs = (pair for buffer in buffers for pair in zip(buffer.positions, buffer.read(), strict=True))
        return tuple(float(value) for _, value in sorted(pairs))

    def set_start(self, start: StartValues) -> None:
        """Set start values (name, type, handle, value), whole arrays at a time, and remember them."""
        numbers = {number: float(value) for _, _, number, value in start if not isinstance(value, str)}
        self.start = overlaid(self.start, numbers)
        variables = [
            ScalarVariable(name, kind, number) for name, kind, number, value in start if not isinstance(value, str)
        ]
        buffers = buffers3_of(variables, self.start)
        for buffer in buffers:
            buffer.start(self.start)
        self.set(buffers, list(numbers.values()))
        for _, _, number, value in start:
            if isinstance(value, str):
                text = (ctypes.c_char_p * 1)(value.encode())
                references = (c_uint * 1)(number)
                self.call("set_string", self.raw("fmi3SetString", *[c_void_p, c_size_t] * 2), references, 1, text, 1)

    def raw(self, name: str, *arguments: Any) -> Any:
        """Return the FMU's C function without FMPy's checks; arguments: types behind the instance."""
        try:
            function = self.fmu.dll[name]  # a new object: FMPy's own keeps its argument types
        except AttributeError as error:
            raise SlaveError(self.name, "instantiate", None, f"failed: the FMU has no function {name}") from error
        function.argtypes, function.restype = (c_void_p, *arguments), c_uint  # no negative status
        return function

    def fault(self, function: str, status: int) -> SlaveError:
        """Return the error that a status other than OK and Warning means."""
        return SlaveError(self.name, function, self.time, failure(status, self.log.reason()))

    def enter_initialization(self, start_time: float, stop_time: float | None) -> None:
        """Enter initialization mode; times in s."""
        enter = self.raw("fmi3EnterInitializationMode", c_bool, c_double, c_double, c_bool, c_double)
        end = 0.0 if stop_time is None else stop_time
        tolerance = (self._tolerance is not None, self._tolerance or 0.0)
        self.call("enter_initialization_mode", enter, *tolerance, start_time, stop_time is not None, end)

    def exit_initialization(self) -> None:
        """Exit initialization mode."""
        self.call("exit_initialization_mode", self.raw("fmi3ExitInitializationMode"))

    def get_state(self) -> bytes | int:
        """Return the FMU's state, serialised; only its size where that is above LARGEST_STATE."""
        state, size = c_void_p(), c_size_t()
        self.call("get_state", self.raw("fmi3GetFMUState", c_void_p), byref(state))
        self.call("serialise_state", self.raw("fmi3SerializedFMUStateSize", c_void_p, c_void_p), state, byref(size))
        saved = self._serialised(state, size) if size.value <= LARGEST_STATE else size.value
        self.call("free_state", self.raw("fmi3FreeFMUState", c_void_p), byref(state))
        return saved

    def set_state(self, serialised: bytes) -> None:
        """Go back to a state that get_state returned."""
        state = c_void_p()
        deserialise = self.raw("fmi3DeserializeFMUState", c_void_p, c_size_t, c_void_p)
        self.call("deserialise_state", deserialise, serialised, len(serialised), byref(state))
        self.call("set_state", self.raw("fmi3SetFMUState", c_void_p), state)
        self.call("free_state", self.raw("fmi3FreeFMUState", c_void_p), byref(state))

    def close(self) -> None:
        """Terminate, if it was initialized, and free."""
        if self.time is not None:
            self.call("terminate", self.raw("fmi3Terminate"))
        self.fmu.freeInstance()

    def _serialised(self, state: c_void_p, size: c_size_t) -> bytes:
        buffer = ctypes.create_string_buffer(size.value)
        serialise = self.raw("fmi3SerializeFMUState", c_void_p, c_void_p, c_size_t)
        self.call("serialise_state", serialise, state, buffer, size)
        return buffer.raw

    def _accessor(self, name: str) -> Any:
        if name not in self._accessors:
            self._accessors[name] = self.raw(name, c_void_p, c_size_t, c_void_p, c_size_t)
        return self._accessors[name]

    def _load(self, to_load: FmuToLoad, make: Callable[..., Any], options: Mapping[str, bool]) -> Any:
        directory = os.getcwd()
        try:
            fmu = _lenient(make)(
                guid=to_load.guid,
                modelIdentifier=to_load.model_identifier,
                unzipDirectory=to_load.folder,
                instanceName=to_load.instance_name,
            )
            fmu.instantiate(
                loggingOn=True, logMessage=lambda _, status, __, text: self.log.add(status, text or b""), **options
            )
        except Exception as error:  # FMPy raises nothing more special
            reason = self.log.reason() or str(error)
            raise SlaveError(self.name, "instantiate", None, f"failed: {reason}") from error
        finally:
            os.chdir(directory)  # FMPy stays in the FMU's folder when loading fails
        return fmu


def _lenient(make: Any) -> Any:
    """Return FMPy's class, made to accept an FMU that lacks functions which are not called.

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
