"""The equations of an FMI 3.0 model-exchange FMU: see `Equations`."""

from collections.abc import Sequence
from ctypes import byref, c_bool, c_double, c_size_t, c_uint, c_void_p
from typing import Any, Final

from fmpy import fmi3

from ..errors import SlaveError
from .binding import FmuToLoad, StartValues
from .elements import handle, of_handle
from .fmi3_calls import Fmi3Calls
from .fmu_log import LogListener
from .value_buffers import ScalarVariable
from .value_buffers3 import ValueBuffer3, buffers3_of

_DISCARD: Final = 2


class Fmi3Equations:
    """The calls of FMI 3.0, section 3, on one model."""

    def __init__(self, fmu: FmuToLoad, on_log: LogListener | None = None) -> None:
        self._fmi = fmi = Fmi3Calls(fmu, fmi3.FMU3Model, on_log)
        self.name = fmi.name
        interface = fmi.description.modelExchange
        self.has_step_events = bool(interface and interface.needsCompletedIntegratorStep)
        self._inputs: list[ValueBuffer3] = []
        self._tunables: list[ValueBuffer3] = []
        self._outputs: list[ValueBuffer3] = []
        self.n_states, self.n_indicators = (
            self._number(f"fmi3GetNumberOf{what}") for what in ("ContinuousStates", "EventIndicators")
        )
        self._set_time = fmi.raw("fmi3SetTime", c_double)
        self._set_states = fmi.raw("fmi3SetContinuousStates", c_void_p, c_size_t)
        self._get_states = fmi.raw("fmi3GetContinuousStates", c_void_p, c_size_t)
        self._get_rates = fmi.raw("fmi3GetContinuousStateDerivatives", c_void_p, c_size_t)
        self._get_nominals = fmi.raw("fmi3GetNominalsOfContinuousStates", c_void_p, c_size_t)
        self._get_indicators = fmi.raw("fmi3GetEventIndicators", c_void_p, c_size_t) if self.n_indicators else None
        self._enter_event_mode = fmi.raw("fmi3EnterEventMode")
        self._update = fmi.raw("fmi3UpdateDiscreteStates", *[c_void_p] * 6)
        self._enter_continuous_time = fmi.raw("fmi3EnterContinuousTimeMode")
        self._completed = fmi.raw("fmi3CompletedIntegratorStep", c_bool, c_void_p, c_void_p)
        self._flags, self._next = [c_bool() for _ in range(5)], c_double()
        self._keeps_no_state = True  # until one is saved that may be gone back to

    @property
    def time(self) -> float | None:
        """Present time [s]; None before initialization."""
        return self._fmi.time

    def bind(
        self, inputs: Sequence[ScalarVariable], tunables: Sequence[ScalarVariable], outputs: Sequence[ScalarVariable]
    ) -> None:
        """Prepare the arrays for what is set and got at communication points."""
        groups = (buffers3_of(variables, self._fmi.start) for variables in (inputs, tunables, outputs))
        self._inputs, self._tunables, self._outputs = groups
        self._start_buffers()

    def enter_initialization(self, start: StartValues, start_time: float, stop_time: float | None) -> None:
        """Set start values and enter initialization mode; times in s."""
        self._fmi.time = start_time
        self._fmi.set_start(start)
        self._start_buffers()
        self._fmi.enter_initialization(start_time, stop_time)

    def exit_initialization(self) -> None:
        """Leave initialization mode, for event mode."""
        self._fmi.exit_initialization()

    def set_inputs(self, values: Sequence[float]) -> None:
        """Set the inputs in bound order."""
        self._fmi.set(self._inputs, values)

    def set_tunables(self, values: Sequence[float]) -> None:
        """Set the tunable parameters in bound order."""
        self._fmi.set(self._tunables, values)

    def outputs(self) -> tuple[float, ...]:
        """Return the outputs in bound order; NaN for what the FMU did not fill."""
        return self._fmi.get(self._outputs)

    def enter_event_mode(self) -> None:
        """Enter event mode, from continuous-time mode."""
        self._fmi.call("enter_event_mode", self._enter_event_mode)

    def update_discrete_states(self) -> tuple[bool, bool, float | None]:
        """Return whether another update is needed, whether the simulation is over, and the next event's time [s]."""
        self._fmi.call("update_discrete_states", self._update, *map(byref, self._flags), byref(self._next))
        again, is_over, _, _, has_next = (flag.value for flag in self._flags)
        return again, is_over, self._next.value if has_next else None

    def enter_continuous_time_mode(self) -> None:
        """Enter continuous-time mode, from event mode."""
        self._fmi.call("enter_continuous_time_mode", self._enter_continuous_time)

    def set_time(self, t: float) -> None:
        """Set the time [s]."""
        self._fmi.time = t
        self._fmi.call("set_time", self._set_time, t)

    def set_states(self, x: Any) -> None:
        """Set the continuous states."""
        self._fmi.call("set_continuous_states", self._set_states, x, self.n_states)

    def get_states(self, x: Any) -> None:
        """Fill an array with the continuous states."""
        self._fmi.call("get_continuous_states", self._get_states, x, self.n_states)

    def get_rates(self, rates: Any, *, may_discard: bool = True) -> bool:
        """Fill an array with the states' derivatives; return False where the FMU has none here, if it may discard."""
        return self._filled("get_continuous_state_derivatives", self._get_rates, rates, self.n_states, may_discard)

    def get_indicators(self, z: Any) -> bool:
        """Fill an array with the event indicators; return False where the FMU has none here (discard)."""
        return self._filled("get_event_indicators", self._get_indicators, z, self.n_indicators)

    def get_nominals(self, nominals: Any) -> None:
        """Fill an array with the nominal values of the continuous states."""
        self._fmi.call("get_nominals_of_continuous_states", self._get_nominals, nominals, self.n_states)

    def completed_step(self) -> tuple[bool, bool]:
        """Tell the FMU that a step was accepted; return whether there is an event, and whether it is over."""
        has_event, is_over = self._flags[:2]
        flags = map(byref, (has_event, is_over))
        self._fmi.call("completed_integrator_step", self._completed, self._keeps_no_state, *flags)
        return has_event.value, is_over.value

    def get_state(self) -> bytes | int:
        """Return the FMU's state, serialised; only its size where that is above LARGEST_STATE."""
        self._keeps_no_state = False
        return self._fmi.get_state()

    def set_state(self, serialised: bytes) -> None:
        """Go back to a state that get_state returned."""
        self._keeps_no_state = False
        self._fmi.set_state(serialised)

    def state_places(self) -> dict[int, int]:
        """Return where each element of a state is in x, and its derivative in the rates, by handle."""
        places: dict[int, int] = {}
        n = 0
        for rate in self._rates_described():
            for element in range(len(self._fmi.start[rate.valueReference])):
                for variable in (rate, rate.derivative):
                    places[handle(variable.valueReference, element)] = n
                n += 1
        return places

    def slope(self, parameter: int) -> list[float]:
        """Return the derivatives of all rates by one element of a parameter, a handle: FMI 3.0, section 2.4.8."""
        reference, element = of_handle(parameter)
        seed = (c_double * len(self._fmi.start[reference]))()
        seed[element] = 1.0
        rates = [rate.valueReference for rate in self._rates_described()]
        known, unknown = (c_uint * 1)(reference), (c_uint * len(rates))(*rates)
        sensitivity = (c_double * self.n_states)(*[float("nan")] * self.n_states)
        self._fmi.call(
            "get_directional_derivative", self._fmi.raw("fmi3GetDirectionalDerivative", *[c_void_p, c_size_t] * 4),
            unknown, len(unknown), known, 1, seed, len(seed), sensitivity, len(sensitivity),
        )  # fmt: skip
        return list(sensitivity)

    def _rates_described(self) -> list[Any]:
        """Return the derivatives of the states in the order of the model structure. Raises SlaveError."""
        rates = [unknown.variable for unknown in self._fmi.description.derivatives]
        if any(rate is None or rate.derivative is None for rate in rates):
            raise SlaveError(self.name, "instantiate", None, "failed: a continuous state is not described")
        return rates

    def close(self) -> None:
        """Terminate, if it was initialized, and free."""
        self._fmi.close()

    def clear_log(self) -> None:
        """Forget the messages so far: none of them is the reason of a later fault."""
        self._fmi.log.clear()

    def _filled(self, name: str, function: Any, values: Any, n: int, may_discard: bool = True) -> bool:
        status = function(self._fmi.instance, values, n)
        if may_discard and status == _DISCARD:
            return False
        self._fmi.check(name, status)
        return True

    def _number(self, function: str) -> int:
        n = c_size_t()
        self._fmi.call("instantiate", self._fmi.raw(function, c_void_p), byref(n))
        return n.value

    def _start_buffers(self) -> None:
        for buffer in (*self._inputs, *self._tunables):
            buffer.start(self._fmi.start)
