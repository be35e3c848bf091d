"""An FMI 3.0 co-simulation FMU with an event mode, loaded into this process.

FMI 3.0.2, section 4: tunable parameters and discrete inputs may change in event mode only, which the FMU also asks for
after a step, and at times that it announces.
"""

import math
from collections.abc import Sequence
from ctypes import byref, c_bool, c_double, c_void_p

from ..errors import SlaveError
from .binding import FmuToLoad, StartValues
from .fmi3_co_simulation import Fmi3CoSimulation
from .fmu_log import LogListener
from .held_values import MOST_EVENTS, SLACK, HeldValues
from .value_buffers import ScalarVariable


class Fmi3EventMode:
    """An FMI 3.0 co-simulation FMU whose event mode is used: see `Binding`."""

    def __init__(self, fmu: FmuToLoad, on_log: LogListener | None = None) -> None:
        self._slave = slave = Fmi3CoSimulation(fmu, on_log, is_event_mode_used=True)
        self._enter = slave.calls.raw("fmi3EnterEventMode")
        self._update = slave.calls.raw("fmi3UpdateDiscreteStates", *[c_void_p] * 6)
        self._leave = slave.calls.raw("fmi3EnterStepMode")
        self._flags, self._next = [c_bool() for _ in range(5)], c_double()
        interface = slave.calls.description.coSimulation
        self._can_vary_step = bool(interface and interface.canHandleVariableCommunicationStepSize)
        self._held = HeldValues()

    def bind(
        self, inputs: Sequence[ScalarVariable], tunables: Sequence[ScalarVariable], outputs: Sequence[ScalarVariable]
    ) -> None:
        """Prepare the arrays for what is set and got at communication points."""
        self._slave.bind(inputs, tunables, outputs)

    def initialize(self, start: StartValues, start_time: float, stop_time: float | None) -> None:
        """Set start values (name, type, handle, value), go through initialization mode; times in s."""
        self.enter_initialization(start, start_time, stop_time)
        self.exit_initialization()

    def enter_initialization(self, start: StartValues, start_time: float, stop_time: float | None) -> None:
        """Set start values and enter initialization mode: the first half of initialize."""
        self._held = HeldValues(start_time)
        self._slave.enter_initialization(start, start_time, stop_time)

    def propagate(self, inputs: Sequence[float] | None) -> tuple[float, ...]:
        """Set the inputs, where given, and get the outputs, in initialization mode."""
        if inputs is not None:
            self._held = self._held._replace(inputs=tuple(inputs))
        return self._slave.propagate(inputs)

    def exit_initialization(self) -> None:
        """Leave initialization mode, and the event mode that follows it: the second half of initialize."""
        self._slave.exit_initialization()
        self._leave_event_mode()

    def step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> tuple[float, ...]:
        """Set tunables (if given) and inputs, step from t to t + h [s], get the outputs, all in bound order."""
        self._slave.begin(t)
        self._held = self._held._replace(time=t)
        if tunables is not None or tuple(inputs) != self._held.inputs:
            self._slave.calls.call("enter_event_mode", self._enter)
            self._slave.set(inputs, tunables)
            self._held = self._held._replace(inputs=tuple(inputs))
            self._leave_event_mode()
        end, slack, n_events = t + h, SLACK * h, 0
        while end - self._held.time > slack or self._held.next_event <= end + slack:
            n_events += self._step_towards(end, slack)
            if n_events > MOST_EVENTS and self._held.next_event <= self._held.time:
                raise SlaveError(self._slave.name, "do_step", end, f"had more than {MOST_EVENTS} events at one time")
        return self._slave.get()

    def get(self) -> tuple[float, ...]:
        """Return the outputs in bound order; NaN for what the FMU did not fill."""
        return self._slave.get()

    def get_state(self) -> bytes | int:
        """Return the FMU's state, serialised; only its size where that is above LARGEST_STATE."""
        state = self._slave.get_state()
        return state if isinstance(state, int) else self._held.joined(state)

    def set_state(self, serialised: bytes) -> None:
        """Go back to a state that get_state returned."""
        self._held, state = HeldValues.split(serialised)
        self._slave.set_state(state)

    def close(self) -> None:
        """Terminate, if it was initialized, and free."""
        self._slave.close()

    def _step_towards(self, end: float, slack: float) -> bool:
        """Step to the next event or to a communication point [s]; return whether there was an event."""
        time, event = self._held.time, self._held.next_event
        target = max(event, time) if self._can_vary_step and event < end - slack else end
        is_asked_for = target > time and self._slave.advance(time, target - time)
        self._held = self._held._replace(time=target)
        if not is_asked_for and event > target + slack:
            return False
        self._slave.calls.call("enter_event_mode", self._enter)
        self._leave_event_mode()
        return True

    def _leave_event_mode(self) -> None:
        """Update the discrete states until they have settled, and enter step mode."""
        calls = self._slave.calls
        for _ in range(MOST_EVENTS):
            calls.call("update_discrete_states", self._update, *map(byref, self._flags), byref(self._next))
            again, is_over, _, _, has_next = (flag.value for flag in self._flags)
            if is_over:
                raise SlaveError(calls.name, "update_discrete_states", calls.time, "asked to end the simulation")
            if not again:
                break
        else:
            why = f"has not ended after {MOST_EVENTS} calls"
            raise SlaveError(calls.name, "update_discrete_states", calls.time, why)
        self._held = self._held._replace(next_event=self._next.value if has_next else math.inf)
        calls.call("enter_step_mode", self._leave)
