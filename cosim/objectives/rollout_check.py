"""Tests that a second FMU, put into a state, continues as the original does: by simulation, whatever it declares."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from estimator import Sample, SampleSequence

from ..errors import SlaveError
from .rollout_fmu import RunningPlant, Shadow
from .rollout_plan import History, Origin, plan_of
from .rollout_pool import Pool

PROOF_STEPS: Final = 10
"""Number of samples after which a restart from states is tried first."""
_MOVED: Final = 10.0
"""Change of an output, in standard deviations of the noise, by which states left at their start values would show."""
SAME: Final = 1e-9
"""Relative difference of outputs that may be rounding: a step's length is computed in two ways."""
HARMLESS: Final = 0.1
"""Difference, in standard deviations of the noise, that a solver's fresh start may make."""


def steps_like_the_plant(shadow: Shadow, live: RunningPlant, state: bytes, samples: Sequence[Sample]) -> str | None:
    """Return the reason why a shadow, given the plant's state, does not repeat the plant's step, or None.

    The state is that at the first of two samples, the step that to the second.
    """
    first, second = samples
    tunables = tuple(live.changes)
    disturbed = replace(shadow, inputs=(*shadow.inputs, *live.disturbances))
    try:
        with disturbed.opened(tunables) as slave:
            slave.initialize(shadow.start, shadow.start_time, shadow.stop_time)
            slave.set_state(state)
            values = [live.changes[name](first.t) for name in tunables]
            inputs = [*second.u, *(value(first.t) for value in live.disturbances.values())]
            (repeated,) = slave.many_steps([first.t, second.t], [inputs], values or None)
    except SlaveError as e:
        return f"a step could not be repeated: {e}"
    places = [live.outputs.index(name) for name in shadow.outputs]
    now = live.slave.get()
    real = np.array([now[i] for i in places])
    scale = np.maximum(np.abs(real), shadow.noise)
    if np.all(np.abs(np.array(repeated) - real) <= SAME * scale):
        return None
    worst = int(np.argmax(np.abs(np.array(repeated) - real) / scale))
    return f"a repeated step gave {shadow.outputs[worst]} = {repeated[worst]:.9g}, the plant {real[worst]:.9g}"


class RestartProof(NamedTuple):
    """Result of a restart from states."""

    reason: str | None
    """Reason why a shadow begun in the states another has reached does not continue alike, or None."""
    has_moved: bool
    """True where the outputs had moved before: at rest a state that is not measured does not show."""


def prove_restart(shadow: Shadow, history: History) -> RestartProof:
    """Return whether a shadow, begun midway in the states that another has reached since it moved, continues alike."""
    n, n_outputs, times = len(history.inputs), len(shadow.outputs), history.times
    reached = (shadow.told_by.get(name, name) for name in shadow.states)
    whole = replace(shadow, outputs=(*shadow.outputs, *reached))
    samples = [Sample(t, (), tuple(u), ()) for t, u in zip(times, [history.inputs[0], *history.inputs], strict=True)]
    with Pool(whole.opened, 1, shadow.is_restartable) as pool:
        plan = plan_of("replay", whole, history, history.theta, SampleSequence(tuple(samples), Origin(0, None)))
        plan = replace(plan, last=plan.last._replace(tunables=None))  # it starts with them
        (one,) = pool.map([lambda slave, is_new: plan.run(pool, slave, is_new)])
        if one.result is None:
            return RestartProof(f"it cannot be simulated from the start: {one.reason}", False)
        outputs = np.array(one.result)[:, :n_outputs]
        moved = np.any(np.abs(outputs - outputs[0]) > _MOVED * np.array(shadow.noise), axis=1)
        has_moved = bool(moved[: n - PROOF_STEPS // 2 + 1].any())
        place = (n + int(np.argmax(moved))) // 2
        later = [Sample(times[place], one.result[place - 1][n_outputs:], samples[place].u, ()), *samples[place + 1 :]]
        again = plan_of("measured", whole, history, history.theta, SampleSequence(tuple(later), None))
        (other,) = pool.map([lambda slave, is_new: again.run(pool, slave, is_new)])
    if other.result is None:
        return RestartProof(f"it cannot begin there: {other.reason}", has_moved)
    a, b = outputs[place:], np.array(other.result)[:, :n_outputs]
    off = np.abs(a - b) / np.maximum(np.array(shadow.noise), SAME * np.abs(a))
    if np.all(off <= HARMLESS):
        return RestartProof(None, has_moved)
    worst = shadow.outputs[int(np.argmax(off.max(axis=0)))]
    return RestartProof(
        f"begun at the states of another, {worst} differs by {off.max():.3g} standard deviations: states are hidden",
        has_moved,
    )
