"""An FMI 3.0 model-exchange FMU as a function: a step sets states and inputs, and gets the states' derivatives.

No time passes in it.
"""

from collections.abc import Sequence
from ctypes import byref, c_bool, c_double, c_size_t, c_uint, c_void_p

from fmpy import fmi3

from ..errors import SlaveError
from .binding import FmuToLoad, StartValues
from .elements import of_handle
from .fmi3_calls import Fmi3Calls
from .fmu_log import LogListener
from .value_buffers import ScalarVariable
from .value_buffers3 import ValueBuffer3, buffers3_of

_MOST_UPDATES = 100  # of the discrete states, at one time


class Fmi3ModelExchange:
    """The function xdot = f(x, u; theta) of one FMU: see `Binding`.

    bind: inputs are the continuous states, in any order, then the model's inputs; outputs are their derivatives.
    """

    def __init__(self, fmu: FmuToLoad, on_log: LogListener | None = None) -> None:
        self._fmi = fmi = Fmi3Calls(fmu, fmi3.FMU3Model, on_log)
        rates = [unknown.variable for unknown in fmi.description.derivatives]
        self._first: dict[int, int] = {}  # where a state begins in x, and its derivative in xdot, by value reference
        n = 0
        for rate in rates:
            if rate is None or rate.derivative is None:
                raise SlaveError(fmi.name, "instantiate", None, "failed: a continuous state is not described")
            self._first[rate.valueReference] = self._first[rate.derivative.valueReference] = n
            n += len(fmi.start[rate.valueReference])
        self._rate_references = [rate.valueReference for rate in rates if rate is not None]
        self._x, self._rates = (c_double * n)(), (c_double * n)()
        self._inputs: list[ValueBuffer3] = []
        self._tunables: list[ValueBuffer3] = []
        self._tunable_variables: Sequence[ScalarVariable] = ()
        self._state_places: list[int] = []
        self._rate_places: list[int] = []
        self._enter_event_mode = fmi.raw("fmi3EnterEventMode")
        self._enter_continuous_time = fmi.raw("fmi3EnterContinuousTimeMode")
        self._update = fmi.raw("fmi3UpdateDiscreteStates", *[c_void_p] * 6)
        self._set_states = fmi.raw("fmi3SetContinuousStates", c_void_p, c_size_t)
        self._get_rates = fmi.raw("fmi3GetContinuousStateDerivatives", c_void_p, c_size_t)

    def bind(
        self, inputs: Sequence[ScalarVariable], tunables: Sequence[ScalarVariable], outputs: Sequence[ScalarVariable]
    ) -> None:
        """Choose what a step sets (states, then inputs), the parameters to change, and the derivatives to return."""
        n = len(outputs)
        self._state_places, self._rate_places = self._places(inputs[:n]), self._places(outputs)
        self._inputs = buffers3_of(inputs[n:], self._fmi.start)
        self._tunables, self._tunable_variables = buffers3_of(tunables, self._fmi.start), tunables
        for buffer in (*self._inputs, *self._tunables):
            buffer.start(self._fmi.start)

    def initialize(self, start: StartValues, start_time: float, stop_time: float | None) -> None:
        """Set start values (name, type, handle, value), and go on to continuous-time mode; times in s."""
        self._fmi.time = start_time
        self._fmi.set_start(start)
        self._fmi.enter_initialization(start_time, stop_time)
        self._fmi.exit_initialization()
        self._leave_event_mode()

    def step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> tuple[float, ...]:
        """Return the derivatives at the states and inputs, after setting the tunables if they are given."""
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

    def slopes(self, inputs: Sequence[float], tunables: Sequence[float]) -> list[list[float]]:
        """Return the derivatives of a step's results by each tunable, a row a result, by fmi3GetDirectionalDerivative.

        FMI 3.0, section 2.4.8: parameters are among the knowns of state derivatives.
        """
        self.step(0.0, 0.0, inputs, tunables)
        columns = [self._direction(*of_handle(variable[2])) for variable in self._tunable_variables]
        return [[column[place] for column in columns] for place in self._rate_places]

    def _direction(self, reference: int, element: int) -> list[float]:
        """Return the derivatives of all state derivatives by one element of a parameter."""
        seed = (c_double * len(self._fmi.start[reference]))()
        seed[element] = 1.0
        known, sensitivity = (c_uint * 1)(reference), (c_double * len(self._rates))(*[float("nan")] * len(self._rates))
        unknown = (c_uint * len(self._rate_references))(*self._rate_references)
        types = [c_void_p, c_size_t] * 4
        self._fmi.call(
            "get_directional_derivative", self._fmi.raw("fmi3GetDirectionalDerivative", *types),
            unknown, len(unknown), known, 1, seed, len(seed), sensitivity, len(sensitivity),
        )  # fmt: skip
        return list(sensitivity)

    def close(self) -> None:
        """Terminate, if it was initialized, and free."""
        self._fmi.close()

    def _places(self, variables: Sequence[ScalarVariable]) -> list[int]:
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
