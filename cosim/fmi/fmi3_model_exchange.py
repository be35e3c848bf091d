"""An FMI 3.0 model-exchange FMU as a function: a step sets states and inputs, and gets the states' derivatives.

It has the methods of instance.Instance, so that it can live in a process of its own. No time passes.
"""

from collections.abc import Sequence
from ctypes import byref, c_bool, c_double, c_size_t, c_void_p

from fmpy import fmi3

from ..errors import SlaveError
from .elements import of_handle
from .fmi2_co_simulation import Identity
from .fmi3_co_simulation import Fmi3
from .fmu_log import Hear
from .value_buffers import Value, Variable
from .value_buffers3 import Block3, blocks3_of

_MOST_UPDATES = 100  # of the discrete states, at one time


class Exchange3:
    """xdot = f(x, u; theta) of one FMU.

    bind: inputs are the continuous states, in any order, then the model's inputs; outputs are their derivatives.
    """

    def __init__(self, identity: Identity, hear: Hear | None = None) -> None:
        self._fmi = fmi = Fmi3(identity, fmi3.FMU3Model, hear)
        rates = [unknown.variable for unknown in fmi.description.derivatives]
        self._first: dict[int, int] = {}  # where a state begins in x, and its derivative in xdot, by value reference
        n = 0
        for rate in rates:
            if rate is None or rate.derivative is None:
                raise SlaveError(fmi.name, "instantiate", None, "failed: a continuous state is not described")
            self._first[rate.valueReference] = self._first[rate.derivative.valueReference] = n
            n += len(fmi.start[rate.valueReference])
        self._x, self._rates = (c_double * n)(), (c_double * n)()
        self._inputs: list[Block3] = []
        self._tunables: list[Block3] = []
        self._state_places: list[int] = []
        self._rate_places: list[int] = []
        self._enter_event_mode = fmi.raw("fmi3EnterEventMode")
        self._enter_continuous_time = fmi.raw("fmi3EnterContinuousTimeMode")
        self._update = fmi.raw("fmi3UpdateDiscreteStates", *[c_void_p] * 6)
        self._set_states = fmi.raw("fmi3SetContinuousStates", c_void_p, c_size_t)
        self._get_rates = fmi.raw("fmi3GetContinuousStateDerivatives", c_void_p, c_size_t)

    def bind(self, inputs: Sequence[Variable], tunables: Sequence[Variable], outputs: Sequence[Variable]) -> None:
        """Say what a step sets (states, then inputs), which parameters may change, and which derivatives it returns."""
        n = len(outputs)
        self._state_places, self._rate_places = self._places(inputs[:n]), self._places(outputs)
        self._inputs = blocks3_of(inputs[n:], self._fmi.start)
        self._tunables = blocks3_of(tunables, self._fmi.start)
        for block in (*self._inputs, *self._tunables):
            block.start(self._fmi.start)

    def initialize(
        self, start: Sequence[tuple[str, str, int, Value]], start_time: float, stop_time: float | None
    ) -> None:
        """Set start values (name, type, handle, value), and go on to continuous-time mode; times in s."""
        self._fmi.time = start_time
        self._fmi.set_start(start)
        self._fmi.enter_initialization(start_time, stop_time)
        self._fmi.exit_initialization()
        self._leave_event_mode()

    def step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> tuple[float, ...]:
        """The derivatives at the states and inputs, after setting the tunables if they are given."""
        fmi = self._fmi
        fmi.log.clear()
        if tunables is not None:
            fmi.call("enter_event_mode", self._enter_event_mode)
            fmi.set(self._tunables, tunables)
            self._leave_event_mode()
        n = len(self._state_places)
        for place, value in zip(self._state_places, inputs, strict=False):
            self._x[place] = value
        fmi.call("set_continuous_states", self._set_states, self._x, len(self._x))
        fmi.set(self._inputs, inputs[n:])
        self._rates[:] = [float("nan")] * len(self._rates)
        fmi.call("get_continuous_state_derivatives", self._get_rates, self._rates, len(self._rates))
        return tuple([self._rates[place] for place in self._rate_places])

    def close(self) -> None:
        """Terminate, if it was initialized, and free."""
        self._fmi.close()

    def _places(self, variables: Sequence[Variable]) -> list[int]:
        pairs = [of_handle(variable[2]) for variable in variables]
        return [self._first[reference] + element for reference, element in pairs]

    def _leave_event_mode(self) -> None:
        fmi = self._fmi
        flags, next_time = [c_bool() for _ in range(5)], c_double()
        for _ in range(_MOST_UPDATES):
            fmi.call("update_discrete_states", self._update, *map(byref, flags), byref(next_time))
            if not flags[0].value:
                break
        else:
            raise SlaveError(fmi.name, "update_discrete_states", fmi.time, f"has not ended after {_MOST_UPDATES} calls")
        fmi.call("enter_continuous_time_mode", self._enter_continuous_time)
