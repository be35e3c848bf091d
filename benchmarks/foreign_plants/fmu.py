"""The FMUs of a plant and its controller, made from their declaration, with all that the model does not know."""

from dataclasses import replace
from math import tanh
from typing import Any, ClassVar

from fmu_models.kernel.blocks import ControllerSlave, PlantSlave
from fmu_models.kernel.description import disturbance, input_variable, parameter, state
from fmu_models.kernel.description import output as output_row
from fmu_models.kernel.ode import integrate

from .plant import ForeignPlant, Values, limited

_AT_REST = 0.02
"""Share of the usual speed within which dry friction changes its sign, so that it can be integrated."""


class PlantFmu(PlantSlave):
    """Plant with a disturbance, friction, actuators that are late or slow, and errors of its sensors.

    The base class has the lag tau_u. d: disturbance;  b, F_c: viscous and dry friction, in units of the load;
    share_u: share of the inputs that arrives;  limit_u: largest value of the first input that does, 0 for any;
    rate_u: fastest change of what arrives of an input, by second, 0 for any;  e_...: error of a sampled derivative.
    """

    plant: ClassVar[ForeignPlant]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        plant = cls.plant
        rows = (
            *(parameter(p.name, p.unit, p.start, p.description, min=p.bounds[0] / 2.0) for p in plant.parameters),
            parameter("b", None, 0.0, "Viscous friction", min=0.0),
            parameter("F_c", None, 0.0, "Dry friction", min=0.0),
            parameter("share_u", "1", 1.0, "Share of the inputs that arrives", min=0.0),
            parameter("limit_u", None, 0.0, "Largest value of the first input that arrives; 0: any", min=0.0),
            parameter("rate_u", None, 0.0, "Fastest change of the inputs that arrive, by second; 0: any", min=0.0),
            *(input_variable(s.name, s.unit, u, s.description) for s, u in zip(plant.controls, plant.start()[1])),
            replace(disturbance("d", "1", "Disturbance, in units of the load"), unit=None),
            *(replace(disturbance(f"e_{n}", "1", f"Error of the sensor of der({n})"), unit=None) for n in plant.noise),
        )
        known = [v.name for v in rows] + [s.name for s in plant.states]
        states = (replace(state(s.name, "1", s.start, s.description, depends=known), unit=s.unit) for s in plant.states)
        cls.table = (*rows, *states)
        names = [s.name for s in plant.states]
        cls._speed = names.index(plant.speed) if plant.speed else None
        cls._n_parameters, cls._n_controls = len(plant.parameters), len(plant.controls)
        cls._sensors = [names.index(n) for n in plant.noise]
        super().__init_subclass__(**kwargs)
        cls._rate_u = cls._physical.stop - 1

    def derivative(self, x: Values, u: Values, *parameters: float) -> Values:
        """Return the derivatives of the states, friction, disturbance and weak actuators included."""
        n, m = self._n_parameters, self._n_controls
        viscous, dry, share, limit = parameters[n : n + 4]
        load = u[m]
        if self._speed is not None and (viscous or dry):
            v = x[self._speed]
            load -= viscous * v + dry * tanh(v / (_AT_REST * self.plant.pace))
        first, *others = (share * sent for sent in u[:m])
        arrives = (min(first, limit) if limit else first, *others)
        return self.plant.derivative(x, arrives, *parameters[:n], load=load)

    def _refresh(self) -> None:
        super()._refresh()
        values = self._values
        x, u, p = tuple(values[self._states]), values[self._held], values[self._physical]
        if values[self._rate_u] > 0.0:
            values[self._rates] = self.derivative(x, (*self._hidden, *u[self._n_controls :]), *p)
        for place, error in zip(self._sensors, u[self._n_controls + 1 :]):
            values[self._rates.start + place] += error

    def _advance(self, step_size: float) -> None:
        values, rate = self._values, self._values[self._rate_u]
        if rate <= 0.0:
            super()._advance(step_size)
            return
        sent, before, p = values[self._controls], self._hidden, values[self._physical]
        others = values[self._inputs][self._n_controls :]

        def arriving(t: float) -> list[float]:
            return [y + limited(u - y, -rate * t, rate * t) for u, y in zip(sent, before)]

        def rates(x_and_time: Values) -> Values:
            *x, t = x_and_time
            return (*self.derivative(tuple(x), (*arriving(t), *others), *p), 1.0)

        x = (*values[self._states], 0.0)
        values[self._states] = integrate(rates, x, step_size, values[self._max_step])[:-1]
        values[self._held] = values[self._inputs]
        self._hidden = arriving(step_size)
        self._is_stale = True


class ControllerFmu(ControllerSlave):
    """Memoryless controller that is computed from the parameters it believes in."""

    plant: ClassVar[ForeignPlant]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        plant = cls.plant
        rows = (
            *(
                parameter(p.name, p.unit, p.start, p.description, min=p.bounds[0] / 2.0, max=p.bounds[1] * 2.0)
                for p in plant.parameters
            ),
            *(input_variable(s.name, s.unit, s.start, s.description) for s in (*plant.states, *plant.references)),
        )
        known = [v.name for v in rows]
        cls.table = (*rows, *(output_row(s.name, s.unit, s.description, depends=known) for s in plant.controls))
        super().__init_subclass__(**kwargs)

    def outputs(self, inputs: Values, parameters: Values) -> Values:
        """Return the control law's outputs."""
        n = len(self.plant.states)
        return self.plant.control(inputs[:n], inputs[n:], *parameters)
