"""One FMU as a master sees it: by variable names, by default in its own process.

    with open_slave(Path("Pendulum.fmu"), "plant") as plant:
        plant.bind(inputs=["u"], tunables=["m", "l"], outputs=["phi", "phi_dot"])
        plant.initialize({"phi": 1.0}, start_time=0.0, stop_time=10.0)
        phi, phi_dot = plant.get()
        phi, phi_dot = plant.step([0.0], t=0.0, h=0.01)

A call goes from here through a `Host` (process.py, or host.py without a process) to the FMU's `Binding`.
"""

import logging
import math
import os
import weakref
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal, Self

from fmpy.model_description import ModelDescription

from ..errors import COLON, NotResumableError, SlaveError, StateTooLargeError
from ..fmi.archive import capabilities, fmu_to_load, read_checked, unpacked
from ..fmi.binding import LARGEST_STATE
from ..fmi.folder import BorrowedFolder, Folder, kept_folders
from ..fmi.ports import Catalogue
from ..fmi.step_batch import decode_outputs, encode_steps
from ..fmi.trial_batch import TrialBatch, TrialOutputs, decode_trials, encode_trials
from ..fmi.types import Value
from .bound_variables import BoundVariables
from .host import Host, InProcessFmu
from .life_cycle import LifeCycle, Phase
from .process import FmuProcess

Isolation = Literal["process", "none"]
OutOfRange = Literal["fault", "warning"]

_log = logging.getLogger(__name__)


def open_slave(
    fmu: Path | str,
    instance_name: str,
    *,
    isolation: Isolation = "process",
    timeout: float = 10.0,
    out_of_range: OutOfRange = "fault",
    memory_limit: float = 0.0,
    environment: Sequence[str] = (),
    tolerance: float | None = None,
    after_call: Callable[[], None] | None = None,
    is_checked: bool = False,
    unpacked_in: str | None = None,
) -> "Slave":
    """Unpack an FMU for co-simulation, FMI 2.0 or 3.0, into a private folder, and load it.

    isolation: "process" (the default) gives it a process of its own, and returns while it is still loading: open
    several and they load at the same time. "none" loads it into this process, and trusts it with all that is in it.
    timeout is the time each call may take [s], memory_limit what its process may hold [MB] (0: half of the
    machine's memory; Linux); only a process of its own can be held to them.
    environment: names of environment variables that its process is given beside those which every FMU is given.
    tolerance: relative tolerance for the FMU's own solver; by default that of its default experiment, if any.
    out_of_range: whether an input or output outside its declared min and max is a fault, or a warning, given once.
    after_call: called after each call of an FMU in this process.
    is_checked: true for a file that this has opened before, and that has not changed since; unpacked_in: folder that
    it has been unpacked into, which stays.

    Raises ModelDescriptionError for a bad file, SlaveError when loading fails (isolated: in the first call).
    """
    if not (math.isfinite(timeout) and timeout > 0):
        raise ValueError(f"timeout must be positive and finite, got {timeout} s.")
    if isolation not in ("process", "none"):
        raise ValueError(f"isolation must be 'process' or 'none', got {isolation!r}.")
    fmu = Path(fmu)
    isolated = isolation == "process"
    if unpacked_in is None:
        description, folder = unpacked(fmu, is_checked=is_checked, kept=kept_folders())
    else:
        description, folder = read_checked(fmu), BorrowedFolder(unpacked_in)
    try:
        to_load = fmu_to_load(description, folder.path, instance_name, tolerance=tolerance)
        to_load = to_load._replace(writes_bytecode=folder.is_kept)
        host = (
            FmuProcess(to_load, timeout, memory_limit=memory_limit, environment=environment)
            if isolated
            else InProcessFmu(to_load, after_call)
        )
    except BaseException:
        folder.remove()
        raise
    return Slave(fmu, instance_name, description, host, folder, out_of_range)


class Slave:
    """One FMU, from loading to freeing.

    1. open_slave       unpacks and loads it
    2. bind             names the variables that are set and got at communication points
    3. initialize       sets start values, passes initialization mode; or, to exchange values in that mode:
       enter_initialization, propagate, exit_initialization
    4. get, and step, or begin_step and end_step, any number of times; get_state and set_state go back
    5. close            terminates and frees it

    After a SlaveError that the FMU has caused only close may be called; a value that is refused before it reaches the
    FMU leaves the slave as it was. A call out of order does not reach the FMU: it raises RuntimeError.
    """

    def __init__(
        self,
        fmu: Path,
        instance_name: str,
        description: ModelDescription,
        host: Host,
        folder: Folder,
        out_of_range: OutOfRange = "fault",
    ) -> None:
        """Not to be called directly: use open_slave."""
        self.fmu = fmu
        self.name = instance_name
        self.description = description
        self._host = host
        self._life = LifeCycle(instance_name)
        is_lenient = out_of_range == "warning"
        self._bound = BoundVariables(instance_name, Catalogue(fmu.name, description.modelVariables), is_lenient)
        self._values: tuple[float, ...] | None = None
        self._finalizer = weakref.finalize(self, _release, host, folder, os.getpid())

    def bind(self, inputs: Sequence[str] = (), tunables: Sequence[str] = (), outputs: Sequence[str] = ()) -> None:
        """Choose the variables that are set and got at communication points, and their order.

        inputs must have causality input, tunables be tunable parameters; outputs may be anything but a String.
        Raises WiringError, SlaveError.
        """
        self._bound.bind(inputs, tunables, outputs)
        self._values = None
        self._life.call(self._host.bind, *self._bound.all)

    def initialize(self, start: Mapping[str, Value], start_time: float = 0.0, stop_time: float | None = None) -> None:
        """Set start values by name and pass initialization mode; times in s.

        Raises WiringError for a variable that takes no start value or one of another type, SlaveError.
        """
        self._initialize("initialize", start, start_time, stop_time)
        self._life.phase, self._values = Phase.RUNNING, None

    def enter_initialization(
        self, start: Mapping[str, Value], start_time: float = 0.0, stop_time: float | None = None
    ) -> None:
        """Set start values as initialize does, but stay in initialization mode."""
        self._initialize("enter_initialization", start, start_time, stop_time)
        self._life.phase = Phase.INITIALIZING

    def propagate(self, inputs: Sequence[float] | None) -> tuple[float, ...]:
        """Return the bound outputs in initialization mode, after setting the inputs unless they are None.

        Ranges are not checked on the way to consistent values. Raises SlaveError.
        """
        self._life.check("propagate", Phase.INITIALIZING)
        if inputs is not None:
            self._bound.check_number(self._bound.inputs, inputs)
        return tuple(self._life.call(self._host.call, "propagate", self._life.time, inputs))

    def exit_initialization(self) -> None:
        """Leave initialization mode. Raises SlaveError."""
        self._life.check("exit_initialization", Phase.INITIALIZING)
        self._life.call(self._host.call, "exit_initialization", self._life.time)
        self._life.phase, self._values = Phase.RUNNING, None

    def restart(self) -> None:
        """Free the FMU's instance and make a new one in its place, with the same variables bound; initialize follows.

        Not fmi2Reset, which many FMUs do not have. Raises SlaveError. One that declares
        canBeInstantiatedOnlyOncePerProcess may fail: it needs a new slave.
        """
        self._life.call(self._host.call, "restart", self._life.time)
        self._life.time = self._values = None
        self._life.phase = Phase.INSTANTIATED
        self._life.call(self._host.bind, *self._bound.all)

    def get(self) -> tuple[float, ...]:
        """Return the bound outputs at the present communication point. Raises SlaveError."""
        self._life.check("get", Phase.RUNNING)
        if self._values is None:
            values = tuple(self._life.call(self._host.call, "get", self._life.time))
            self._values = self._checked_outputs(values)
        return self._values

    def begin_step(self, inputs: Sequence[float], t: float, h: float, tunables: Sequence[float] | None = None) -> None:
        """Start a step from t to t + h [s] with these inputs, after setting the tunables unless they are None.

        Raises SlaveError, ValueError for another number of values than bound.
        """
        life, bound = self._life, self._bound
        if life.phase is not Phase.RUNNING:
            life.check("begin_step", Phase.RUNNING)
        bound.check_set(bound.inputs, inputs, t)
        if tunables is not None:
            bound.check_set(bound.tunables, tunables, t)
        life.call(self._host.begin_step, t, h, inputs, tunables)
        life.step_begins(t, h)

    def end_step(self) -> tuple[float, ...]:
        """Wait for the step, and return the bound outputs after it. Raises SlaveError."""
        life = self._life
        end = life.end_of_step()
        values = life.call(self._host.end_step, life.time)
        life.time = end
        self._values = self._checked_outputs(values)
        return values

    def step(
        self, inputs: Sequence[float], t: float, h: float, tunables: Sequence[float] | None = None
    ) -> tuple[float, ...]:
        """Take a step: begin_step and end_step."""
        self.begin_step(inputs, t, h, tunables)
        return self.end_step()

    def many_steps(
        self, times: Sequence[float], inputs: Sequence[Sequence[float]], tunables: Sequence[float] | None = None
    ) -> list[tuple[float, ...]]:
        """Step from each of times (n + 1,) [s] to the next with inputs (n, p); return the bound outputs after each.

        As n calls of step, the first with the tunables, but in one call of the FMU's process, which has the timeout for
        all of them.
        """
        life, bound = self._life, self._bound
        life.check("many_steps", Phase.RUNNING)
        if tunables is not None:
            bound.check_set(bound.tunables, tunables, times[0])
        for t, values in zip(times, inputs, strict=False):
            bound.check_set(bound.inputs, values, t)
        answer = life.call(self._host.call, "many_steps", times[0], encode_steps(times, inputs, tunables))
        rows = decode_outputs(answer, len(inputs))
        for t, row in zip(times[1:], rows, strict=True):
            life.time = t
            self._values = self._checked_outputs(row)
        return rows

    def trials(self, batch: TrialBatch, start: Sequence[Mapping[str, Value]]) -> TrialOutputs:
        """Simulate each trial of a batch, in one call of the FMU's process, which has the timeout for all of them.

        start: start values of each by name, in the place of the batch's. As initialize, set_state and many_steps,
        with restart between them where there is no state. Raises SlaveError where nothing is known of any of them:
        the FMU's process has died, or a value is refused; WiringError. After a fault only close may be called.
        """
        life, bound = self._life, self._bound
        if batch.is_new:
            life.check("trials", Phase.INSTANTIATED)
        values = [[bound.start_value(n, v, batch.start_time) for n, v in named.items()] for named in start]
        for times, inputs in batch.legs:
            for t, row in zip(times, inputs, strict=False):
                bound.check_set(bound.inputs, row, t)
        trials = [trial._replace(start=own) for trial, own in zip(batch.trials, values, strict=True)]
        for place, tunables in (leg for trial in trials for leg in trial.legs):
            if tunables is not None:
                bound.check_set(bound.tunables, tunables, batch.legs[place].times[0])
        answer = life.call(self._host.call, "trials", life.time, encode_trials(batch._replace(trials=trials)))
        ends = [batch.legs[trial.legs[-1][0]] for trial in trials]
        rows, fault = decode_trials(answer, [len(leg.inputs) for leg in ends])
        life.phase, self._values = Phase.RUNNING, None
        for i, leg in enumerate(ends[: len(rows)]):
            try:
                for life.time, row in zip(leg.times[1:], rows[i], strict=True):
                    self._values = self._checked_outputs(row)
            except SlaveError as error:
                rows, fault = rows[:i], error
                break
        life.fault = fault
        return TrialOutputs(rows, fault)

    @property
    def has_states(self) -> bool:
        """True where the FMU can save and restore its state, serialised."""
        interface = capabilities(self.description)
        return bool(interface.canGetAndSetFMUstate and interface.canSerializeFMUstate)

    def check_tunables(self, names: Sequence[str]) -> None:
        """Raise WiringError if one of them is not a tunable parameter."""
        self._bound.check_tunables(names)

    def get_state(self) -> bytes:
        """Return the FMU's state, for set_state of a slave of the same FMU.

        Raises StateTooLargeError, after which the FMU is as it was, SlaveError.
        """
        self._check_has_states("get_state")
        state = self._life.call(self._host.call, "get_state", self._life.time)
        if not isinstance(state, bytes):
            reason = f"the state has {state} bytes; at most {LARGEST_STATE} can be saved"
            raise StateTooLargeError(self.name, "get_state", self._life.time, reason, COLON)
        return state

    def set_state(self, state: bytes) -> None:
        """Go back to a state. Raises SlaveError."""
        self._check_has_states("set_state")
        self._life.call(self._host.call, "set_state", self._life.time, state)
        self._life.phase, self._values = Phase.RUNNING, None  # the state of an FMU that was running

    def to_checkpoint(self) -> tuple[bytes, float | None, tuple[float, ...] | None]:
        """Return state, communication point and outputs. Raises NotResumableError, SlaveError."""
        if not self.has_states:
            raise NotResumableError(f"{self.fmu.name} cannot save and restore its state")
        try:
            return self.get_state(), self._life.time, self._values
        except StateTooLargeError as error:
            raise NotResumableError(f"{self.fmu.name}: {error.reason}") from error

    def from_checkpoint(self, saved: tuple[bytes, float | None, tuple[float, ...] | None]) -> None:
        """Go back to a checkpoint. Raises NotResumableError where the FMU then gives other outputs, SlaveError."""
        state, self._life.time, outputs = saved
        self.set_state(state)
        if outputs is not None and self.get() != outputs:
            raise NotResumableError(f"{self.fmu.name} gives other outputs once its state is restored")

    def close(self) -> None:
        """Terminate and free the FMU, within a few seconds or by force, and remove its folder; idempotent.

        A failure here is logged as a warning: it does not affect what the FMU has computed.
        """
        if not self._finalizer.alive:
            return
        try:
            self._host.close(self._life.time, self._life.fault is None)
        except SlaveError as error:
            _log.warning("%s", error)
        finally:
            self._life.close()
            self._finalizer()

    @property
    def is_closed(self) -> bool:
        """True after close."""
        return not self._finalizer.alive

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _initialize(self, function: str, start: Mapping[str, Value], start_time: float, stop: float | None) -> None:
        self._life.check(function, Phase.INSTANTIATED)
        values = [self._bound.start_value(name, value, start_time) for name, value in start.items()]
        self._life.call(self._host.call, function, start_time, values, start_time, stop)
        self._life.time = start_time

    def _checked_outputs(self, values: tuple[float, ...]) -> tuple[float, ...]:
        try:
            self._bound.check_outputs(values, self._life.time)
        except SlaveError as error:
            self._life.fault = error
            raise
        return values

    def _check_has_states(self, function: str) -> None:
        if not self.has_states:
            reason = f"{self.fmu.name} cannot save and restore its state"
            raise SlaveError(self.name, function, self._life.time, reason, COLON)


def _release(host: Host, folder: Folder, process_id: int) -> None:
    """Release the FMU and its folder: called by close, on garbage collection, or at the end of the program."""
    if os.getpid() == process_id:  # not in a fork of it
        host.close(None, is_polite=False)
        folder.remove()
