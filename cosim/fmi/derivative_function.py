"""A model-exchange FMU as a function: a step sets states and inputs, and gets the states' derivatives.

No time passes in it.
"""

from collections.abc import Sequence
from ctypes import c_double

from .binding import FmuToLoad, StartValues
from .equations import Equations, equations_of, leave_event_mode
from .fmu_log import LogListener
from .value_buffers import ScalarVariable


class DerivativeFunction:
    """The function xdot = f(x, u; theta) of one FMU: see `Binding`.

    bind: inputs are the continuous states, in any order, then the model's inputs; outputs are their derivatives.
    """

    def __init__(self, fmu: FmuToLoad, on_log: LogListener | None = None) -> None:
        self._model: Equations = equations_of(fmu, on_log)
        self._places = self._model.state_places()
        n = self._model.n_states
        self._x, self._rates = (c_double * n)(), (c_double * n)()
        self._tunables: Sequence[ScalarVariable] = ()
        self._state_places: list[int] = []
        self._rate_places: list[int] = []

    def bind(
        self, inputs: Sequence[ScalarVariable], tunables: Sequence[ScalarVariable], outputs: Sequence[ScalarVariable]
    ) -> None:
        """Choose what a step sets (states, then inputs), the parameters to change, and the derivatives to return."""
        n = len(outputs)
        self._state_places = [self._places[v[2]] for v in inputs[:n]]
        self._rate_places = [self._places[v[2]] for v in outputs]
        self._tunables = tunables
        self._model.bind(inputs[n:], tunables, ())

    def initialize(self, start: StartValues, start_time: float, stop_time: float | None) -> None:
        """Set start values (name, type, value reference, value), and go on to continuous-time mode; times in s."""
        self._model.enter_initialization(start, start_time, stop_time)
        self._model.exit_initialization()
        leave_event_mode(self._model)

    def step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> tuple[float, ...]:
        """Return the derivatives at the states and inputs, after setting the tunables if they are given."""
        model, n = self._model, len(self._state_places)
        model.clear_log()
        if tunables is not None:
            model.enter_event_mode()
            model.set_tunables(tunables)
            leave_event_mode(model)
        for place, value in zip(self._state_places, inputs, strict=False):
            self._x[place] = value
        model.set_states(self._x)
        model.set_inputs(inputs[n:])
        self._rates[:] = [float("nan")] * len(self._rates)
        model.get_rates(self._rates, may_discard=False)
        return tuple([self._rates[place] for place in self._rate_places])

    def slopes(self, inputs: Sequence[float], tunables: Sequence[float]) -> list[list[float]]:
        """Return the derivatives of a step's results by each tunable, a row a result.

        By directional derivatives: FMI 3.0, section 2.4.8, parameters are among the knowns of state derivatives.
        """
        self.step(0.0, 0.0, inputs, tunables)
        columns = [self._model.slope(variable[2]) for variable in self._tunables]
        return [[column[place] for column in columns] for place in self._rate_places]

    def close(self) -> None:
        """Terminate, if it was initialized, and free."""
        self._model.close()
