"""Tests that a second FMU, put into a state, continues as the original does: by simulation, whatever it declares."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from estimator import Sample, SampleSequence

from ..errors import SlaveError
from .rollout_fmu import RunningPlant, Shadow
from .rollout_plan import History, Origin, plan_of
from .rollout_pool import Pool

PROOF_STEPS: Final = 10
"""Number of samples after which a restart from states is tried: at half of them."""
_SAME: Final = 1e-9
"""Relative difference of outputs that may be rounding: a step's length is computed in two ways."""
_HARMLESS: Final = 0.1
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
            slave.initialize(shadow.start, shadow.start_time)
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
    if np.all(np.abs(np.array(repeated) - real) <= _SAME * scale):
        return None
    worst = int(np.argmax(np.abs(np.array(repeated) - real) / scale))
    return f"a repeated step gave {shadow.outputs[worst]} = {repeated[worst]:.9g}, the plant {real[worst]:.9g}"


def restarts_like_itself(shadow: Shadow, history: History) -> str | None:
    """Return the reason why a shadow begun in the states another has reached does not continue alike, or None."""
    half, n = len(history.inputs) // 2, len(history.inputs)
    n_outputs = len(shadow.outputs)
    whole = replace(shadow, outputs=(*shadow.outputs, *shadow.states))
    times = history.times
    samples = [Sample(t, (), tuple(u), ()) for t, u in zip(times, [history.inputs[0], *history.inputs], strict=True)]
    with Pool(whole.opened, 1, shadow.is_restartable) as pool:
        plan = plan_of("replay", whole, history, history.theta, SampleSequence(tuple(samples), Origin(0, None)))
        plan = replace(plan, last=plan.last._replace(tunables=None))  # it starts with them
        (one,) = pool.map([lambda slave, is_new: plan.run(pool, slave, is_new)])
        if one.result is None:
            return f"it cannot be simulated from the start: {one.reason}"
        reached = one.result[half - 1][n_outputs:]
        later = [Sample(times[half], reached, samples[half].u, ()), *samples[half + 1 :]]
        again = plan_of("measured", whole, history, history.theta, SampleSequence(tuple(later), None))
        (other,) = pool.map([lambda slave, is_new: again.run(pool, slave, is_new)])
    if other.result is None:
        return f"it cannot begin there: {other.reason}"
    a, b = np.array(one.result[half:n])[:, :n_outputs], np.array(other.result)[:, :n_outputs]
    off = np.abs(a - b) / np.maximum(np.array(shadow.noise), _SAME * np.abs(a))
    if np.all(off <= _HARMLESS):
        return None
    worst = shadow.outputs[int(np.argmax(off.max(axis=0)))]
    return f"begun at the states of another, {worst} differs by {off.max():.3g} standard deviations: states are hidden"
