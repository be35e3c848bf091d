"""One FMU seen from outside: by variable names, in its own process unless told otherwise.

with open_slave(Path("Pendulum.fmu"), "plant") as plant:
    plant.bind(inputs=["u"], tunables=["m", "l"], outputs=["phi", "phi_dot"])
    plant.initialize({"phi": 1.0}, start_time=0.0, stop_time=10.0)
    phi, phi_dot = plant.get()
    phi, phi_dot = plant.step([0.0], t=0.0, h=0.01)
"""

import difflib
import logging
import math
import os
import shutil
import sys
import tempfile
import weakref
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, Protocol, Self, SupportsFloat

import fmpy
from fmpy.model_description import CoSimulation, ModelDescription, ModelVariable

from .errors import COLON, ModelDescriptionError, SlaveError, WiringError, one_line
from .instance import Identity, Instance, Value, Variable
from .worker import Worker

Isolation = Literal["process", "none"]

_LARGEST: Final = sys.float_info.max
_DEFAULT_RANGE: Final = {"Real": (-_LARGEST, _LARGEST), "Integer": (-(2.0**31) + 1, 2.0**31 - 1), "Boolean": (0.0, 1.0)}
_PYTHON_TYPE: Final[dict[str, type]] = {"Real": float, "Integer": int, "Boolean": bool, "String": str}
_log = logging.getLogger(__name__)


def open_slave(fmu: Path, instance_name: str, *, isolation: Isolation = "process", timeout: float = 10.0) -> "Slave":
    """An FMU 2.0 for co-simulation, unpacked into a private folder and loaded.

    isolation "process" (the default) gives it a process of its own, and returns while it is still loading: open
    several and they load at the same time. "none" loads it into this process: for trusted native FMUs.
    timeout is the time each call may take [s]; only a process of its own can be held to it.

    Raises ModelDescriptionError for a bad file, SlaveError when loading fails (isolated: in the first call).
    """
    if not (math.isfinite(timeout) and timeout > 0):
        raise ValueError(f"timeout must be positive and finite, got {timeout} s.")
    if isolation not in ("process", "none"):
        raise ValueError(f"isolation must be 'process' or 'none', got {isolation!r}.")
    description = read_description(fmu)
    folder = tempfile.mkdtemp(prefix="fmu-retune-")
    try:
        unpack(fmu, folder)
        identity = Identity(
            folder,
            str(_interface(description).modelIdentifier),
            str(description.guid),
            instance_name,
            "pythonfmu" in (description.generationTool or "").lower(),
        )
        home = Worker(identity, timeout) if isolation == "process" else SameProcess(identity)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return Slave(fmu, instance_name, description, home, folder)


def read_description(fmu: Path) -> ModelDescription:
    """The model description of an FMU that this machine can co-simulate. Raises ModelDescriptionError."""
    try:
        with open(fmu, "rb") as file:  # given a path, FMPy leaves the file open when the XML is damaged
            description = fmpy.read_model_description(file)
            platforms: list[str] = fmpy.supported_platforms(file)
    except OSError as error:
        raise ModelDescriptionError(f"{fmu} cannot be read: {error.strerror or error}") from error
    except Exception as error:  # FMPy raises what the zip, XML and validation code happens to raise
        raise ModelDescriptionError(f"{fmu} is not a usable FMU: {one_line(_text_of(error))}") from error
    interface = description.coSimulation
    if description.fmiVersion != "2.0" or interface is None:
        kind = "co-simulation" if interface is not None else "model-exchange"
        raise ModelDescriptionError(f"{fmu} is an FMI {description.fmiVersion} {kind} FMU, not FMI 2.0 co-simulation.")
    if not str(interface.modelIdentifier).isidentifier():  # it becomes a file name
        raise ModelDescriptionError(f"{fmu} has the model identifier {interface.modelIdentifier!r}, not a C name.")
    if fmpy.platform not in platforms:
        offer = f"only for {', '.join(platforms)}" if platforms else "nor for any other platform"
        raise ModelDescriptionError(f"{fmu} has no binary for {fmpy.platform}, {offer}.")
    return description


def unpack(fmu: Path, folder: str) -> None:
    """Extract an FMU into folder. Raises ModelDescriptionError, for names that lead out of folder before any write."""
    try:
        with zipfile.ZipFile(fmu) as archive:
            for name in archive.namelist():
                if name.startswith("/") or ".." in name.split("/") or "\\" in name or ":" in name:
                    raise ModelDescriptionError(f"{fmu} holds a file that would be put outside its folder: {name!r}")
            archive.extractall(folder)
    except (zipfile.BadZipFile, zlib.error, OSError, RuntimeError, ValueError) as error:
        raise ModelDescriptionError(f"{fmu} cannot be unpacked: {one_line(_text_of(error))}") from error


def _interface(description: ModelDescription) -> CoSimulation:
    """The co-simulation part of a description that read_description has let through."""
    assert description.coSimulation is not None
    return description.coSimulation


def _text_of(error: Exception) -> str:
    return str(error.args[0] if isinstance(error, KeyError) else error) or type(error).__name__


class Home(Protocol):
    """Where an Instance lives: a Worker or SameProcess."""

    def bind(self, inputs: Sequence[Variable], tunables: Sequence[Variable], outputs: Sequence[Variable]) -> None: ...
    def call(self, function: str, t: float | None, *arguments: object) -> Any: ...
    def begin_step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> None: ...
    def end_step(self, t: float) -> tuple[float, ...]: ...
    def close(self, t: float | None, is_polite: bool) -> None: ...


class SameProcess:
    """An Instance in this process: a call that hangs is waited for, and a crash ends this process."""

    def __init__(self, identity: Identity) -> None:
        self._instance = Instance(identity)
        self.bind = self._instance.bind

    def call(self, function: str, t: float | None, *arguments: object) -> Any:
        return getattr(self._instance, function)(*arguments)

    def begin_step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> None:
        self._step = (t, h, tuple(inputs), None if tunables is None else tuple(tunables))

    def end_step(self, t: float) -> tuple[float, ...]:
        return self._instance.step(*self._step)

    def close(self, t: float | None, is_polite: bool) -> None:
        if is_polite:
            self._instance.close()


class Ports:
    """Variables whose values cross together: their names, and the values they may have."""

    def __init__(self, role: str, variables: Sequence[ModelVariable]) -> None:
        self.variables = [Variable(v.name, _type_of(v), v.valueReference) for v in variables]
        self._role = role
        self._units = [_attribute(v, "unit") or "" for v in variables]
        self._ranges = [_range_of(v) for v in variables]
        self._whole = [i for i, v in enumerate(self.variables) if v.type != "Real"]

    def problem(self, values: Sequence[float]) -> str | None:
        """What is wrong with the first value that is not finite, outside [min, max] or not of its type, or None."""
        for value, (low, high) in zip(values, self._ranges, strict=True):
            if not low <= value <= high:  # NaN is in no range
                return self._describe(values)
        for i in self._whole:
            if values[i] != int(values[i]):
                return f"{self._role} {self.variables[i].name!r} must be a whole number, got {values[i]:g}"
        return None

    def _describe(self, values: Sequence[float]) -> str:
        for variable, unit, value, (low, high) in zip(self.variables, self._units, values, self._ranges, strict=True):
            if not math.isfinite(value):
                return f"{self._role} {variable.name!r} is {value:g}"
            if not low <= value <= high:
                span = f"[{_bound(low)}, {_bound(high)}] {unit}".rstrip()
                return f"{self._role} {variable.name!r} must be within {span}, got {value:.9g}"
        raise AssertionError("called for values that are all right")


class Slave:
    """One FMU. Its life: bind, initialize, any number of step (or begin_step, end_step) and get, close.

    After a SlaveError that the FMU has caused only close may be called; a value that is refused before it reaches the
    FMU leaves the slave as it was.
    """

    def __init__(self, fmu: Path, instance_name: str, description: ModelDescription, home: Home, folder: str) -> None:
        """Made by open_slave."""
        self.fmu = fmu
        self.name = instance_name
        self.description = description
        self._variables: dict[str, ModelVariable] = {v.name: v for v in description.modelVariables}
        self._home = home
        self._time: float | None = None
        self._fault: SlaveError | None = None
        self._end_of_step: float | None = None
        self._values: tuple[float, ...] | None = None
        self._inputs, self._tunables, self._outputs = (Ports(role, ()) for role in ("input", "parameter", "output"))
        self._finalizer = weakref.finalize(self, _release, home, folder, os.getpid())

    def bind(self, inputs: Sequence[str] = (), tunables: Sequence[str] = (), outputs: Sequence[str] = ()) -> None:
        """Say which variables are set and got at communication points, and in which order.

        inputs must have causality input, tunables be tunable parameters; outputs may be anything but a String.
        Raises WiringError, SlaveError.
        """
        self._inputs = Ports("input", [self._find(name, "input") for name in inputs])
        self._tunables = Ports("parameter", [self._find(name, "tunable parameter") for name in tunables])
        self._outputs = Ports("output", [self._find(name, "output") for name in outputs])
        self._values = None
        ports = (self._inputs, self._tunables, self._outputs)
        for names in (inputs, tunables):
            if len(set(names)) != len(names):
                raise WiringError(f"{self.name}: a variable is bound twice in {', '.join(names)}")
        self._guarded(self._home.bind, *(port.variables for port in ports))

    def initialize(self, start: Mapping[str, Value], start_time: float = 0.0, stop_time: float | None = None) -> None:
        """Set start values by name and go through initialization mode; times in s.

        Raises WiringError for a variable that takes no start value or one of another type, SlaveError.
        """
        values = [self._start_value(name, value, start_time) for name, value in start.items()]
        self._guarded(self._home.call, "initialize", start_time, values, start_time, stop_time)
        self._time = start_time
        self._values = None

    def get(self) -> tuple[float, ...]:
        """The bound outputs at the present communication point. Raises SlaveError."""
        self._must_be_usable()
        if self._values is None:
            values = tuple(self._guarded(self._home.call, "get", self._time))
            self._values = self._checked_outputs(values)
        return self._values

    def begin_step(self, inputs: Sequence[float], t: float, h: float, tunables: Sequence[float] | None = None) -> None:
        """Start a step from t to t + h [s] with these inputs, after setting the tunables unless they are None.

        Raises SlaveError, ValueError for another number of values than bound.
        """
        self._refuse(self._inputs, inputs, t)
        if tunables is not None:
            self._refuse(self._tunables, tunables, t)
        self._guarded(self._home.begin_step, t, h, inputs, tunables)
        self._time, self._end_of_step = t, t + h

    def end_step(self) -> tuple[float, ...]:
        """Wait for the step; the bound outputs after it. Raises SlaveError."""
        end, self._end_of_step = self._end_of_step, None
        if end is None:
            raise RuntimeError(f"{self.name}: end_step must follow begin_step.")
        values = self._guarded(self._home.end_step, self._time)
        self._time = end
        self._values = self._checked_outputs(values)
        return values

    def step(
        self, inputs: Sequence[float], t: float, h: float, tunables: Sequence[float] | None = None
    ) -> tuple[float, ...]:
        """begin_step and end_step."""
        self.begin_step(inputs, t, h, tunables)
        return self.end_step()

    def get_state(self) -> bytes:
        """The FMU's state, for set_state of a slave of the same FMU. Raises SlaveError."""
        self._must_have_states("get_state")
        return self._guarded(self._home.call, "get_state", self._time)

    def set_state(self, state: bytes) -> None:
        """Go back to a state. Raises SlaveError."""
        self._must_have_states("set_state")
        self._guarded(self._home.call, "set_state", self._time, state)
        self._values = None

    def close(self) -> None:
        """Terminate and free the FMU, within a few seconds or by force, and remove its folder; idempotent.

        An FMU that fails here is logged as a warning: what it has computed is not touched by it.
        """
        if not self._finalizer.alive:
            return
        try:
            self._home.close(self._time, self._fault is None)
        except SlaveError as error:
            _log.warning("%s", error)
        finally:
            self._finalizer()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _must_be_usable(self) -> None:
        if self._fault is not None or not self._finalizer.alive:
            raise RuntimeError(f"{self.name} must not be called after {self._fault or 'close'}.")
        if self._end_of_step is not None:
            raise RuntimeError(f"{self.name}: begin_step must be followed by end_step.")

    def _guarded(self, function: Any, *arguments: Any) -> Any:
        """Call the FMU unless it is closed, has failed before, or is in a step."""
        self._must_be_usable()
        try:
            return function(*arguments)
        except SlaveError as error:
            self._fault = error
            raise

    def _checked_outputs(self, values: tuple[float, ...]) -> tuple[float, ...]:
        problem = self._outputs.problem(values)
        if problem is not None:
            self._fault = SlaveError(self.name, "get", self._time, problem, COLON)
            raise self._fault
        return values

    def _refuse(self, ports: Ports, values: Sequence[float], t: float) -> None:
        if len(values) != len(ports.variables):
            raise ValueError(f"{self.name}: {len(ports.variables)} values must be set, got {len(values)}.")
        problem = ports.problem(values)
        if problem is not None:
            raise SlaveError(self.name, "set", t, problem, COLON)

    def _must_have_states(self, function: str) -> None:
        interface = _interface(self.description)
        if not (interface.canGetAndSetFMUstate and interface.canSerializeFMUstate):
            reason = f"{self.fmu.name} cannot save and restore its state"
            raise SlaveError(self.name, function, self._time, reason, COLON)

    def _find(self, name: str, role: str) -> ModelVariable:
        """The variable of that name, if it may play the role that bind gives it."""
        variable = self._known(name)
        kind = _kind_of(variable)
        if role != "output" and kind != role:
            raise WiringError(f"{name!r} of {self.fmu.name} is {_with_article(kind)}, not {_with_article(role)}.")
        if variable.type == "String":
            raise WiringError(f"{name!r} of {self.fmu.name} is a String and cannot be exchanged.")
        return variable

    def _known(self, name: str) -> ModelVariable:
        variable = self._variables.get(name)
        if variable is not None:
            return variable
        message = f"no variable {name!r} in {self.fmu.name}"
        for match in difflib.get_close_matches(name, self._variables, n=1):
            message += f"; did you mean {match!r} ({_with_article(_kind_of(self._variables[match]))})?"
        raise WiringError(message)

    def _start_value(self, name: str, value: Value, t: float) -> tuple[str, str, int, Value]:
        variable = self._known(name)
        takes_start = variable.causality == "input" or variable.initial in ("exact", "approx")
        if not takes_start or variable.variability == "constant" or variable.causality == "independent":
            kind = _with_article(_kind_of(variable))
            initial = f", initial {variable.initial}" if variable.initial else ""
            raise WiringError(f"{name!r} of {self.fmu.name} takes no start value: it is {kind}{initial}.")
        ports = Ports(_kind_of(variable), [variable])
        kind = ports.variables[0].type
        is_fit = isinstance(value, str) if kind == "String" else isinstance(value, SupportsFloat)
        if not is_fit or (isinstance(value, bool) and kind != "Boolean"):
            raise WiringError(f"{name!r} of {self.fmu.name} is a {kind} and cannot start as {value!r}.")
        if kind != "String":
            self._refuse(ports, [float(value)], t)
        return name, kind, variable.valueReference, _PYTHON_TYPE[kind](value)


def _kind_of(variable: ModelVariable) -> str:
    """What a variable is, in words: 'input', 'tunable parameter', 'local variable', ..."""
    if variable.variability == "constant":
        return "constant"
    if variable.causality == "parameter":
        return f"{variable.variability} parameter"
    return {"calculatedParameter": "calculated parameter", "local": "local variable"}.get(
        variable.causality, str(variable.causality)
    )


def _with_article(kind: str) -> str:
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"


def _type_of(variable: ModelVariable) -> str:
    return "Integer" if variable.type == "Enumeration" else str(variable.type)


def _attribute(variable: ModelVariable, name: str) -> str | None:
    """The unit, min or max of a variable: its own, or its declared type's."""
    own = getattr(variable, name)
    return own if own is not None or variable.declaredType is None else getattr(variable.declaredType, name)


def _range_of(variable: ModelVariable) -> tuple[float, float]:
    """The finite numbers that a variable may be."""
    low, high = _DEFAULT_RANGE.get(_type_of(variable), (-_LARGEST, _LARGEST))
    declared_low, declared_high = _attribute(variable, "min"), _attribute(variable, "max")
    return (
        low if declared_low is None else max(low, float(declared_low)),
        high if declared_high is None else min(high, float(declared_high)),
    )


def _bound(bound: float) -> str:
    return f"{math.copysign(math.inf, bound):g}" if abs(bound) == _LARGEST else f"{bound:.10g}"


def _release(home: Home, folder: str, process_id: int) -> None:
    """Leave nothing behind: called by close, when a slave is forgotten, or at the end of the program."""
    if os.getpid() == process_id:  # not in a fork of it
        home.close(None, is_polite=False)
        shutil.rmtree(folder, ignore_errors=True)
