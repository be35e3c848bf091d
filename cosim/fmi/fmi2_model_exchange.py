"""An FMI 2.0 model-exchange FMU as a function: a step sets states and inputs, and gets the states' derivatives.

No time passes in it.
"""

from collections.abc import Sequence
from ctypes import c_double
from typing import Any

from fmpy import fmi2, read_model_description

from ..errors import SlaveError
from .binding import FmuToLoad, StartValues
from .fmi2_calls import checked, loaded
from .fmu_log import LogListener, MessageLog
from .value_buffers import ScalarVariable, ValueBuffer, buffers_of

_MOST_UPDATES = 100  # of the discrete states, at one time


class Fmi2ModelExchange:
    """The function xdot = f(x, u; theta) of one FMU: see `Binding`.

    bind: inputs are the continuous states, in any order, then the model's inputs; outputs are their derivatives.
    """

    def __init__(self, fmu: FmuToLoad, on_log: LogListener | None = None) -> None:
        self._name = fmu.instance_name
        self._time: float | None = None
        self._tolerance = fmu.tolerance
        self._log = MessageLog(fmu.has_plain_log, on_log)
        self._places = self._places_of(fmu.folder)
        n = len(set(self._places.values()))
        self._x, self._rates = (c_double * n)(), (c_double * n)()
        self._inputs: list[ValueBuffer] = []
        self._tunables: list[ValueBuffer] = []
        self._state_places: list[int] = []
        self._rate_places: list[int] = []
        self._fmu = loaded(fmi2.FMU2Model, fmu, self._log)

    def bind(
        self, inputs: Sequence[ScalarVariable], tunables: Sequence[ScalarVariable], outputs: Sequence[ScalarVariable]
    ) -> None:
        """Choose what a step sets (states, then inputs), the parameters to change, and the derivatives to return."""
        n = len(outputs)
        self._state_places = [self._places[v[2]] for v in inputs[:n]]
        self._rate_places = [self._places[v[2]] for v in outputs]
        self._inputs, self._tunables = buffers_of(inputs[n:]), buffers_of(tunables)

    def initialize(self, start: StartValues, start_time: float, stop_time: float | None) -> None:
        """Set start values (name, type, value reference, value), and go on to continuous-time mode; times in s."""
        self._time = start_time
        self._call("setup_experiment", self._fmu.setupExperiment, self._tolerance, start_time, stop_time)
        for _, kind, reference, value in start:
            self._call(f"set_{kind.lower()}", getattr(self._fmu, f"set{kind}"), [reference], [value])
        self._call("enter_initialization_mode", self._fmu.enterInitializationMode)
        self._call("exit_initialization_mode", self._fmu.exitInitializationMode)
        self._leave_event_mode()

    def step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> tuple[float, ...]:
        """Return the derivatives at the states and inputs, after setting the tunables if they are given."""
        fmu, n = self._fmu, len(self._state_places)
        if tunables is not None:
            self._call("enter_event_mode", fmu.enterEventMode)
            self._set(self._tunables, tunables)
            self._leave_event_mode()
        for place, value in zip(self._state_places, inputs, strict=False):
            self._x[place] = value
        self._call("set_continuous_states", fmu.setContinuousStates, self._x, len(self._x))
        self._set(self._inputs, inputs[n:])
        self._rates[:] = [float("nan")] * len(self._rates)
        self._call("get_derivatives", fmu.getDerivatives, self._rates, len(self._rates))
        return tuple([self._rates[place] for place in self._rate_places])

    def close(self) -> None:
        """Terminate, if it was initialized, and free."""
        if self._time is not None:
            self._call("terminate", self._fmu.terminate)
        self._fmu.freeInstance()
        self._log.close()

    def _places_of(self, folder: str) -> dict[int, int]:
        """Return where each state is in x, and its derivative in xdot, by value reference: FMI 2.0.4, section 2.2.8."""
        places: dict[int, int] = {}
        for place, unknown in enumerate(read_model_description(folder, validate=False).derivatives):
            rate = unknown.variable
            if rate is None or rate.derivative is None:
                raise SlaveError(self._name, "instantiate", None, "failed: a continuous state is not described")
            places[rate.valueReference] = places[rate.derivative.valueReference] = place
        return places

    def _leave_event_mode(self) -> None:
        for _ in range(_MOST_UPDATES):
            is_unsettled, *_ = self._call("new_discrete_states", self._fmu.newDiscreteStates)
            if not is_unsettled:
                break
        else:
            why = f"has not ended after {_MOST_UPDATES} calls"
            raise SlaveError(self._name, "new_discrete_states", self._time, why)
        self._call("enter_continuous_time_mode", self._fmu.enterContinuousTimeMode)

    def _set(self, buffers: Sequence[ValueBuffer], values: Sequence[float]) -> None:
        for buffer in buffers:
            buffer.fill(values)
            function = getattr(self._fmu, "fmi2" + buffer.setter.title().replace("_", ""))
            self._call(buffer.setter, function, self._fmu.component, *buffer.arguments)

    def _call(self, name: str, function: Any, *arguments: object) -> Any:
        """Call a method of FMPy's. Raises SlaveError unless the FMU returns OK or Warning."""
        return checked(self._name, name, self._time, self._log, function, *arguments)
