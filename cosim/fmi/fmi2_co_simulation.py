"""An FMI 2.0 co-simulation FMU loaded into this process."""

from collections.abc import Callable, Sequence
from ctypes import c_double, c_int, c_uint, c_void_p, cast
from functools import partial
from typing import Any, Final, TypeAlias

from fmpy import fmi2

from ..errors import SlaveError
from .binding import WARNING, FmuToLoad, StartValues, failure
from .fmi2_calls import checked, loaded, restore_state, saved_state
from .fmu_log import LogListener, MessageLog
from .types import TYPES
from .value_buffers import ScalarVariable, ValueBuffer, buffers_of

_SETTERS: Final = tuple(dict.fromkeys(row.fmi2.functions for row in TYPES.values() if row.fmi2 is not None))
_Call: TypeAlias = Callable[[], int]
_BufferCall: TypeAlias = tuple[ValueBuffer, _Call]


class Fmi2CoSimulation:
    """An FMI 2.0 co-simulation FMU: see `Binding`."""

    def __init__(self, fmu: FmuToLoad, on_log: LogListener | None = None) -> None:
        """on_log: called with each message that the FMU logs. Raises SlaveError."""
        self.name = fmu.instance_name
        self._log = MessageLog(fmu.has_plain_log, on_log)
        self._time: float | None = None
        self._tolerance = fmu.tolerance
        self._inputs: list[_BufferCall] = []
        self._tunables: list[_BufferCall] = []
        self._outputs: list[_BufferCall] = []
        self._fmu = loaded(fmi2.FMU2Slave, fmu, self._log)
        self._instance = cast(self._fmu.component, c_void_p)
        self._t, self._h = c_double(), c_double()
        self._forward_only = c_int(fmi2.fmi2True)  # until a state is saved that may be gone back to
        self._do_step = self._raw("do_step", self._t, self._h, self._forward_only)

    def bind(
        self, inputs: Sequence[ScalarVariable], tunables: Sequence[ScalarVariable], outputs: Sequence[ScalarVariable]
    ) -> None:
        """Prepare the arrays for what is set and got at communication points."""
        self._inputs = [(buffer, self._raw(buffer.setter, *buffer.arguments)) for buffer in buffers_of(inputs)]
        self._tunables = [(buffer, self._raw(buffer.setter, *buffer.arguments)) for buffer in buffers_of(tunables)]
        self._outputs = [(buffer, self._raw(buffer.getter, *buffer.arguments)) for buffer in buffers_of(outputs)]

    def initialize(self, start: StartValues, start_time: float, stop_time: float | None) -> None:
        """Set start values (name, type, value reference, value), go through initialization mode; times in s."""
        self.enter_initialization(start, start_time, stop_time)
        self.exit_initialization()

    def enter_initialization(self, start: StartValues, start_time: float, stop_time: float | None) -> None:
        """Set start values and enter initialization mode: the first half of initialize."""
        self._time = start_time
        fmu = self._fmu
        self._checked("setup_experiment", fmu.setupExperiment, self._tolerance, start_time, stop_time)
        for functions in _SETTERS:
            of_type = [(reference, value) for _, kind, reference, value in start if kind == functions]
            if of_type:
                references, values = zip(*of_type, strict=True)
                self._checked(f"set_{functions.lower()}", getattr(fmu, f"set{functions}"), references, values)
        self._checked("enter_initialization_mode", fmu.enterInitializationMode)

    def propagate(self, inputs: Sequence[float] | None) -> tuple[float, ...]:
        """Set the inputs, where given, and get the outputs, in initialization mode. FMI 2.0.4, section 4.2.4."""
        if inputs is not None:
            self._set(self._inputs, inputs)
        return self.get()

    def exit_initialization(self) -> None:
        """Leave initialization mode: the second half of initialize."""
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
        if status > WARNING:
            raise self._fault("do_step", status)
        self._time = t + h
        return self.get()

    def get(self) -> tuple[float, ...]:
        """Return the outputs in bound order; NaN for what the FMU did not fill."""
        for buffer, call in self._outputs:
            buffer.clear()
            status = call()
            if status > WARNING:
                raise self._fault(buffer.getter, status)
        if len(self._outputs) == 1:
            return self._outputs[0][0].read()
        pairs = (pair for buffer, _ in self._outputs for pair in zip(buffer.positions, buffer.read(), strict=True))
        return tuple(value for _, value in sorted(pairs))

    def get_state(self) -> bytes | int:
        """Return the FMU's state, serialised; only its size where that is above LARGEST_STATE."""
        self._forward_only.value = fmi2.fmi2False
        return saved_state(self._fmu, self._checked)

    def set_state(self, serialised: bytes) -> None:
        """Go back to a state that get_state returned."""
        self._forward_only.value = fmi2.fmi2False
        restore_state(self._fmu, self._checked, serialised)

    def reset(self) -> None:
        """Go back to the beginning of the FMU's life, before initialize. FMI 2.0.4, section 2.1.6."""
        self._time = None
        self._checked("reset", self._fmu.reset)

    def close(self) -> None:
        """Terminate, if it was initialized, and free."""
        if self._time is not None:
            self._checked("terminate", self._fmu.terminate)
        self._fmu.freeInstance()
        self._log.close()

    def _set(self, calls: Sequence[_BufferCall], values: Sequence[float]) -> None:
        for buffer, call in calls:
            buffer.fill(values)
            status = call()
            if status > WARNING:
                raise self._fault(buffer.setter, status)

    def _raw(self, name: str, *arguments: Any) -> _Call:
        """Return the FMU's C function of that name with its arguments, which must be ctypes objects.

        Without FMPy's checks, and with nothing to look up or convert: half the time of the call.
        """
        function = self._fmu.dll["fmi2" + name.title().replace("_", "")]  # a new object: FMPy's has argument types
        function.restype = c_uint  # a negative status is none either, and greater than a warning like this
        return partial(function, self._instance, *arguments)

    def _checked(self, name: str, function: Any, *arguments: object) -> Any:
        return checked(self.name, name, self._time, self._log, function, *arguments)

    def _fault(self, function: str, status: int) -> SlaveError:
        return SlaveError(self.name, function, self._time, failure(status, self._log.reason()))
