"""The three kinds of FMU: a plant with states, a memoryless controller, a reference that follows time.

A model is a subclass of one of them: a table of variables, and one hook that is a pure function.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

from .description import TIME, Variable, output, parameter, per_second
from .ode import Vector, integrate
from .slave import Slave

HELD = ", with the inputs held"


class Plant(Slave):
    """Continuous states, integrated over a step with the inputs held.

    The table has parameters, inputs and states; the derivatives der(...), the held inputs ..._held and the
    parameter max_step are added to it.
    """

    has_feedthrough = False
    derivative: ClassVar[Callable[..., Vector]]
    """The hook f(x, u, *parameters) -> x_dot, as a staticmethod: states, inputs, parameters in the table's order."""

    @staticmethod
    def project(x: Vector) -> Vector:
        """The nearest valid state to one that has been integrated."""
        return x

    @classmethod
    def _complete(cls, table: tuple[Variable, ...]) -> tuple[Variable, ...]:
        by_causality = {c: [v for v in table if v.causality == c] for c in ("parameter", "input", "output")}
        parameters, inputs, states = by_causality.values()
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
        return (*parameters, max_step, *inputs, *states, *rates, *held) if table else ()

    @classmethod
    def exchange_table(cls) -> tuple[Variable, ...]:
        """The variables where somebody else integrates: no max_step, nothing is held, derivatives are local."""
        kept = [v for i, v in enumerate(cls.variables[: cls._held.start]) if i != cls._max_step]
        texts = {v.name: v.description.removesuffix(HELD) for v in kept}
        return tuple(
            replace(v, causality="local", description=texts[v.name]) if v.derivative else v for v in kept
        )  # fmt: skip

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        x, p = cls._states, cls._parameters
        n_states = x.stop - x.start
        cls._physical, cls._max_step = slice(0, p.stop - 1), p.stop - 1
        cls._rates, cls._held = slice(x.stop, x.stop + n_states), slice(x.stop + n_states, None)

    def _refresh(self) -> None:
        values = self._values
        if not self._is_initialized:
            values[self._held] = values[self._inputs]
        x, u = tuple(values[self._states]), tuple(values[self._held])
        values[self._rates] = self.derivative(x, u, *values[self._physical])

    def _advance(self, step_size: float) -> None:
        values, f = self._values, self.derivative
        u, p = tuple(values[self._inputs]), values[self._physical]
        x = integrate(lambda x: f(x, u, *p), tuple(values[self._states]), step_size, values[self._max_step])
        values[self._states] = self.project(x)
        values[self._held] = u
        self._is_stale = True


class Controller(Slave):
    """A memoryless function of inputs and parameters."""

    def outputs(self, inputs: Vector, parameters: Vector) -> Vector:
        """The hook: inputs, parameters and the returned outputs in the table's order."""
        raise NotImplementedError

    def _refresh(self) -> None:
        values = self._values
        values[self._outputs] = self.outputs(tuple(values[self._inputs]), tuple(values[self._parameters]))

    def _advance(self, step_size: float) -> None:
        if self._is_stale:
            self._update()


class Reference(Slave):
    """A function of time and parameters. Time is added to its table."""

    @classmethod
    def _complete(cls, table: tuple[Variable, ...]) -> tuple[Variable, ...]:
        return (*super()._complete(table), TIME) if table else ()

    def outputs(self, time: float, parameters: Vector) -> Vector:
        """The hook: time [s]; parameters and the returned outputs in the table's order."""
        raise NotImplementedError

    def _refresh(self) -> None:
        self._values[self._outputs] = (*self.outputs(self._time, tuple(self._values[self._parameters])), self._time)

    def _advance(self, step_size: float) -> None:
        self._update()
