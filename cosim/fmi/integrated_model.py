"""A model-exchange FMU as a component: its equations, integrated from one communication point to the next.

FMI 2.0.4 and 3.0.2, section 3: a step at whose beginning an input or a tunable parameter changes begins in event mode;
within it CVODE stops at time events, where an event indicator changes its sign, and where the FMU asks for an event
after a step of the solver. The solver begins anew at every communication point, so that a state of the FMU and of the
few values kept here is all that has to be saved.
"""

import math
from collections.abc import Sequence
from typing import Any, Final

from ..errors import SlaveError
from .binding import FmuToLoad, StartValues
from .equations import equations_of, fault, leave_event_mode
from .fmu_log import LogListener
from .held_values import MOST_EVENTS, SLACK, HeldValues
from .value_buffers import ScalarVariable

TOLERANCE: Final = 1e-6
"""Relative tolerance where neither the FMU nor the scenario has one."""
_SHARE: Final = 0.01
"""Tolerance of a step of CVODE as a share of that: begun anew at each communication point, it makes errors at each."""


class IntegratedModel:
    """A model-exchange FMU with CVODE: see `Binding`."""

    def __init__(self, fmu: FmuToLoad, on_log: LogListener | None = None) -> None:
        try:
            from .cvode import Cvode, SolverError, doubles, is_finite
        except ImportError as error:
            raise SlaveError(fmu.instance_name, "instantiate", None, f"failed: {error}") from error
        self._model = model = equations_of(fmu, on_log)
        self._solver_error, self._is_finite = SolverError, is_finite
        tolerance = _SHARE * (TOLERANCE if fmu.tolerance is None else fmu.tolerance)
        n = max(model.n_states, 1)  # a model without states has one here that stays
        self._solver = Cvode(n, model.n_indicators, self._rates_at, self._indicators_at, tolerance)
        self._nominals = doubles(n)
        self._time = 0.0
        self._next_event = math.inf
        self._inputs: tuple[float, ...] | None = None

    def bind(
        self, inputs: Sequence[ScalarVariable], tunables: Sequence[ScalarVariable], outputs: Sequence[ScalarVariable]
    ) -> None:
        """Prepare what is set and got at communication points."""
        self._model.bind(inputs, tunables, outputs)

    def initialize(self, start: StartValues, start_time: float, stop_time: float | None) -> None:
        """Set start values (name, type, value reference, value), go through initialization mode; times in s."""
        self.enter_initialization(start, start_time, stop_time)
        self.exit_initialization()

    def enter_initialization(self, start: StartValues, start_time: float, stop_time: float | None) -> None:
        """Set start values and enter initialization mode: the first half of initialize."""
        self._time, self._inputs = start_time, None
        self._model.enter_initialization(start, start_time, stop_time)

    def propagate(self, inputs: Sequence[float] | None) -> tuple[float, ...]:
        """Set the inputs, where given, and get the outputs, in initialization mode."""
        if inputs is not None:
            self._model.set_inputs(inputs)
            self._inputs = tuple(inputs)
        return self._model.outputs()

    def exit_initialization(self) -> None:
        """Leave initialization mode, and the event mode that follows it: the second half of initialize."""
        self._model.exit_initialization()
        self._leave_event_mode()

    def step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> tuple[float, ...]:
        """Set tunables (if given) and inputs, integrate from t to t + h [s], get the outputs, all in bound order."""
        model = self._model
        model.clear_log()
        if tunables is not None or tuple(inputs) != self._inputs:
            model.enter_event_mode()
            if tunables is not None:
                model.set_tunables(tunables)
            model.set_inputs(inputs)
            self._inputs = tuple(inputs)
            self._leave_event_mode()
        self._integrate(t + h, SLACK * h)
        return model.outputs()

    def get(self) -> tuple[float, ...]:
        """Return the outputs in bound order; NaN for what the FMU did not fill."""
        return self._model.outputs()

    def get_state(self) -> bytes | int:
        """Return the state of FMU and integration, serialised; the FMU's size where that is above LARGEST_STATE."""
        state = self._model.get_state()
        if isinstance(state, int):
            return state
        return HeldValues(self._time, self._next_event, self._inputs).joined(state)

    def set_state(self, serialised: bytes) -> None:
        """Go back to a state that get_state returned."""
        held, state = HeldValues.split(serialised)
        self._time, self._next_event, self._inputs = held
        self._model.set_state(state)
        self._model.set_time(self._time)

    def close(self) -> None:
        """Terminate, if it was initialized, and free FMU and solver."""
        self._model.close()
        self._solver.close()

    def _integrate(self, end: float, slack: float) -> None:
        """Go to a communication point [s], through the events on the way and those at it."""
        is_anew, n_at_once, last = True, 0, -math.inf
        while end - self._time > slack or self._next_event <= end + slack:
            target = self._next_event if self._next_event <= end + slack else end
            is_event = target - self._time > slack and self._step(target, end - self._time if is_anew else None)
            is_there = not is_event and target - self._time <= slack
            if is_there and target > self._time:
                self._time = target
                self._model.set_time(target)
            is_anew = is_event or (is_there and self._next_event <= self._time)
            if is_anew:
                n_at_once = n_at_once + 1 if self._time - last <= slack else 1
                if n_at_once > MOST_EVENTS:
                    raise fault(self._model, "do_step", f"had more than {MOST_EVENTS} events at one time")
                last = self._time
                self._model.enter_event_mode()
                self._leave_event_mode()

    def _step(self, target: float, span: float | None) -> bool:
        """Take one step of the solver towards a time [s]; return whether an event is at its end.

        span: where the solver begins anew, the time to the communication point [s].
        """
        model, solver = self._model, self._solver
        if not model.n_states and not model.n_indicators:
            self._time, has_root = target, False
        else:
            try:
                if span is not None:
                    self._restart(span)
                self._time, has_root = solver.step(target)
            except self._solver_error as error:
                raise fault(model, "do_step", f"cannot be integrated: {error}") from error
        model.set_time(self._time)
        if model.n_states:
            model.set_states(solver.x)
        has_event, is_over = model.completed_step() if model.has_step_events else (False, False)
        if is_over:
            raise fault(model, "completed_integrator_step", "asked to end the simulation")
        return has_root or has_event

    def _restart(self, span: float) -> None:
        model = self._model
        if model.n_states:
            model.get_states(self._solver.x)
            model.get_nominals(self._nominals)
        else:
            self._solver.x[0] = 1.0
        self._solver.restart(self._time, self._nominals, span)

    def _leave_event_mode(self) -> None:
        """Enter continuous-time mode once the discrete states have settled, and take the time of the next event."""
        t = leave_event_mode(self._model)
        self._next_event = math.inf if t is None else t

    def _rates_at(self, t: float, x: Any, rates: Any) -> bool:
        model = self._model
        model.set_time(t)
        if not model.n_states:
            rates[0] = 0.0
            return True
        model.set_states(x)
        rates[0] = math.nan  # a function that fills nothing has no values
        return model.get_rates(rates) and self._is_finite(rates, model.n_states)

    def _indicators_at(self, t: float, x: Any, z: Any) -> bool:
        model = self._model
        model.set_time(t)
        if model.n_states:
            model.set_states(x)
        return model.get_indicators(z)
