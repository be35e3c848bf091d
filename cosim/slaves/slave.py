"""One FMU seen from outside: by variable names, in its own process unless told otherwise.

with open_slave(Path("Pendulum.fmu"), "plant") as plant:
    plant.bind(inputs=["u"], tunables=["m", "l"], outputs=["phi", "phi_dot"])
    plant.initialize({"phi": 1.0}, start_time=0.0, stop_time=10.0)
    phi, phi_dot = plant.get()
    phi, phi_dot = plant.step([0.0], t=0.0, h=0.01)
"""

import logging
import math
import os
import weakref
from collections.abc import Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any, Literal, Self

from fmpy.model_description import ModelDescription

from ..errors import COLON, NotResumableError, SlaveError, StateTooLargeError, WiringError, seconds
from ..fmi.archive import co_simulation, unpacked
from ..fmi.fmi2_co_simulation import LARGEST_STATE, Identity
from ..fmi.folder import PrivateFolder
from ..fmi.ports import Catalogue, Ports
from ..fmi.step_batch import decode_outputs, encode_steps
from ..fmi.value_buffers import PYTHON_TYPE, Value
from .host import Host, InProcessFmu
from .process import FmuProcess

Isolation = Literal["process", "none"]

_log = logging.getLogger(__name__)


OutOfRange = Literal["fault", "warning"]


def open_slave(
    fmu: Path | str,
    instance_name: str,
    *,
    isolation: Isolation = "process",
    timeout: float = 10.0,
    out_of_range: OutOfRange = "fault",
    memory_limit: float = 0.0,
) -> "Slave":
    """An FMU for co-simulation, FMI 2.0 or 3.0, unpacked into a private folder and loaded.

    isolation "process" (the default) gives it a process of its own, and returns while it is still loading: open
    several and they load at the same time. "none" loads it into this process: for trusted native FMUs.
    timeout is the time each call may take [s], memory_limit what its process may hold [MB] (0: half of the
    machine's memory; Linux); only a process of its own can be held to them.
    out_of_range is what an input or output outside its declared min and max is: a fault, or a warning, given once.

    Raises ModelDescriptionError for a bad file, SlaveError when loading fails (isolated: in the first call).
    """
    if not (math.isfinite(timeout) and timeout > 0):
        raise ValueError(f"timeout must be positive and finite, got {timeout} s.")
    if isolation not in ("process", "none"):
        raise ValueError(f"isolation must be 'process' or 'none', got {isolation!r}.")
    fmu = Path(fmu)
    description, folder = unpacked(fmu)
    try:
        identity = Identity(
            folder.path,
            str(co_simulation(description).modelIdentifier),
            str(description.guid),
            instance_name,
            "pythonfmu" in (description.generationTool or "").lower(),
            "fmi2" if description.fmiVersion == "2.0" else "fmi3",
        )
        host = (
            FmuProcess(identity, timeout, memory_limit=memory_limit)
            if isolation == "process"
            else InProcessFmu(identity)
        )
    except BaseException:
        folder.remove()
        raise
    return Slave(fmu, instance_name, description, host, folder, out_of_range)


class _Phase(Enum):
    """How far an FMU's life has come; the value says what brings it there."""

    INSTANTIATED = "must come before initialize"
    INITIALIZING = "must follow enter_initialization"
    RUNNING = "must follow initialize"


class Slave:
    """One FMU. Its life: bind, initialize, any number of step (or begin_step, end_step) and get, close.

    After a SlaveError that the FMU has caused only close may be called; a value that is refused before it reaches the
    FMU leaves the slave as it was. A call out of order does not reach the FMU: it raises RuntimeError.
    """

    def __init__(
        self,
        fmu: Path,
        instance_name: str,
        description: ModelDescription,
        host: Host,
        folder: PrivateFolder,
        out_of_range: OutOfRange = "fault",
    ) -> None:
        """Made by open_slave."""
        self.fmu = fmu
        self.name = instance_name
        self.description = description
        self._catalogue = Catalogue(fmu.name, description.modelVariables)
        self._host = host
        self._phase = _Phase.INSTANTIATED
        self._time: float | None = None
        self._fault: SlaveError | None = None
        self._end_of_step: float | None = None
        self._is_lenient = out_of_range == "warning"
        self._strayed: set[str] = set()
        self._values: tuple[float, ...] | None = None
        self._inputs, self._tunables, self._outputs = (Ports(role, ()) for role in ("input", "parameter", "output"))
        self._finalizer = weakref.finalize(self, _release, host, folder, os.getpid())

    def bind(self, inputs: Sequence[str] = (), tunables: Sequence[str] = (), outputs: Sequence[str] = ()) -> None:
        """Say which variables are set and got at communication points, and in which order.

        inputs must have causality input, tunables be tunable parameters; outputs may be anything but a String.
        Raises WiringError, SlaveError.
        """
        for names in (inputs, tunables):
            if len(set(names)) != len(names):
                raise WiringError(f"{self.name}: a variable is bound twice in {', '.join(names)}")
        self._inputs = self._catalogue.ports("input", inputs, self._is_lenient)
        self._tunables = self._catalogue.ports("tunable parameter", tunables)
        self._outputs = self._catalogue.ports("output", outputs, self._is_lenient)
        self._values = None
        ports = (self._inputs, self._tunables, self._outputs)
        self._guarded(self._host.bind, *(port.variables for port in ports))

    def initialize(self, start: Mapping[str, Value], start_time: float = 0.0, stop_time: float | None = None) -> None:
        """Set start values by name and go through initialization mode; times in s.

        Raises WiringError for a variable that takes no start value or one of another type, SlaveError.
        """
        self._must_be("initialize", _Phase.INSTANTIATED)
        values = [self._start_value(name, value, start_time) for name, value in start.items()]
        self._guarded(self._host.call, "initialize", start_time, values, start_time, stop_time)
        self._time, self._phase, self._values = start_time, _Phase.RUNNING, None

    def enter_initialization(
        self, start: Mapping[str, Value], start_time: float = 0.0, stop_time: float | None = None
    ) -> None:
        """As initialize, but stay in initialization mode, for propagate and exit_initialization."""
        self._must_be("enter_initialization", _Phase.INSTANTIATED)
        values = [self._start_value(name, value, start_time) for name, value in start.items()]
        self._guarded(self._host.call, "enter_initialization", start_time, values, start_time, stop_time)
        self._time, self._phase = start_time, _Phase.INITIALIZING

    def propagate(self, inputs: Sequence[float] | None) -> tuple[float, ...]:
        """The bound outputs in initialization mode, after setting the inputs unless they are None.

        On the way to consistent values ranges are not looked at. Raises SlaveError.
        """
        self._must_be("propagate", _Phase.INITIALIZING)
        if inputs is not None and len(inputs) != len(self._inputs.variables):
            raise ValueError(f"{self.name}: {len(self._inputs.variables)} values must be set, got {len(inputs)}.")
        return tuple(self._guarded(self._host.call, "propagate", self._time, inputs))

    def exit_initialization(self) -> None:
        """Leave initialization mode. Raises SlaveError."""
        self._must_be("exit_initialization", _Phase.INITIALIZING)
        self._guarded(self._host.call, "exit_initialization", self._time)
        self._phase, self._values = _Phase.RUNNING, None

    def restart(self) -> None:
        """Free the FMU's instance and make a new one in its place, with the same variables bound; initialize follows.

        Not fmi2Reset, which many FMUs do not have. Raises SlaveError. One that declares
        canBeInstantiatedOnlyOncePerProcess may fail: it needs a new slave.
        """
        self._guarded(self._host.call, "restart", self._time)
        self._time = self._values = None
        self._phase = _Phase.INSTANTIATED
        ports = (self._inputs, self._tunables, self._outputs)
        self._guarded(self._host.bind, *(port.variables for port in ports))

    def get(self) -> tuple[float, ...]:
        """The bound outputs at the present communication point. Raises SlaveError."""
        self._must_be("get", _Phase.RUNNING)
        if self._values is None:
            values = tuple(self._guarded(self._host.call, "get", self._time))
            self._values = self._checked_outputs(values)
        return self._values

    def begin_step(self, inputs: Sequence[float], t: float, h: float, tunables: Sequence[float] | None = None) -> None:
        """Start a step from t to t + h [s] with these inputs, after setting the tunables unless they are None.

        Raises SlaveError, ValueError for another number of values than bound.
        """
        if self._phase is not _Phase.RUNNING:
            self._must_be("begin_step", _Phase.RUNNING)
        self._refuse(self._inputs, inputs, t)
        if tunables is not None:
            self._refuse(self._tunables, tunables, t)
        self._guarded(self._host.begin_step, t, h, inputs, tunables)
        self._time, self._end_of_step = t, t + h

    def end_step(self) -> tuple[float, ...]:
        """Wait for the step; the bound outputs after it. Raises SlaveError."""
        end, self._end_of_step = self._end_of_step, None
        if end is None:
            raise RuntimeError(f"{self.name}: end_step must follow begin_step.")
        values = self._guarded(self._host.end_step, self._time)
        self._time = end
        self._values = self._checked_outputs(values)
        return values

    def step(
        self, inputs: Sequence[float], t: float, h: float, tunables: Sequence[float] | None = None
    ) -> tuple[float, ...]:
        """begin_step and end_step."""
        self.begin_step(inputs, t, h, tunables)
        return self.end_step()

    def many_steps(
        self, times: Sequence[float], inputs: Sequence[Sequence[float]], tunables: Sequence[float] | None = None
    ) -> list[tuple[float, ...]]:
        """Steps from each of times (n + 1,) [s] to the next with inputs (n, p); the bound outputs after each.

        As n calls of step, the first with the tunables, but in one call of the FMU's process, which has the timeout for
        all of them.
        """
        self._must_be("many_steps", _Phase.RUNNING)
        if tunables is not None:
            self._refuse(self._tunables, tunables, times[0])
        for t, values in zip(times, inputs, strict=False):
            self._refuse(self._inputs, values, t)
        answer = self._guarded(self._host.call, "many_steps", times[0], encode_steps(times, inputs, tunables))
        rows = decode_outputs(answer, len(inputs))
        for t, row in zip(times[1:], rows, strict=True):
            self._time = t
            self._values = self._checked_outputs(row)
        return rows

    @property
    def has_states(self) -> bool:
        """Whether the FMU can save and restore its state, serialised."""
        interface = co_simulation(self.description)
        return bool(interface.canGetAndSetFMUstate and interface.canSerializeFMUstate)

    def check_tunables(self, names: Sequence[str]) -> None:
        """Raises WiringError where one of them is no tunable parameter."""
        self._catalogue.ports("tunable parameter", names)

    def get_state(self) -> bytes:
        """The FMU's state, for set_state of a slave of the same FMU.

        Raises StateTooLargeError, after which the FMU is as it was, SlaveError.
        """
        self._must_have_states("get_state")
        state = self._guarded(self._host.call, "get_state", self._time)
        if not isinstance(state, bytes):
            reason = f"the state has {state} bytes; at most {LARGEST_STATE} can be saved"
            raise StateTooLargeError(self.name, "get_state", self._time, reason, COLON)
        return state

    def set_state(self, state: bytes) -> None:
        """Go back to a state. Raises SlaveError."""
        self._must_have_states("set_state")
        self._guarded(self._host.call, "set_state", self._time, state)
        self._phase, self._values = _Phase.RUNNING, None  # the state of an FMU that was running

    @property
    def checkpoint_name(self) -> str:
        """See `cosim.runs.checkpoint.Alive`."""
        return f"FMU {self.name}"

    def to_checkpoint(self) -> tuple[bytes, float | None, tuple[float, ...] | None]:
        """State, communication point and outputs. Raises NotResumableError, SlaveError."""
        if not self.has_states:
            raise NotResumableError(f"{self.fmu.name} cannot save and restore its state")
        try:
            return self.get_state(), self._time, self._values
        except StateTooLargeError as error:
            raise NotResumableError(f"{self.fmu.name}: {error.reason}") from error

    def from_checkpoint(self, saved: tuple[bytes, float | None, tuple[float, ...] | None]) -> None:
        """Go back there. Raises NotResumableError where the FMU then gives other outputs, SlaveError."""
        state, self._time, outputs = saved
        self.set_state(state)
        if outputs is not None and self.get() != outputs:
            raise NotResumableError(f"{self.fmu.name} gives other outputs once its state is restored")

    def close(self) -> None:
        """Terminate and free the FMU, within a few seconds or by force, and remove its folder; idempotent.

        An FMU that fails here is logged as a warning: what it has computed is not touched by it.
        """
        if not self._finalizer.alive:
            return
        try:
            self._host.close(self._time, self._fault is None)
        except SlaveError as error:
            _log.warning("%s", error)
        finally:
            self._finalizer()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _must_be(self, function: str, phase: _Phase) -> None:
        self._must_be_usable()
        if self._phase is not phase:
            raise RuntimeError(f"{self.name}: {function} {phase.value}.")

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
        if self._is_lenient:
            self._warn(self._outputs, values)
        return values

    def _refuse(self, ports: Ports, values: Sequence[float], t: float) -> None:
        if len(values) != len(ports.variables):
            raise ValueError(f"{self.name}: {len(ports.variables)} values must be set, got {len(values)}.")
        problem = ports.problem(values)
        if problem is not None:
            raise SlaveError(self.name, "set", t, problem, COLON)
        if self._is_lenient:
            self._warn(ports, values)

    def _warn(self, ports: Ports, values: Sequence[float]) -> None:
        for name, text in ports.strayed(values):
            if name not in self._strayed:
                self._strayed.add(name)
                _log.warning("%s at t = %s s: %s", self.name, seconds(self._time or 0.0), text)

    def _must_have_states(self, function: str) -> None:
        if not self.has_states:
            reason = f"{self.fmu.name} cannot save and restore its state"
            raise SlaveError(self.name, function, self._time, reason, COLON)

    def _start_value(self, name: str, value: Value, t: float) -> tuple[str, str, int, Value]:
        port = self._catalogue.start_port(name, value)
        (variable,) = port.variables
        if variable.type != "String":
            self._refuse(port, [float(value)], t)
        return variable.name, variable.type, variable.reference, PYTHON_TYPE[variable.type](value)


def _release(host: Host, folder: PrivateFolder, process_id: int) -> None:
    """Leave nothing behind: called by close, when a slave is forgotten, or at the end of the program."""
    if os.getpid() == process_id:  # not in a fork of it
        host.close(None, is_polite=False)
        folder.remove()
