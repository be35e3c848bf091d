"""The probation by itself, and the guard of writes that a disturbance would explain as well."""

from dataclasses import replace
from math import nan

import numpy as np
import pytest

from cosim.retuning.guard import Guard
from cosim.retuning.probation import Probation
from cosim.scenarios.schema.guard import GuardSettings
from estimator import Estimate, Sample
from estimator.retuning.proposal import Proposal
from tests.cosim.retuning.linear_plant import GOOD, SPACE, START, Watched, seen

N_APART = 10
BOTH = ((1.0, 0.0), (0.0, 1.0))
ESTIMATE = Estimate(GOOD, np.full(2, 0.1), (True, True), 0.0, 1, "incumbent")
PROVEN = Proposal(GOOD, ESTIMATE)
POSSIBLE = replace(PROVEN, possible_disturbance=np.array([0.3]), is_warranted=False)
LIKELY = replace(POSSIBLE, is_warranted=True)
MUTE = Sample(9.0, (0.0, 0.0), (), (0.0,))


def probation(errors=()):
    made = Probation(0.5, 1.5, 100, N_APART)
    for error in errors:
        made.watch(error, (), is_proposed=False)
    return made


def test_what_is_usual_is_the_largest_error_but_for_the_newest():
    assert probation([0.01] * N_APART).tolerated(is_proven=False) == 0.5  # too early to tell
    assert probation([0.02, *[0.01] * N_APART]).tolerated(is_proven=False) == pytest.approx(0.03)
    assert probation([*[0.01] * N_APART, *[0.2] * N_APART]).tolerated(is_proven=False) == pytest.approx(0.015)
    assert probation([0.02, *[0.01] * (N_APART + 1000)]).tolerated(is_proven=False) == pytest.approx(0.015)


def test_at_the_start_of_a_run_what_was_before_the_first_proposal_is_usual():
    made = probation([0.01, 0.02])
    made.watch(0.3, (), is_proposed=True)
    assert made.tolerated(is_proven=False) == pytest.approx(0.03)
    made.watch(0.3, (), is_proposed=False)
    made.watch(0.3, (), is_proposed=True)
    assert made.tolerated(is_proven=False) == pytest.approx(0.03)


def test_what_is_usual_is_never_tolerated_above_the_tolerance_and_leaves_proven_parameters_alone():
    assert probation([0.4, *[0.01] * N_APART]).tolerated(is_proven=False) == 0.5
    assert probation([0.01] * 100).tolerated(is_proven=True) == 0.5


def test_errors_before_a_proposal_during_a_probation_and_of_no_number_are_not_usual():
    made = probation([0.01] * 100)
    for _ in range(N_APART):
        made.watch(0.1, (), is_proposed=False)
    made.watch(0.1, (), is_proposed=True)
    made.begin(100 + N_APART, GOOD, 0.0, is_proven=False)
    for _ in range(2 * N_APART):
        made.watch(0.1, (), is_proposed=False)
    made.clear()
    for error in (nan, *[0.01] * N_APART, nan):
        made.watch(error, (), is_proposed=False)
    assert made.tolerated(is_proven=False) == pytest.approx(0.015)


def test_trials_of_before_return_as_they_are_now_but_for_those_that_have_ended():
    made = probation()
    for k, theta in ((1, START), (50, GOOD)):
        made.begin(k, theta, 0.0, is_proven=False)
    before = made.trials
    made.prove()
    made.begin(60, START, 0.0, is_proven=True)
    made.restore(before)
    assert [(t.since, t.is_proven) for t in made.trials] == [(1, True), (50, True)]
    made.clear()
    made.restore(before)
    assert [(t.since, t.is_proven) for t in made.trials] == [(1, False), (50, False)]
    made.end(101)
    made.restore(before)
    assert [t.since for t in made.trials] == [50]


def guard(peak, support=None):
    """A guard of a loop whose error is 0.01, with a prediction; the tolerance is 0.5."""
    support = seen(*BOTH) if support is None else support
    watched = Watched(Guard(GuardSettings(tolerance=0.5), SPACE, START, 100.0, support), START)
    for k in range(1, 100):
        watched.step(k, 0.01 * k, 0.01, Proposal(), peak)
    return watched


def kinds(watched, k, error, proposal, peak):
    return [event.kind for event in watched.step(k, 0.01 * k, error, proposal, peak).events]


def predicted(found):
    """A prediction of `found` where the parameters of before are the right ones and others are written, else 0.01."""
    return lambda controller, plant, disturbance: found if disturbance is not None and controller is not START else 0.01


@pytest.mark.parametrize(("found", "told"), [(0.0149, []), (0.0151, ["veto"])])
def test_parameters_that_may_be_the_old_ones_are_written_where_the_error_stays_usual(found, told):
    peak = predicted(found)
    assert kinds(guard(peak), 100, 0.001, POSSIBLE, peak) == told
    assert kinds(guard(peak), 100, 0.001, LIKELY, peak) == told
    assert kinds(guard(peak), 100, 0.001, PROVEN, peak) == []


@pytest.mark.parametrize(("found", "told"), [(0.0149, []), (0.0151, ["veto"])])
def test_parameters_that_noise_may_have_made_are_written_where_the_error_stays_usual(found, told):
    """In a plant that still has the parameters of before, and no disturbance."""
    noisy = replace(LIKELY, if_noise=START)

    def peak(controller, plant, disturbance):
        return found if plant is START and disturbance is None and controller is not START else 0.01

    assert kinds(guard(peak), 100, 0.001, noisy, peak) == told
    assert kinds(guard(peak), 100, 0.001, LIKELY, peak) == []


def test_an_unusual_error_takes_them_back_until_they_are_proven():
    peak = predicted(0.01)
    for proof, told in ((POSSIBLE, ["revert"]), (PROVEN, [])):
        support = seen(*BOTH)
        watched = guard(peak, support)
        assert kinds(watched, 100, 0.001, POSSIBLE, peak) == []
        assert kinds(watched, 101, 0.0149, proof, peak) == []
        support.append(MUTE)  # which contradicts neither
        assert kinds(watched, 102, 0.0151, Proposal(), peak) == told


@pytest.mark.parametrize(("reference", "told"), [(1.0, []), (0.5, ["revert"])])
def test_a_jump_of_the_reference_takes_no_write_back(reference, told):
    """The limit is 0.5: what jumps by less than that is not seen, and a loop has to follow it."""
    support = seen(*BOTH)
    watched = guard(predicted(0.01), support)
    watched.step(100, 1.0, 0.01, PROVEN, predicted(0.01), (0.0,))
    support.append(MUTE)
    events = watched.step(101, 1.01, 1.0, Proposal(), predicted(0.01), (reference,)).events
    assert [event.kind for event in events] == told
    later = watched.step(102, 1.02, 2.1, Proposal(), predicted(0.01), (reference,)).events
    assert [event.kind for event in later] == ([] if told else ["revert"])


def test_what_may_be_a_disturbance_is_refused_with_the_reason_where_nothing_is_predicted():
    watched = guard(None)
    ruling = watched.step(100, 1.0, 0.01, POSSIBLE, None)
    reason = "a disturbance explains the samples as well, and the loop is not simulated ahead"
    assert ruling.write is None
    assert [(event.kind, event.detail["reason"]) for event in ruling.events] == [("veto", reason)]


def test_what_is_warranted_is_written_where_the_effect_of_a_disturbance_is_unknown():
    unknown = lambda controller, plant, disturbance: None if disturbance is not None else 0.01  # noqa: E731
    for peak in (None, unknown):
        assert guard(peak).step(100, 1.0, 0.01, LIKELY, peak).write is LIKELY.theta
        assert guard(peak).step(100, 1.0, 0.01, POSSIBLE, peak).write is None
