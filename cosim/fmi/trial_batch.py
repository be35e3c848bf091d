"""Many simulations of an FMU as one call: the bytes that go to its process, and back.

All of them begin in one FMU state, or each in start values of its own, and take steps that are sent once.
"""

import json
import struct
from array import array
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

from ..errors import SlaveError
from .binding import Binding, StartValues
from .renewal import Renewal

_LENGTHS: Final = struct.Struct("<QQ")


class TrialLeg(NamedTuple):
    """Consecutive steps."""

    times: Sequence[float]
    """Times (n + 1,) [s]: a step from each to the next."""
    inputs: Sequence[Sequence[float]]
    """Inputs (n, p), held from each time to the next."""


class BatchTrial(NamedTuple):
    """One simulation."""

    start: StartValues
    """Start values."""
    legs: Sequence[tuple[int, Sequence[float] | None]]
    """Place of each leg in the batch, with the tunables set before it, if any; the last one's outputs are returned."""


class TrialBatch(NamedTuple):
    """Simulations that are sent together."""

    start_time: float
    """Start time of each [s]."""
    stop_time: float
    """Stop time of each [s]."""
    state: bytes | None
    """FMU state that each begins in; None: in its start values."""
    is_new: bool
    """True where the instance has not been initialised."""
    legs: Sequence[TrialLeg]
    """Legs, each once."""
    trials: Sequence[BatchTrial]
    """Simulations."""


class TrialOutputs(NamedTuple):
    """Outputs of a batch, as far as it came."""

    rows: list[list[tuple[float, ...]]]
    """Outputs after each step of the last leg, of each simulation that has ended."""
    fault: SlaveError | None
    """Failure of the one after them."""


def encode_trials(batch: TrialBatch) -> bytes:
    """Return a batch as bytes."""
    flat, sizes = array("d"), list[list[int]]()
    for times, inputs in batch.legs:
        sizes.append([len(inputs), len(inputs[0]) if inputs else 0])
        flat.extend(times)
        for values in inputs:
            flat.extend(values)
    state = batch.state or b""
    begun = [batch.start_time, batch.stop_time, batch.state is not None, batch.is_new]
    head = json.dumps([*begun, sizes, batch.trials]).encode()
    return _LENGTHS.pack(len(head), len(state)) + head + state + flat.tobytes()


def take_trials(binding: Binding, renewal: Renewal, message: bytes) -> bytes:
    """Take the simulations of an encode_trials message; return their outputs, encoded."""
    n_head, n_state = _LENGTHS.unpack_from(message)
    first = _LENGTHS.size + n_head
    start_time, stop_time, has_state, is_new, sizes, trials = json.loads(message[_LENGTHS.size : first])
    state, legs = message[first : first + n_state], _legs(sizes, array("d", message[first + n_state :]))
    outputs, n_done = array("d"), 0
    fault: list[object] | None = None
    try:
        for start, own in trials:
            if is_new and has_state:
                binding.initialize(start, start_time, stop_time)
            begin = partial(_restored, state) if has_state else partial(_initialized, start, start_time, stop_time)
            simulate = partial(_simulated, begin, [(legs[place], tunables) for place, tunables in own])
            if is_new or has_state:
                rows = simulate(binding)
            else:
                binding, rows = renewal.simulated(binding, simulate)
            is_new = False
            outputs.extend(rows)
            n_done += 1
    except SlaveError as e:
        fault = [e.instance, e.function, e.time, e.reason, e.form]
    head = json.dumps([n_done, fault]).encode()
    return _LENGTHS.pack(len(head), 0) + head + outputs.tobytes()


def decode_trials(message: bytes, n_steps: Sequence[int]) -> TrialOutputs:
    """Return the outputs in bytes of take_trials; n_steps: of each simulation's last leg. Raises ValueError."""
    try:
        n_head, _ = _LENGTHS.unpack_from(message)
        begin = _LENGTHS.size + n_head
        n_done, fault = json.loads(message[_LENGTHS.size : begin])
        values, n_rows = array("d", message[begin:]).tolist(), sum(n_steps[:n_done])
        width, rest = divmod(len(values), max(n_rows, 1))
        error = None if fault is None else SlaveError(*fault)
    except (struct.error, TypeError) as e:
        raise ValueError("the outputs are not of the form that take_trials makes") from e
    if rest or (n_done < len(n_steps)) is (fault is None):
        raise ValueError(f"{n_rows} steps cannot have {len(values)} outputs.")
    rows = iter([tuple(values[k * width : (k + 1) * width]) for k in range(n_rows)])
    return TrialOutputs([[next(rows) for _ in range(n)] for n in n_steps[:n_done]], error)


def _legs(sizes: Sequence[tuple[int, int]], flat: "array[float]") -> list[tuple["array[float]", list["array[float]"]]]:
    """Return times and inputs of each leg."""
    legs: list[tuple[array[float], list[array[float]]]] = []
    place = 0
    for n, p in sizes:
        first = place + n + 1
        legs.append((flat[place:first], [flat[first + k * p : first + (k + 1) * p] for k in range(n)]))
        place = first + n * p
    return legs


def _restored(state: bytes, binding: Any) -> None:
    binding.set_state(state)


def _initialized(start: StartValues, start_time: float, stop_time: float, binding: Any) -> None:
    binding.initialize(start, start_time, stop_time)


def _simulated(begin: Callable[[Any], None], legs: Sequence[tuple[Any, Any]], binding: Any) -> "array[float]":
    """Return the outputs of an instance on the last of some legs, from its beginning on."""
    begin(binding)
    rows = array("d")
    for leg, tunables in legs:
        rows = _through(binding, leg, tunables)
    return rows


def _through(binding: Any, leg: tuple["array[float]", list["array[float]"]], tunables: Any) -> "array[float]":
    """Take the steps of a leg; return the outputs after each, one after the other."""
    rows, (times, inputs) = array("d"), leg
    for k, values in enumerate(inputs):
        rows.extend(binding.step(times[k], times[k + 1] - times[k], values, tunables))
        tunables = None
    return rows
