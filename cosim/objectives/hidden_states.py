"""Test on a whole log that roll-outs which begin in measured states lack no state: by simulation of the FMU."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator import Sample, SampleSequence, Vector

from .rollout_check import HARMLESS, PROOF_STEPS, SAME
from .rollout_fmu import Shadow
from .rollout_plan import History, Origin, Plan, plan_of
from .rollout_pool import Pool

_MOST: Final = 8
"""Largest number of places at which a roll-out is begun."""
_FAR: Final = 0.8
"""Share of a suspect's largest distance from its start value at which a roll-out is begun, at least."""
_KEPT: Final = 0.01
"""Share of its distance from the start value that a hidden state is off by after a step, at least."""


class Suspect(NamedTuple):
    """A variable that may be a state, and is not measured."""

    name: str
    start: float
    """Its start value."""


def hidden_states(
    shadow: Shadow, samples: Sequence[Sample], theta: Vector, suspects: Sequence[Suspect], n_steps: int
) -> str | None:
    """Return the reason why roll-outs that begin in measured states lack a suspect, or None where none shows.

    The log is simulated once, with parameters theta (d,). Where suspects are far from their start values, a roll-out
    of n_steps, or half the log, begins in the other states reached there, and must go on alike. A place tells nothing
    where these are far from all that was measured, as in a simulation that diverges; nor do a few samples.
    """
    if len(samples) <= PROOF_STEPS:
        return None
    n_outputs, n_states, n_steps = len(shadow.outputs), len(shadow.states), min(n_steps, len(samples) // 2)
    reached = (shadow.told_by.get(name, name) for name in shadow.states)
    whole = replace(shadow, outputs=(*shadow.outputs, *reached, *(s.name for s in suspects)))
    history, noise = History(samples[0].t, theta.tolist()), np.array(shadow.noise)
    with Pool(whole.opened, 1, shadow.is_restartable) as pool:

        def simulated(plan: Plan) -> Vector | None:
            started = replace(plan, last=plan.last._replace(tunables=None))  # it starts with theta
            (outcome,) = pool.map([lambda slave, is_new: started.run(pool, slave, is_new)])
            return None if outcome.result is None else np.array(outcome.result)

        one = simulated(plan_of("replay", whole, history, history.theta, SampleSequence((*samples,), Origin(0, None))))
        if one is None:
            return None
        states, others = one[:, n_outputs : n_outputs + n_states], one[:, n_outputs + n_states :]
        distance = np.nan_to_num(np.abs(others - [s.start for s in suspects]))
        is_near = _is_near(states, np.array([s.x for s in samples]))
        for row in _places(np.where(is_near[:, None], distance, 0.0)[:-n_steps]):
            place = row + 1  # of the sample after that many steps
            first = replace(samples[place], x=tuple(states[row].tolist()))
            stretch = SampleSequence((first, *samples[place + 1 : place + 1 + n_steps]), None)
            other = simulated(plan_of("measured", whole, history, history.theta, stretch))
            if other is None:
                continue
            later = one[place : place + len(other)]
            is_lacking = np.abs(other[0] - later[0])[n_outputs + n_states :] > _KEPT * distance[row]
            a, b = later[:, :n_outputs], other[:, :n_outputs]
            is_told = is_near[place : place + len(other)]
            off = np.compress(is_told, np.abs(a - b) / np.maximum(noise, SAME * np.abs(a)), axis=0)
            if np.any(off > HARMLESS) and np.any(is_lacking):
                lacking = ", ".join(s.name for s, is_one in zip(suspects, is_lacking, strict=True) if is_one)
                worst = shadow.outputs[int(np.argmax(off.max(axis=0)))]
                return (
                    f"begun without {lacking} at the states of another, {worst} differs by {off.max():.3g} standard "
                    "deviations: states are hidden"
                )
    return None


def _is_near(states: Vector, measured: Vector) -> NDArray[np.bool_]:
    """Return whether states (n, s) are as far as their measured range, at most, from all that was measured (n,)."""
    lowest, highest = np.nanmin(measured, axis=0), np.nanmax(measured, axis=0)
    span = highest - lowest
    return np.all((states >= lowest - span) & (states <= highest + span), axis=1)


def _places(distance: Vector) -> list[int]:
    """Return places, at one of which each variable is all but as far from its start value (n, m) as it gets."""
    share: Vector = distance / np.maximum(distance.max(axis=0), np.finfo(float).tiny)
    found: list[int] = []
    while len(found) < _MOST and np.any(share > 0.0):
        found.append(int(np.argmax(share.sum(axis=1))))
        share = np.compress(share[found[-1]] < _FAR, share, axis=1)
    return found
