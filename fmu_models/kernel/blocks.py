"""Three kinds of FMU: a plant with states, a memoryless controller, a reference that follows time.

A model is a subclass of one of them: a table of variables, and one hook that is a pure function. `Adaptive` makes a
controller's parameters inputs, for an estimator that is an FMU itself.
"""

from collections.abc import Callable
from dataclasses import replace
from math import exp
from typing import Any, ClassVar

from .description import TIME, VariableRow, input_variable, output, parameter, per_second
from .ode import StateVector, integrate
from .slave import Slave

HELD = ", with the inputs held"
SETTLED = 40.0
"""Time constants after which nothing of a lag is left: exp(-40) = 4e-18."""


class PlantSlave(Slave):
    """Continuous states, integrated over a step with the inputs held.

    The table has parameters, inputs and states; the derivatives der(...), the held inputs ..._held and the
    parameters tau_u and max_step are added to it. Disturbances come last among the inputs.

    Every other input is a command u to an actuator, and what acts on the plant is y, tau_u y_dot = u - y. It starts
    at the first command, and is part of the FMU state; in model exchange y = u.
    """

    has_feedthrough = False
    derivative: ClassVar[Callable[..., StateVector]]
    """The hook f(x, u, *parameters) -> x_dot, as a staticmethod: states, inputs, parameters in the table's order."""

    @staticmethod
    def project(x: StateVector) -> StateVector:
        """Return the valid state nearest to an integrated one."""
        return x

    @classmethod
    def _complete(cls, table: tuple[VariableRow, ...]) -> tuple[VariableRow, ...]:
        by_causality = {c: [v for v in table if v.causality == c] for c in ("parameter", "input", "output")}
        parameters, inputs, states = by_causality.values()
        inputs.sort(key=lambda v: v.is_disturbance)
        tau_u = parameter("tau_u", "s", 0.0, "Time constant of the actuators, first order; 0: none", min=0.0)
        max_step = parameter(
            "max_step", "s", 0.005, "Largest step of the integrator", variability="fixed", min=1e-6, max=1.0
        )
        rates = [
            output(
                f"der({v.name})", per_second(v.unit or "1"), f"Time derivative of {v.name}{HELD}",
                depends=v.dependencies, derivative=v.name,
            ) for v in states
        ]  # fmt: skip
        held = [
            output(
                f"{v.name}_held", v.unit or "1", f"{v.name} as held over the last step, at first its initial value",
                depends=(v.name,), variability="discrete", nominal=v.nominal,
            ) for v in inputs
        ]  # fmt: skip
        return (*parameters, tau_u, max_step, *inputs, *states, *rates, *held) if table else ()

    @classmethod
    def exchange_table(cls) -> tuple[VariableRow, ...]:
        """Return the variables for an importer that integrates: no tau_u, max_step or held, derivatives local."""
        left_out = (cls._tau_u, cls._max_step)
        kept = [v for i, v in enumerate(cls.variables[: cls._held.start]) if i not in left_out]
        texts = {v.name: v.description.removesuffix(HELD) for v in kept}
        return tuple(
            replace(v, causality="local", description=texts[v.name]) if v.derivative else v for v in kept
        )  # fmt: skip

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        x, p = cls._states, cls._parameters
        n_states = x.stop - x.start
        cls._physical, cls._tau_u, cls._max_step = slice(0, p.stop - 2), p.stop - 2, p.stop - 1
        n_controls = sum(v.causality == "input" and not v.is_disturbance for v in cls.variables)
        cls._controls = slice(cls._inputs.start, cls._inputs.start + n_controls)
        cls._rates, cls._held = slice(x.stop, x.stop + n_states), slice(x.stop + n_states, None)

    def _refresh(self) -> None:
        values = self._values
        if not self._is_initialized:
            values[self._held] = values[self._inputs]
            self._hidden = values[self._controls]
        x, u = tuple(values[self._states]), tuple(values[self._held])
        if values[self._tau_u] > 0.0:
            u = (*self._hidden, *u[len(self._hidden) :])
        values[self._rates] = self.derivative(x, u, *values[self._physical])

    def _advance(self, step_size: float) -> None:
        values, f = self._values, self.derivative
        u, p = tuple(values[self._inputs]), values[self._physical]
        x, controls, rest = tuple(values[self._states]), values[self._controls], step_size
        if values[self._tau_u] > 0.0 and self._hidden != controls:
            lagged = min(step_size, SETTLED * values[self._tau_u])
            x, rest = self._behind_lag(x, u, lagged), step_size - lagged
        if rest > 0.0:
            self._hidden = controls
            x = integrate(lambda x: f(x, u, *p), x, rest, values[self._max_step])
        values[self._states] = self.project(x)
        values[self._held] = u
        self._is_stale = True

    def _behind_lag(self, x: StateVector, u: StateVector, duration: float) -> StateVector:
        """Return the state after `duration` [s] of y = u + (y_0 - u) exp(-t/tau_u), and keep the last y."""
        f, p = self.derivative, self._values[self._physical]
        tau_u, max_step = self._values[self._tau_u], self._values[self._max_step]
        y_0, n = tuple(self._hidden), len(self._hidden)

        def y(t: float) -> StateVector:
            left = exp(-t / tau_u)
            return tuple([b + (a - b) * left for a, b in zip(y_0, u)])

        def rates(x_and_time: StateVector) -> StateVector:
            *x, t = x_and_time
            return (*f(tuple(x), (*y(t), *u[n:]), *p), 1.0)

        self._hidden = list(y(duration))
        return integrate(rates, (*x, 0.0), duration, min(max_step, tau_u))[:-1]


class ControllerSlave(Slave):
    """A memoryless function of inputs and parameters."""

    def outputs(self, inputs: StateVector, parameters: StateVector) -> StateVector:
        """Return the outputs, for a subclass to define; inputs, parameters and outputs in the table's order."""
        raise NotImplementedError

    def _refresh(self) -> None:
        values = self._values
        values[self._outputs] = self.outputs(tuple(values[self._inputs]), tuple(values[self._parameters]))

    def _advance(self, step_size: float) -> None:
        if self._is_stale:
            self._update()


class Adaptive(ControllerSlave):
    """A controller that gets some of its parameters as inputs: class FastAdaptive(Adaptive, Fast).

    They start at the inputs' initial values; from then on each step at which update_ready is true takes the inputs,
    and every other step keeps the present values, which the outputs ..._held report.
    """

    estimated: ClassVar[tuple[str, ...]] = ()
    """Names of those parameters in the table of the controller."""

    @classmethod
    def _complete(cls, table: tuple[VariableRow, ...]) -> tuple[VariableRow, ...]:
        told = [v for v in table if v.name in cls.estimated]
        if not told:
            return ()
        inputs = [
            input_variable(
                v.name, v.unit, v.start or 0.0, f"{v.description}, as estimated", nominal=v.nominal,
                min=v.min, max=v.max, is_latched=True,
            ) for v in told
        ]  # fmt: skip
        ready = input_variable("update_ready", None, False, "Whether the estimates are to be used", is_latched=True)
        held = [
            output(
                f"{v.name}_held", v.unit, f"{v.name} as used by the controller, at first its initial value",
                depends=(v.name,), variability="discrete", nominal=v.nominal,
            ) for v in told
        ]  # fmt: skip
        rest = [v for v in table if v.name not in cls.estimated]
        return super()._complete((*rest, *inputs, ready, *held))

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        place = {v.name: i for i, v in enumerate(cls.variables)}
        names = [v.name for v in cls.table if v.causality == "parameter"] if place else []
        cls._told = [place[name] for name in cls.estimated]
        cls._held = [place[f"{name}_held"] for name in cls.estimated]
        cls._law_parameters = [place[f"{name}_held" if name in cls.estimated else name] for name in names]
        cls._ready = place.get("update_ready", 0)
        cls._law_inputs = slice(cls._inputs.start, cls._ready - len(cls._told))
        cls._law_outputs = slice(cls._outputs.start, len(place) - len(cls._held))

    def _refresh(self) -> None:
        values = self._values
        if not self._is_initialized:
            self._take_up()
        parameters = tuple([values[i] for i in self._law_parameters])
        values[self._law_outputs] = self.outputs(tuple(values[self._law_inputs]), parameters)

    def _advance(self, step_size: float) -> None:
        if self._values[self._ready]:
            self._take_up()
            self._is_stale = True
        super()._advance(step_size)

    def _take_up(self) -> None:
        self._must_be_within(self._latched_bounds)  # until then they are not used: some importers begin with zeros
        for told, held in zip(self._told, self._held):
            self._values[held] = self._values[told]


class ReferenceSlave(Slave):
    """A function of time and parameters. Time is added to its table."""

    @classmethod
    def _complete(cls, table: tuple[VariableRow, ...]) -> tuple[VariableRow, ...]:
        return (*super()._complete(table), TIME) if table else ()

    def outputs(self, time: float, parameters: StateVector) -> StateVector:
        """Return the outputs at time [s], for a subclass to define; parameters and outputs in the table's order."""
        raise NotImplementedError

    def _refresh(self) -> None:
        self._values[self._outputs] = (*self.outputs(self._time, tuple(self._values[self._parameters])), self._time)

    def _advance(self, step_size: float) -> None:
        self._update()
