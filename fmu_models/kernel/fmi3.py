"""FMI 3.0 interfaces of a Slave: the same model with FMI 3.0's calls, and vectors and matrices as arrays.

The entry script of an FMI 3.0 FMU derives from one of the two classes at the end, see `build`. It holds the Slave that
the FMI 2.0 FMU is; a value reference stands for the places of its elements in the Slave's list. No NumPy: pythonfmu3
needs it for its own variables, which are not used.
"""

from collections.abc import Callable, Iterable
from functools import wraps
from math import nan
from typing import Any, ClassVar, NamedTuple, NoReturn, TypeVar
from xml.etree.ElementTree import Element

from pythonfmu3 import CoSimulation, Fmi3SlaveBase, Fmi3Status, Fmi3StepResult, ModelExchange
from pythonfmu3 import __version__ as pythonfmu3_version

from .blocks import PlantSlave
from .description import VariableRow
from .description3 import model_description, variables_of
from .slave import Slave, retain

_Method = TypeVar("_Method", bound=Callable[..., Any])


def _retaining(method: _Method) -> _Method:
    """Return the method; after an exception the instance is never released: the loader drops its references twice."""

    @wraps(method)
    def call(self: "Fmi3Model", *arguments: Any) -> Any:
        try:
            return method(self, *arguments)
        except BaseException:
            if self._is_hosted:
                retain(self, type(self), self.log_queue)
            raise

    return call  # type: ignore[return-value]


def _refusal(verb: str, kind: str) -> Callable[..., list[Any]]:
    """Return a method that gets or sets variables of a type that no variable has."""

    @_retaining
    def call(self: "Fmi3Model", vrs: list[int], values: Iterable[Any] = ()) -> list[Any]:
        if vrs:
            raise ValueError(f"{self.modelName}: value reference {vrs[0]} must not be {verb} as {kind}.")
        return []

    return call


class DiscreteStates(NamedTuple):
    """Results of `update_discrete_states`, with the names that pythonfmu3's library looks for: its Python has others.

    What the library does not find it leaves unwritten, and an importer that does not clear it first never ends.
    """

    discreteStatesNeedUpdate: bool = False
    terminateSimulation: bool = False
    nominalContinuousStatesChanged: bool = False
    valuesOfContinuousStatesChanged: bool = False
    nextEventTimeDefined: bool = False
    nextEventTime: float = 0.0


class Fmi3Model(Fmi3SlaveBase):
    """Common part of both interfaces."""

    model: ClassVar[type[Slave]]
    """Model, as in the FMI 2.0 FMU."""
    interface: ClassVar[str]
    """Name of its element in the model description."""
    capabilities: ClassVar[dict[str, str]]
    """Attributes of that element beyond the common ones."""
    has_feedthrough: ClassVar[bool]
    """True where an unknown depends directly on inputs."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._slave = self.model(**kwargs)
        self._slave.log, self._slave.per_cent = self.log, "%"  # texts are no formats in FMI 3.0
        self._is_hosted = "logger" in kwargs
        self.time = 0.0
        self.modelName = self._slave.modelName
        place = {v.name: i for i, v in enumerate(self.model.variables)}
        self._places = [tuple(place.get(v.name, -1) for v in array.members) for array in variables_of(self.table())]

    @classmethod
    def table(cls) -> tuple[VariableRow, ...]:
        """Return the variables of this interface, as scalars."""
        return cls.model.variables

    # -- FMI calls --------------------------------------------------------------------------------------------

    @_retaining
    def exit_initialization_mode(self) -> None:
        """Freeze the start values, and compute the initial outputs."""
        self._slave.exit_initialization_mode()

    @_retaining
    def get_float64(self, vrs: list[int]) -> list[float]:
        """Return the values of these variables, element by element."""
        places = self._expanded(vrs)
        if -1 not in places:
            return self._slave.get_real(places)
        values = iter(self._slave.get_real([i for i in places if i >= 0]))
        return [self.time if i < 0 else next(values) for i in places]

    @_retaining
    def set_float64(self, vrs: list[int], values: list[float]) -> None:
        """Set inputs, tunable parameters and, before the end of initialisation, everything with a start."""
        self._slave.set_real(self._expanded(vrs, len(values)), values)

    @_retaining
    def get_boolean(self, vrs: list[int]) -> list[bool]:
        """Return the values of these Boolean parameters."""
        return self._slave.get_boolean(self._expanded(vrs))

    @_retaining
    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        """Set these Boolean parameters."""
        self._slave.set_boolean(self._expanded(vrs, len(values)), values)

    get_int32, set_int32 = _refusal("read", "Int32"), _refusal("set", "Int32")
    get_int64, set_int64 = _refusal("read", "Int64"), _refusal("set", "Int64")
    get_uint64, set_uint64 = _refusal("read", "UInt64"), _refusal("set", "UInt64")
    get_string, set_string = _refusal("read", "String"), _refusal("set", "String")

    @_retaining
    def _get_fmu_state(self) -> bytes:
        return self._slave._get_fmu_state()

    @_retaining
    def _set_fmu_state(self, state: bytes) -> None:
        self._slave._set_fmu_state(state)

    _fmu_state_to_bytes = staticmethod(Slave._fmu_state_to_bytes)
    _fmu_state_from_bytes = staticmethod(Slave._fmu_state_from_bytes)

    def to_xml(self, model_options: dict[str, str] | None = None) -> Element:
        """Return the model description; the same table gives the same element."""
        attributes = self._slave.about(f"PythonFMU3 {pythonfmu3_version}")
        attributes["instantiationToken"] = attributes.pop("guid")
        common = {
            "modelIdentifier": self.modelName, "needsExecutionTool": "false",
            "canBeInstantiatedOnlyOncePerProcess": "false",
            "canGetAndSetFMUState": "true", "canSerializeFMUState": "true",
        }  # fmt: skip
        return model_description(
            attributes,
            self.interface,
            common | self.capabilities | (model_options or {}),
            self.log_categories,
            self._slave.times(),
            self.table(),
            self.has_feedthrough,
        )

    # -- inside -----------------------------------------------------------------------------------------------

    def _expanded(self, vrs: Iterable[int], n_values: int | None = None) -> list[int]:
        """Return the places of all elements, -1 for the time.

        Raises ValueError for an unknown value reference, or a wrong number of values.
        """
        known = range(len(self._places))
        unknown = next((vr for vr in vrs if vr not in known), None)
        if unknown is not None:
            raise ValueError(f"{self.modelName}: no variable has the value reference {unknown}.")
        places = [i for vr in vrs for i in self._places[vr]]
        if n_values is not None and n_values != len(places):
            raise ValueError(f"{self.modelName}: {len(places)} values must be set, got {n_values}.")
        return places


class Fmi3CoSimulation(Fmi3Model, CoSimulation):
    """Slave for FMI 3.0 co-simulation."""

    interface = "CoSimulation"
    capabilities = {"canHandleVariableCommunicationStepSize": "true"}

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls.has_feedthrough = cls.model.has_feedthrough

    def do_step(self, current_time: float, step_size: float) -> Fmi3StepResult:
        """Hold the inputs and go on to `current_time + step_size` [s]; a step that cannot be taken changes nothing.

        pythonfmu3 0.3.4 passes on only status and terminateSimulation, and leaves the two other results unwritten.
        """
        if not self._slave.do_step(current_time, step_size):
            return Fmi3StepResult(Fmi3Status.error)
        self.time = current_time + step_size
        return Fmi3StepResult()

    @_retaining
    def _set_fmu_state(self, state: bytes) -> None:
        super()._set_fmu_state(state)
        self.time = self._slave._time

    @_retaining
    def update_discrete_states(self) -> NoReturn:
        """Refuse: only model exchange, and co-simulation with hasEventMode, have an event mode."""
        raise ValueError(
            f"{self.modelName}: it has no event mode, as its model description says (no hasEventMode); "
            "instantiate it with eventModeUsed = false, and do not enter event mode."
        )


class Fmi3ModelExchange(Fmi3Model, ModelExchange):
    """Plant's f(x, u; theta) for FMI 3.0 model exchange: without an integrator or held inputs."""

    model: ClassVar[type[PlantSlave]]
    interface = "ModelExchange"
    capabilities = {"needsCompletedIntegratorStep": "false"}
    has_feedthrough = True

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        derivatives = {v.derivative: i for i, v in enumerate(self.model.variables) if v.derivative is not None}
        self._rates = list(derivatives.values())
        self._states = [i for i, v in enumerate(self.model.variables) if v.name in derivatives]
        self._later: frozenset[int] | None = None

    @classmethod
    def table(cls) -> tuple[VariableRow, ...]:
        """Return the variables of this interface, as scalars."""
        return cls.model.exchange_table()

    @_retaining
    def exit_initialization_mode(self) -> None:
        """Freeze the start values. The Slave stays in initialisation, so that its derivatives follow the inputs."""
        self._slave.get_real(self._rates)
        variables = enumerate(self.model.variables)
        self._later = frozenset(i for i, v in variables if v.causality == "input" or v.variability == "tunable")

    @_retaining
    def set_float64(self, vrs: list[int], values: list[float]) -> None:
        """Set inputs, tunable parameters and, before the end of initialisation, states."""
        places = self._expanded(vrs, len(values))
        frozen = () if self._later is None else [i for i in places if i not in self._later]
        if frozen:
            name = "time" if frozen[0] < 0 else self.model.variables[frozen[0]].name
            raise ValueError(f"{self.modelName}: {name} must not be set after initialisation.")
        self._slave.set_real(places, values)

    @_retaining
    def set_time(self, time: float) -> None:
        """Set the time [s], on which no plant depends."""
        self.time = time

    def update_discrete_states(self) -> DiscreteStates:
        """Return that there are no discrete states, and no events."""
        return DiscreteStates()

    def get_number_of_continuous_states(self) -> int:
        """Return the number n of states, every element counted."""
        return len(self._states)

    @_retaining
    def get_continuous_states(self) -> list[float]:
        """Return x (n,), in the order of the model structure."""
        return self._slave.get_real(self._states)

    @_retaining
    def set_continuous_states(self, values: list[float]) -> None:
        """Set x (n,), in the order of the model structure."""
        self._slave.set_real(self._states, values)

    def get_continuous_state_derivatives(self) -> list[float]:
        """Return x_dot (n,) = f(x, u; theta), or NaN and a log entry where undefined: exceptions crash the loader."""
        try:
            return self._slave.get_real(self._rates)
        except Exception:  # logged by the Slave
            return [nan] * len(self._rates)

    def get_nominals_of_continuous_states(self, size: int) -> list[float]:
        """Return typical sizes (n,) of the states."""
        return [self.model.variables[i].nominal or 1.0 for i in self._states]
