"""FMI 2.0 co-simulation slave defined by a variable table; `blocks` has the kinds of model based on it.

Life cycle:
1. set parameters, inputs and states; `setup_experiment`, `exit_initialization_mode`;
2. at each communication point: set inputs and tunable parameters, `do_step`, get outputs.
A set marks the outputs stale, and the next get computes them all once.

A step that cannot be taken is discarded, and the variables are as before. pythonfmu's library makes a fatal status of
every exception, and drops its references to the instance; `retain` keeps it usable: reset, set state and free work.
"""

import json
import sys
import traceback
from collections.abc import Callable
from ctypes import py_object, pythonapi
from functools import wraps
from typing import Any, ClassVar, TypeVar
from uuid import NAMESPACE_DNS, uuid5
from xml.etree.ElementTree import Element

from pythonfmu import DefaultExperiment, Fmi2Slave
from pythonfmu import __version__ as pythonfmu_version
from pythonfmu.enums import Fmi2Status

from . import refusals
from .description import VariableRow, model_description

NAMESPACE = uuid5(NAMESPACE_DNS, "fmu-retune")
_Method = TypeVar("_Method", bound=Callable[..., Any])


def _logged(method: _Method) -> _Method:
    """Return the method, with the traceback of its exceptions sent to the FMI logger."""

    @wraps(method)
    def call(self: "Slave", *arguments: Any) -> Any:
        try:
            return method(self, *arguments)
        except BaseException as error:
            self._report(error)
            raise

    return call  # type: ignore[return-value]


def retain(*objects: object) -> None:
    """Take one reference to each object and never release it: pythonfmu's loader drops some that it does not own."""
    for obj in objects:
        pythonapi.Py_IncRef(py_object(obj))


class Slave(Fmi2Slave):
    """FMI 2.0 co-simulation slave; a variable's place in a flat list (parameters, inputs, outputs) is its reference."""

    table: ClassVar[tuple[VariableRow, ...]] = ()
    """Variables that the model declares, in any order within parameters, inputs and outputs."""
    default_experiment: ClassVar[DefaultExperiment] = DefaultExperiment(0.0, 10.0, 0.01)
    """Start, stop and step [s]."""
    has_feedthrough: ClassVar[bool] = True
    """True where an output depends directly on inputs."""
    variables: ClassVar[tuple[VariableRow, ...]] = ()
    """Complete table; a position is a value reference."""
    per_cent = "%%"
    """A per cent sign in texts for the logger, which are printf formats in FMI 2.0."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if cls.__module__ in sys.modules:
            # At every load the loader runs the script once more, then drops a reference to its namespace.
            retain(vars(sys.modules[cls.__module__]))
        cls.variables = cls._complete(cls.table)
        n_parameters, n_inputs = (sum(v.causality == c for v in cls.variables) for c in ("parameter", "input"))
        n_exact = sum(v.start is not None for v in cls.variables)
        cls._parameters, cls._inputs = slice(0, n_parameters), slice(n_parameters, n_parameters + n_inputs)
        cls._states, cls._outputs = slice(n_parameters + n_inputs, n_exact), slice(n_exact, None)
        cls._given = slice(0, n_exact)  # what is set from outside: parameters, inputs, states
        is_later = [v.causality == "input" or v.variability == "tunable" for v in cls.variables]
        cls._of_type = {
            kind: frozenset(i for i, v in enumerate(cls.variables) if v.type == kind)
            for kind in ("Real", "Integer", "Boolean", "String")
        }
        given = cls.variables[:n_exact]
        cls._bounds, cls._latched_bounds = (refusals.bounds_of(given, is_latched) for is_latched in (False, True))
        cls._settable = {False: frozenset(range(n_exact)), True: frozenset(i for i, b in enumerate(is_later) if b)}

    @classmethod
    def _complete(cls, table: tuple[VariableRow, ...]) -> tuple[VariableRow, ...]:
        order = ("parameter", "input", "output")
        return tuple(sorted(table, key=lambda v: order.index(v.causality)))

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.guid = uuid5(NAMESPACE, self.modelName)
        self.description = (type(self).__doc__ or "").splitlines()[0]
        self._values: list[float] = [0.0 if v.start is None else v.start for v in self.variables]
        self._hidden: list[float] = []  # states that are no variables
        self._time = 0.0
        self._next: float | None = None  # where the next step must begin, once that is known
        self._is_stale = self._is_unchecked = True
        self._enter(is_initialized=False)
        self._is_hosted = "logger" in kwargs
        try:
            self._prepare()
        except BaseException as error:
            self._report(error)
            if sys.stderr is not None:  # pythonfmu logs a failed instantiation only where the host enables its log
                print(error, file=sys.stderr)
            raise

    # -- what a kind of model defines -------------------------------------------------------------------------

    def _prepare(self) -> None:
        """Acquire external resources; any exception makes the instantiation fail."""

    def _refresh(self) -> None:
        """Compute every calculated output from parameters, inputs and states."""
        raise NotImplementedError

    def _advance(self, step_size: float) -> None:
        """Move from one communication point to the next; `_time` is the new one."""

    # -- FMI calls --------------------------------------------------------------------------------------------

    @_logged
    def setup_experiment(
        self, start_time: float, stop_time: float | None = None, tolerance: float | None = None
    ) -> None:
        """Start at `start_time` [s]."""
        self._time, self._next, self._is_stale = start_time, start_time, True

    @_logged
    def exit_initialization_mode(self) -> None:
        """Freeze the start values, and compute the initial outputs."""
        self._update()
        self._enter(is_initialized=True)

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Hold the inputs and go on to `current_time + step_size` [s]; False, with a log entry, discards the step."""
        before = self._values.copy(), self._hidden, self._time, self._next
        try:
            self._step(current_time, step_size)
        except Exception as error:
            self._values, self._hidden, self._time, self._next = before
            self._is_stale = self._is_unchecked = True
            self._log_error(error)
            return False
        return True

    @_logged
    def get_real(self, vrs: list[int]) -> list[float]:
        """Return the values of these variables."""
        self._must_be(vrs, "Real")
        if self._is_stale:
            self._update()
        values = self._values
        return [values[vr] for vr in vrs]

    @_logged
    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Set inputs, tunable parameters and, before the end of initialisation, everything with a start."""
        if not self._settable_reals.issuperset(vrs):
            self._refuse(vrs, self._settable_reals, "Real")
        own = self._values
        for vr, value in zip(vrs, values):
            own[vr] = value
        self._is_stale = self._is_unchecked = True

    @_logged
    def get_integer(self, vrs: list[int]) -> list[int]:
        """Return the values of these Integer variables."""
        self._must_be(vrs, "Integer")
        if self._is_stale:
            self._update()
        return [int(self._values[vr]) for vr in vrs]

    @_logged
    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        """Set these Integer variables."""
        self._set(vrs, values, "Integer")

    @_logged
    def get_boolean(self, vrs: list[int]) -> list[bool]:
        """Return the values of these Boolean variables."""
        self._must_be(vrs, "Boolean")
        if self._is_stale:
            self._update()
        return [bool(self._values[vr]) for vr in vrs]

    @_logged
    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        """Set these Boolean variables."""
        self._set(vrs, [bool(value) for value in values], "Boolean")

    @_logged
    def get_string(self, vrs: list[int]) -> list[str]:
        """Refuse: no variable is a String."""
        self._must_be(vrs, "String")
        return []

    @_logged
    def set_string(self, vrs: list[int], values: list[str]) -> None:
        """Refuse: no variable is a String."""
        self._set(vrs, [], "String")

    @_logged
    def _get_fmu_state(self) -> bytes:
        """Return the complete state as JSON, which keeps numbers exactly."""
        state = {"model": self.modelName, "time": self._time, "next": self._next}
        state |= {"is_initialized": self._is_initialized, "values": self._values, "hidden": self._hidden}
        return json.dumps(state).encode()

    @_logged
    def _set_fmu_state(self, state: bytes) -> None:
        saved = json.loads(state)
        if saved["model"] != self.modelName or len(saved["values"]) != len(self._values):
            raise ValueError(f"{self.modelName}: the FMU state must be one of its own, got one of {saved['model']}.")
        self._values, self._hidden = saved["values"], saved["hidden"]
        self._time, self._next = saved["time"], saved["next"]
        self._enter(saved["is_initialized"])
        self._is_stale = self._is_unchecked = True

    # An FMU state is its own serialisation, so the loader's two class-level calls cannot fail.
    @staticmethod
    def _fmu_state_to_bytes(state: bytes) -> bytes:
        return state

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> bytes:
        return state

    def to_xml(self, model_options: dict[str, str] | None = None) -> Element:
        """Return the model description; the same table gives the same element."""
        capabilities = {
            "modelIdentifier": self.modelName, "needsExecutionTool": "false",
            "canHandleVariableCommunicationStepSize": "true", "canBeInstantiatedOnlyOncePerProcess": "false",
            "canNotUseMemoryManagementFunctions": "true",
            "canGetAndSetFMUstate": "true", "canSerializeFMUstate": "true",
        }  # fmt: skip
        return model_description(
            self.about(f"PythonFMU {pythonfmu_version}"),
            capabilities | (model_options or {}),
            self.log_categories,
            self.times(),
            self.variables,
            self.has_feedthrough,
        )

    def about(self, tool: str) -> dict[str, str]:
        """Return the attributes of the model description that FMI 2.0 and 3.0 share, and the guid."""
        return {
            "modelName": self.modelName, "guid": str(self.guid), "description": self.description,
            "author": "The fmu-retune authors", "copyright": "2026 The fmu-retune authors", "license": "MIT",
            "generationTool": tool, "variableNamingConvention": "structured",
        }  # fmt: skip

    def times(self) -> dict[str, str]:
        """Return the attributes of the default experiment."""
        times = type(self).default_experiment  # pythonfmu sets an empty one on the instance
        values = {"startTime": times.start_time, "stopTime": times.stop_time, "stepSize": times.step_size}
        return {name: repr(value) for name, value in values.items()}

    def log(self, msg: str, status: Fmi2Status = Fmi2Status.ok, category: str | None = None, debug: Any = None) -> None:
        """Send a message to the FMI logger."""
        super().log(msg.replace("%", self.per_cent), status, category, debug)

    # -- inside -----------------------------------------------------------------------------------------------

    def _enter(self, is_initialized: bool) -> None:
        self._is_initialized = is_initialized
        self._settable_reals = self._settable[is_initialized] & self._of_type["Real"]

    def _step(self, current_time: float, step_size: float) -> None:
        self._demand_none(refusals.of_step(self._next, current_time, step_size))
        if self._is_unchecked:
            self._check()
        self._time = self._next = current_time + step_size
        self._advance(step_size)

    def _must_be(self, vrs: list[int], kind: str) -> None:
        if not self._of_type[kind].issuperset(vrs):
            wrong = next(vr for vr in vrs if vr not in self._of_type[kind])
            self._demand_none(refusals.of_read(self.variables, wrong, kind))

    def _set(self, vrs: list[int], values: list[float], kind: str) -> None:
        settable = self._settable[self._is_initialized] & self._of_type[kind]
        if not settable.issuperset(vrs):
            self._refuse(vrs, settable, kind)
        for vr, value in zip(vrs, values):
            self._values[vr] = value
        self._is_stale = self._is_unchecked = True

    def _update(self) -> None:
        if self._is_unchecked:
            self._check()
        self._refresh()
        self._is_stale = False

    def _check(self) -> None:
        self._demand_none(refusals.of_values(self.variables, self._values[self._given]))
        self._must_be_within(self._bounds)
        self._is_unchecked = False

    def _must_be_within(self, bounds: list[refusals.Bounds]) -> None:
        self._demand_none(refusals.of_bounds(self.variables, self._values, bounds))

    def _refuse(self, vrs: list[int], settable: frozenset[int], kind: str) -> None:
        wrong = next(vr for vr in vrs if vr not in settable)
        when = "after" if self._is_initialized else "before the end of"
        name = refusals.named(self.variables, wrong)
        self._demand_none(f"{name} must not be set as {kind} {when} initialisation.")

    def _demand_none(self, problem: str | None) -> None:
        if problem is not None:
            raise ValueError(f"{self.modelName}: {problem}")

    def _log_error(self, error: BaseException) -> None:
        self.log("".join(traceback.format_exception(error)), Fmi2Status.error)

    def _report(self, error: BaseException) -> None:
        self._log_error(error)
        if self._is_hosted:
            # The loader drops its references at every exception, and again at the end. It also logs repr(error).
            retain(self, type(self), self.log_queue)
            error.args = tuple(a.replace("%", self.per_cent) if isinstance(a, str) else a for a in error.args)
