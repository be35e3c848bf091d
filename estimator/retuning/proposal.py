"""Proposal of a retuner: parameters to write, or to go back to, and the events that led to them."""

from dataclasses import dataclass, replace
from typing import Final

from ..contract import Estimate
from ..events import Event
from ..space import ParameterSpace, Vector

DOUBTFUL: Final = "the samples that they were found on are doubtful"
_AS_BEFORE: Final = "the parameters of before explain the samples as well"
"""Reasons of an undo that no other event has."""


@dataclass(frozen=True)
class Proposal:
    """Result of one communication point: parameters to write, and the events that led to them."""

    theta: Vector | None = None
    """Parameters (d,) to write to the controller; None to leave those in force."""
    estimate: Estimate | None = None
    """Estimate on which it is based."""
    events: tuple[Event, ...] = ()
    """Events in order: trigger, candidates, end."""
    latencies: tuple[float, ...] = ()
    """Wall time of each evaluation [s]: ask, score, tell, any refit; first and last include what is done once."""
    is_candidate: bool = False
    """True where theta is a candidate that is tried out, not the estimate."""
    possible_disturbance: Vector | None = None
    """Disturbance that may act in place of theta, in its own units: (c,) of the sampled derivatives, or (p,) of the
    plant's inputs, of sequences of samples. None where theta is certain."""
    if_noise: Vector | None = None
    """Parameters (d,) of the plant if the samples contradict them by noise only, be it ten times the declared one; None
    where that does not explain the samples."""
    is_warranted: bool = True
    """False where the disturbance explains the samples as well as theta does."""
    undo: Vector | None = None
    """Parameters (d,) from before a search that has failed, to return to; None where they are in force."""


def without_rounding(proposal: Proposal, held: Vector, space: ParameterSpace) -> Proposal:
    """Return the proposal, without its parameters where those in force, held (d,), are the same but for rounding."""
    theta = proposal.theta
    return proposal if theta is None or not space.are_same(theta, held) else replace(proposal, theta=None)


def going_back(
    t: float,
    proposal: Proposal,
    before: Vector,
    held: Vector,
    events: tuple[Event, ...],
    space: ParameterSpace,
    reason: str = "",
) -> Proposal:
    """Return the proposal to go back from held (d,) to the parameters before (d,), with further events.

    reason: by default that of the first of these events, which says what the parameters were taken back for.
    """
    reason = reason or next((event.detail["reason"] for event in events), _AS_BEFORE)
    events = (*proposal.events, *events)
    if space.are_same(before, held):
        return replace(proposal, theta=None, events=events)
    undo = Event(t, "undo", {"theta": before.tolist(), "reason": reason})
    return replace(proposal, theta=None, undo=before, events=(*events, undo))
