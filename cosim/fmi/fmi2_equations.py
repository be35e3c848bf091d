"""The equations of an FMI 2.0 model-exchange FMU: see `Equations`."""

from collections.abc import Sequence
from ctypes import byref, c_double, c_int, c_size_t, c_uint, c_void_p, cast
from typing import Any

from fmpy import fmi2, read_model_description

from ..errors import SlaveError
from .binding import WARNING, FmuToLoad, StartValues, failure
from .fmi2_calls import checked, loaded, restore_state, saved_state
from .fmu_log import LogListener, MessageLog
from .value_buffers import ScalarVariable, ValueBuffer, buffers_of


class Fmi2Equations:
    """The calls of FMI 2.0, section 3, on one model."""

    def __init__(self, fmu: FmuToLoad, on_log: LogListener | None = None) -> None:
        self.name = fmu.instance_name
        self.time: float | None = None
        self._tolerance = fmu.tolerance
        self._log = MessageLog(fmu.has_plain_log, on_log)
        description = read_model_description(fmu.folder, validate=False)
        self._derivatives = description.derivatives
        self.n_states = int(description.numberOfContinuousStates)
        self.n_indicators = int(description.numberOfEventIndicators)
        interface = description.modelExchange
        self.has_step_events = bool(interface and interface.needsCompletedIntegratorStep)
        self._inputs: list[ValueBuffer] = []
        self._tunables: list[ValueBuffer] = []
        self._outputs: list[ValueBuffer] = []
        self._fmu = loaded(fmi2.FMU2Model, fmu, self._log)
        self._instance = cast(self._fmu.component, c_void_p)
        self._set_time = self._raw("SetTime", c_double)
        self._set_states, self._get_states, self._get_rates, self._get_indicators, self._get_nominals = (
            self._raw(name, c_void_p, c_size_t)
            for name in ("SetContinuousStates", "GetContinuousStates", "GetDerivatives", "GetEventIndicators",
                         "GetNominalsOfContinuousStates")
        )  # fmt: skip
        self._completed = self._raw("CompletedIntegratorStep", c_int, c_void_p, c_void_p)
        self._flags = c_int(), c_int()
        self._keeps_no_state = fmi2.fmi2True  # until one is saved that may be gone back to

    def bind(
        self, inputs: Sequence[ScalarVariable], tunables: Sequence[ScalarVariable], outputs: Sequence[ScalarVariable]
    ) -> None:
        """Prepare the arrays for what is set and got at communication points."""
        self._inputs, self._tunables, self._outputs = buffers_of(inputs), buffers_of(tunables), buffers_of(outputs)

    def enter_initialization(self, start: StartValues, start_time: float, stop_time: float | None) -> None:
        """Set start values and enter initialization mode; times in s."""
        self.time = start_time
        self._call("setup_experiment", self._fmu.setupExperiment, self._tolerance, start_time, stop_time)
        for _, kind, reference, value in start:
            self._call(f"set_{kind.lower()}", getattr(self._fmu, f"set{kind}"), [reference], [value])
        self._call("enter_initialization_mode", self._fmu.enterInitializationMode)

    def exit_initialization(self) -> None:
        """Leave initialization mode, for event mode."""
        self._call("exit_initialization_mode", self._fmu.exitInitializationMode)

    def set_inputs(self, values: Sequence[float]) -> None:
        """Set the inputs in bound order."""
        self._set(self._inputs, values)

    def set_tunables(self, values: Sequence[float]) -> None:
        """Set the tunable parameters in bound order."""
        self._set(self._tunables, values)

    def outputs(self) -> tuple[float, ...]:
        """Return the outputs in bound order; NaN for what the FMU did not fill."""
        pairs: list[tuple[int, float]] = []
        for buffer in self._outputs:
            buffer.clear()
            function = getattr(self._fmu, "fmi2" + buffer.getter.title().replace("_", ""))
            self._call(buffer.getter, function, self._fmu.component, *buffer.arguments)
            pairs += zip(buffer.positions, buffer.read(), strict=True)
        return tuple(value for _, value in sorted(pairs))

    def enter_event_mode(self) -> None:
        """Enter event mode, from continuous-time mode."""
        self._call("enter_event_mode", self._fmu.enterEventMode)

    def update_discrete_states(self) -> tuple[bool, bool, float | None]:
        """Return whether another update is needed, whether the simulation is over, and the next event's time [s]."""
        again, is_over, _, _, has_next, t = self._call("new_discrete_states", self._fmu.newDiscreteStates)
        return bool(again), bool(is_over), float(t) if has_next else None

    def enter_continuous_time_mode(self) -> None:
        """Enter continuous-time mode, from event mode."""
        self._call("enter_continuous_time_mode", self._fmu.enterContinuousTimeMode)

    def set_time(self, t: float) -> None:
        """Set the time [s]."""
        self.time = t
        self._checked("set_time", self._set_time(self._instance, t))

    def set_states(self, x: Any) -> None:
        """Set the continuous states."""
        self._checked("set_continuous_states", self._set_states(self._instance, x, self.n_states))

    def get_states(self, x: Any) -> None:
        """Fill an array with the continuous states."""
        self._checked("get_continuous_states", self._get_states(self._instance, x, self.n_states))

    def get_rates(self, rates: Any, *, may_discard: bool = True) -> bool:
        """Fill an array with the states' derivatives; return False where the FMU has none here, if it may discard."""
        status = self._get_rates(self._instance, rates, self.n_states)
        return not (may_discard and status == fmi2.fmi2Discard) and self._checked("get_derivatives", status)

    def get_indicators(self, z: Any) -> bool:
        """Fill an array with the event indicators; return False where the FMU has none here (discard)."""
        status = self._get_indicators(self._instance, z, self.n_indicators)
        return status != fmi2.fmi2Discard and self._checked("get_event_indicators", status)

    def get_nominals(self, nominals: Any) -> None:
        """Fill an array with the nominal values of the continuous states."""
        status = self._get_nominals(self._instance, nominals, self.n_states)
        self._checked("get_nominals_of_continuous_states", status)

    def completed_step(self) -> tuple[bool, bool]:
        """Tell the FMU that a step was accepted; return whether there is an event, and whether it is over."""
        flags = map(byref, self._flags)
        status = self._completed(self._instance, self._keeps_no_state, *flags)
        self._checked("completed_integrator_step", status)
        has_event, is_over = self._flags
        return bool(has_event.value), bool(is_over.value)

    def get_state(self) -> bytes | int:
        """Return the FMU's state, serialised; only its size where that is above LARGEST_STATE."""
        self._keeps_no_state = fmi2.fmi2False
        return saved_state(self._fmu, self._call)

    def set_state(self, serialised: bytes) -> None:
        """Go back to a state that get_state returned."""
        self._keeps_no_state = fmi2.fmi2False
        restore_state(self._fmu, self._call, serialised)

    def state_places(self) -> dict[int, int]:
        """Return where each state is in x, and its derivative in the rates, by value reference: FMI 2.0.4, 2.2.8."""
        places: dict[int, int] = {}
        for place, unknown in enumerate(self._derivatives):
            rate = unknown.variable
            if rate is None or rate.derivative is None:
                raise SlaveError(self.name, "instantiate", None, "failed: a continuous state is not described")
            places[rate.valueReference] = places[rate.derivative.valueReference] = place
        return places

    def slope(self, parameter: int) -> list[float]:
        """Raise SlaveError: in FMI 2.0 a parameter is among the knowns of no derivative."""
        raise SlaveError(self.name, "get_directional_derivative", self.time, "is not for parameters in FMI 2.0")

    def close(self) -> None:
        """Terminate, if it was initialized, and free."""
        if self.time is not None:
            self._call("terminate", self._fmu.terminate)
        self._fmu.freeInstance()
        self._log.close()

    def clear_log(self) -> None:
        """Forget the messages so far: none of them is the reason of a later fault."""
        self._log.clear()

    def _set(self, buffers: Sequence[ValueBuffer], values: Sequence[float]) -> None:
        for buffer in buffers:
            buffer.fill(values)
            function = getattr(self._fmu, "fmi2" + buffer.setter.title().replace("_", ""))
            self._call(buffer.setter, function, self._fmu.component, *buffer.arguments)

    def _raw(self, name: str, *arguments: Any) -> Any:
        """Return the FMU's C function without FMPy's checks; arguments: types behind the instance."""
        function = self._fmu.dll[f"fmi2{name}"]  # a new object: FMPy's own keeps its argument types
        function.argtypes, function.restype = (c_void_p, *arguments), c_uint  # no negative status
        return function

    def _checked(self, name: str, status: int) -> bool:
        if status > WARNING:
            raise SlaveError(self.name, name, self.time, failure(status, self._log.reason()))
        return True

    def _call(self, name: str, function: Any, *arguments: object) -> Any:
        return checked(self.name, name, self.time, self._log, function, *arguments)
