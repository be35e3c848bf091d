"""The scenario's model in place of a plant FMU: outputs are states and their derivatives only."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final

from fmu_models.kernel.ode import integrate

from ..errors import COLON, SlaveError
from ..fmi.types import Value
from ..system.plant import Plant
from ..variable_name import VariableName

MAX_STEP_S: Final = 0.005
"""Largest Runge-Kutta step [s]."""


def not_given(plant: Plant, rates: Mapping[str, str], read: Iterable[str]) -> str | None:
    """Return the first of the references read that is a plant output which the model does not give, or None.

    rates: for each declared derivative the name of its state.
    """
    given = {f"{plant.name}.{name}" for name in (*plant.states, *rates)}
    return next((r for r in sorted(read) if VariableName(r).component == plant.name and r not in given), None)


class ModelPlant:
    """Model with the interface of a slave for the master; its tunables are the model's parameters, in order."""

    def __init__(
        self,
        plant: Plant,
        model: Callable[..., Sequence[float]],
        parameters: Sequence[str],
        rates: Mapping[str, str],
    ) -> None:
        """parameters: the model's, in the order of the tunables; rates: for each derivative its state."""
        self._plant, self._model, self._names = plant, model, tuple(parameters)
        n = len(plant.states)
        self._places = {name: n + plant.states.index(state) for name, state in rates.items()}  # in (x, x_dot)
        self._places |= {name: i for i, name in enumerate(plant.states)}
        self._x: tuple[float, ...] = (0.0,) * len(plant.states)
        self._u = tuple(plant.inputs.values())
        self._theta: Mapping[str, float] = {}

    def bind(self, inputs: Sequence[str], tunables: Sequence[str], outputs: Sequence[str]) -> None:
        """Bind inputs and outputs by name. Outputs that the model does not give stay 0: nothing reads them."""
        self._inputs = [list(self._plant.inputs).index(name) for name in inputs]
        self._outputs = [self._places.get(name, -1) for name in outputs]

    def initialize(self, start: Mapping[str, Value], start_time: float, stop_time: float | None) -> None:
        """Do nothing: set_state follows."""

    enter_initialization = initialize

    def propagate(self, inputs: Sequence[float] | None) -> Sequence[float]:
        """Return the bound outputs."""
        return self.get()

    def exit_initialization(self) -> None:
        """Do nothing."""

    def set_state(self, x: Sequence[float]) -> None:
        """Set the state (n,)."""
        self._x = tuple(x)

    def get(self) -> Sequence[float]:
        """Return the bound outputs."""
        rates = self._rates(self._x) if self._theta else (0.0,) * len(self._x)
        known = (*self._x, *rates, 0.0)
        return [known[i] for i in self._outputs]

    def begin_step(self, inputs: Sequence[float], t: float, h: float, tunables: Sequence[float] | None) -> None:
        """Integrate from t to t + h [s] with the inputs held. Raises SlaveError where the model has no value."""
        if tunables is not None:
            self._theta = dict(zip(self._names, tunables, strict=True))
        u = list(self._u)
        for i, value in zip(self._inputs, inputs, strict=True):
            u[i] = value
        self._u = tuple(u)
        try:
            self._x = tuple(integrate(self._rates, self._x, h, MAX_STEP_S))
        except (ArithmeticError, ValueError) as e:
            raise SlaveError(self._plant.name, "do_step", t, f"the model failed: {e}", COLON) from e

    def end_step(self) -> Sequence[float]:
        """Return the bound outputs."""
        return self.get()

    def _rates(self, x: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(self._model(x, self._u, **self._theta))
