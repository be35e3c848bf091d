"""An FMI 3.0 co-simulation FMU loaded into this process."""

from collections.abc import Sequence
from ctypes import byref, c_bool, c_double, c_void_p

from fmpy import fmi3

from ..errors import SlaveError
from .binding import FmuToLoad, StartValues
from .fmi3_calls import Fmi3Calls
from .fmu_log import LogListener
from .value_buffers import ScalarVariable
from .value_buffers3 import ValueBuffer3, buffers3_of


class Fmi3CoSimulation:
    """An FMI 3.0 co-simulation FMU: see `Binding`."""

    def __init__(self, fmu: FmuToLoad, on_log: LogListener | None = None, is_event_mode_used: bool = False) -> None:
        """is_event_mode_used: see `Fmi3EventMode`, which goes through that mode."""
        options = {"eventModeUsed": True} if is_event_mode_used else {}
        self.calls = Fmi3Calls(fmu, fmi3.FMU3Slave, on_log, **options)
        self.name = self.calls.name
        self._inputs: list[ValueBuffer3] = []
        self._tunables: list[ValueBuffer3] = []
        self._outputs: list[ValueBuffer3] = []
        self._no_state_before = True  # until a state is saved that may be gone back to
        self._do_step = self.calls.raw("fmi3DoStep", c_double, c_double, c_bool, *[c_void_p] * 4)
        self._flags, self._end = [c_bool() for _ in range(3)], c_double()
        self._results = [byref(flag) for flag in self._flags] + [byref(self._end)]

    def bind(
        self, inputs: Sequence[ScalarVariable], tunables: Sequence[ScalarVariable], outputs: Sequence[ScalarVariable]
    ) -> None:
        """Prepare the arrays for what is set and got at communication points."""
        groups = (buffers3_of(variables, self.calls.start) for variables in (inputs, tunables, outputs))
        self._inputs, self._tunables, self._outputs = groups
        self._start_buffers()

    def initialize(self, start: StartValues, start_time: float, stop_time: float | None) -> None:
        """Set start values (name, type, handle, value), go through initialization mode; times in s."""
        self.enter_initialization(start, start_time, stop_time)
        self.exit_initialization()

    def enter_initialization(self, start: StartValues, start_time: float, stop_time: float | None) -> None:
        """Set start values and enter initialization mode: the first half of initialize."""
        self.calls.time = start_time
        self.calls.set_start(start)
        self._start_buffers()
        self.calls.enter_initialization(start_time, stop_time)

    def propagate(self, inputs: Sequence[float] | None) -> tuple[float, ...]:
        """Set the inputs, where given, and get the outputs, in initialization mode."""
        if inputs is not None:
            self.calls.set(self._inputs, inputs)
        return self.get()

    def exit_initialization(self) -> None:
        """Leave initialization mode: the second half of initialize."""
        self.calls.exit_initialization()

    def step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> tuple[float, ...]:
        """Set tunables (if given) and inputs, step from t to t + h [s], get the outputs, all in bound order."""
        self.begin(t)
        self.set(inputs, tunables)
        self.advance(t, h)
        return self.calls.get(self._outputs)

    def begin(self, t: float) -> None:
        """Begin a step at t [s]: forget the messages before."""
        self.calls.time = t
        self.calls.log.clear()

    def set(self, inputs: Sequence[float], tunables: Sequence[float] | None) -> None:
        """Set tunables (if given) and inputs in bound order."""
        if tunables is not None:
            self.calls.set(self._tunables, tunables)
        self.calls.set(self._inputs, inputs)

    def advance(self, t: float, h: float) -> bool:
        """Step from t to t + h [s]; return whether the FMU asks for event mode."""
        fmi = self.calls
        self._end.value = t + h
        fmi.call("do_step", self._do_step, t, h, self._no_state_before, *self._results)
        is_event, is_ended, is_early = (flag.value for flag in self._flags)
        if is_ended or is_early:
            why = "asked to end the simulation" if is_ended else f"returned early, at {self._end.value:g} s"
            raise SlaveError(fmi.name, "do_step", t, why)
        fmi.time = t + h
        return is_event

    def get(self) -> tuple[float, ...]:
        """Return the outputs in bound order; NaN for what the FMU did not fill."""
        return self.calls.get(self._outputs)

    def get_state(self) -> bytes | int:
        """Return the FMU's state, serialised; only its size where that is above LARGEST_STATE."""
        self._no_state_before = False
        return self.calls.get_state()

    def set_state(self, serialised: bytes) -> None:
        """Go back to a state that get_state returned."""
        self._no_state_before = False
        self.calls.set_state(serialised)

    def close(self) -> None:
        """Terminate, if it was initialized, and free."""
        self.calls.close()

    def _start_buffers(self) -> None:
        for buffer in (*self._inputs, *self._tunables):
            buffer.start(self.calls.start)
