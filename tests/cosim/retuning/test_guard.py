"""The guard by itself: on samples of a linear model, whose information has a closed form, and made-up predictions."""

import re
from dataclasses import replace
from math import exp, inf, nan, sqrt

import numpy as np
import pytest

from cosim.retuning.decision import Point
from cosim.retuning.guard import Guard, estimate_at, outside, within_rate
from cosim.scenarios.schema.guard import GuardSettings
from estimator import Estimate, Parameter, ParameterSpace, Sample
from estimator.retuning.proposal import Proposal
from tests.cosim.retuning.linear_plant import BETTER, GOOD, SIGMA, SPACE, START, Watched, seen

BOTH = ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0))


def guard(support=None, **settings):
    return Watched(Guard(GuardSettings(tolerance=0.5, **settings), SPACE, START, 100.0, support or seen(*BOTH)), START)


def proposed(theta):
    theta = np.asarray(theta, dtype=float)
    return Proposal(theta, Estimate(theta, np.full(2, 0.1), (True, True), 0.0, 1, "incumbent"))


NOTHING = Proposal()


def kinds(reviewed):
    return [event.kind for event in reviewed.events]


def calm(controller, plant, disturbance):
    assert disturbance is None
    return 0.01


# Before a write.


@pytest.mark.parametrize(
    ("theta", "reason"),
    [
        ((nan, 1.0), "a is nan"),
        ((1.0, inf), "b is inf"),
        ((1.0, -inf), "b is -inf"),
        ((10.0 + 1e-9, 1.0), r"a = 10 is outside \[0, 10\] 1"),
        ((1.0, -0.5), r"b = -0.5 is outside \[0, 10\] 1"),
    ],
    ids=["nan", "inf", "-inf", "above", "below"],
)
def test_what_is_not_finite_or_outside_the_bounds_is_never_written(theta, reason):
    reviewed = guard().step(1, 0.01, 0.0, proposed(theta), calm)
    assert reviewed.write is None
    assert kinds(reviewed) == ["veto"]
    assert re.fullmatch(reason, reviewed.events[0].detail["reason"])


def test_the_bounds_themselves_are_inside():
    assert outside(np.array([0.0, 10.0]), SPACE) is None


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_a_rate_limited_step_keeps_its_direction_in_the_unit_cube(scale):
    space = ParameterSpace((Parameter("a", 0.1, 10.0, "1", scale), Parameter("b", 0.1, 10.0, "1", scale)))
    here = np.array([0.2, 1.0])
    there = np.array([8.0, 2.0])
    place = (lambda v: np.log(v / 0.1) / np.log(100.0)) if scale == "log" else (lambda v: (v - 0.1) / 9.9)
    limited, reasons = within_rate(there, here, space, 0.25)
    change, wanted = place(limited) - place(here), place(there) - place(here)
    assert np.max(np.abs(change)) == pytest.approx(0.25)
    np.testing.assert_allclose(change / np.max(np.abs(change)), wanted / np.max(np.abs(wanted)), rtol=1e-9)
    assert [kind for kind, _ in reasons] == ["limit"]
    assert within_rate(there, here, space, 1.0) == (pytest.approx(there), ())


def test_information_is_that_of_linear_regression():
    rows = np.array([[1.0, 0.2], [0.3, 2.0], [1.0, 1.0]])
    found = seen(*rows).information(GOOD)
    covariance = SIGMA**2 * np.linalg.inv(rows.T @ rows) / 100.0  # of z = theta / 10
    np.testing.assert_allclose(np.sort(1.0 / found.singular_values**2), np.linalg.eigvalsh(covariance), rtol=1e-6)


def test_a_direction_that_the_data_do_not_see_is_not_written():
    support = seen((1.0, 1.0), (1.0, 1.0))  # the sum only
    reviewed = guard(support).step(2, 0.02, 0.0, proposed((6.0, 2.0)), calm)
    np.testing.assert_allclose(reviewed.write, [4.0, 4.0], atol=1e-6)  # the move along (1, 1) of (4, 0)
    assert kinds(reviewed) == ["hold"]


def test_what_is_known_of_other_parameters_than_the_estimate_is_known_less_well():
    """On a log scale the deviation is that of the logarithm; a parameter is known to as much as its bounds at least."""
    log = ParameterSpace(
        (Parameter("a", 0.1, 10.0, "1", "log"), Parameter("b", 0.0, 10.0), Parameter("c", 0.0, 4.0, "1"))
    )
    estimate = Estimate(np.array([1.0, 5.0, 2.0]), np.array([0.1, 0.1, 4.0]), (True, True, False), 0.0, 1, "incumbent")
    assert estimate_at(estimate.theta, estimate, log) is estimate
    known = estimate_at(np.array([exp(0.3), 5.4, 0.0]), estimate, log)
    np.testing.assert_allclose(known.theta, [exp(0.3), 5.4, 0.0])
    expected = [exp(0.3) * sqrt(0.1**2 + 0.3**2), sqrt(0.1**2 + 0.4**2), 4.0]
    np.testing.assert_allclose(known.std, expected)
    assert known.is_identifiable == (False, True, False)  # 0.3 of ln 100 is 6.5 % of the bounds, 0.4 is 4 %


def test_a_move_that_is_left_out_as_a_whole_is_no_write():
    start = np.array([1.1, 1.3])  # whose way to the unit cube and back rounds
    own = Guard(GuardSettings(tolerance=0.5), SPACE, start, 100.0, seen((1.0, 1.0), (1.0, 1.0), truth=start))
    ruling = own.step(Point(2, 0.02, None, 0.0), proposed((2.1, 0.3)), start, calm)
    assert ruling.write is None
    assert kinds(ruling) == ["hold"]
    assert own.summary()["written"] == 0


def test_a_write_along_what_is_seen_goes_through_bit_for_bit():
    theta = np.array([4.1, 4.1])
    reviewed = guard(seen((1.0, 1.0), truth=theta)).step(1, 0.01, 0.0, proposed(theta), calm)
    assert reviewed.write is not None
    np.testing.assert_array_equal(reviewed.write, theta)


def test_a_candidate_that_explains_the_newest_sample_worse_is_vetoed():
    reviewed = guard(seen(*BOTH, truth=START)).step(3, 0.03, 0.0, proposed((7.0, 3.0)), calm)
    assert kinds(reviewed) == ["veto"]
    assert "explains the newest sample worse" in reviewed.events[0].detail["reason"]


@pytest.mark.parametrize(
    ("with_it", "without", "error", "is_written"),
    [
        (0.1, 0.1, 0.0, True),
        (0.1, 0.01, 0.0, False),
        (0.1, 0.01, 0.09, True),  # no larger than it is now
        (inf, 0.2, 0.1, False),
        (inf, inf, 0.1, True),  # nothing is better left alone
        (None, None, 0.0, True),  # nothing is known
    ],
    ids=["as good", "worse", "as now", "diverges", "diverges either way", "unknown"],
)
def test_a_write_must_not_be_predicted_to_be_worse_than_none(with_it, without, error, is_written):
    def peak(controller, plant, disturbance):
        assert disturbance is None
        return with_it if np.array_equal(controller, GOOD) else without

    reviewed = guard().step(3, 0.03, error, proposed(GOOD), peak)
    assert (reviewed.write is not None) == is_written
    assert kinds(reviewed) == ([] if is_written else ["veto"])


def test_the_prediction_is_widened_along_the_direction_seen_least():
    asked = []

    def peak(controller, plant, disturbance):
        assert disturbance is None
        if np.array_equal(controller, GOOD):
            asked.append(plant)
        return 0.01

    support = seen((1.0, 1.0), (1.0, 1.0), (0.1, -0.1))
    guard(support, n_std=2.0).step(3, 0.03, 0.0, proposed(GOOD), peak)
    # least squares: along (1, -1)/sqrt(2) the regressor is 0.1 sqrt(2), so theta's deviation is SIGMA / 0.1414
    offset = 2.0 * SIGMA / (0.1 * np.sqrt(2.0)) * np.array([1.0, -1.0]) / np.sqrt(2.0)
    assert len(asked) == 3
    np.testing.assert_array_equal(asked[0], GOOD)
    np.testing.assert_allclose(sorted(map(tuple, asked[1:])), sorted(map(tuple, (GOOD + offset, GOOD - offset))))


def test_a_small_change_is_not_looked_into_until_small_changes_add_up():
    asked = []

    def peak(controller, plant, disturbance):
        assert disturbance is None
        asked.append(controller)
        return 0.01

    watched = guard(seen(*BOTH, truth=BETTER), material=0.05)
    for k, step in enumerate((0.2, 0.4, 0.6), 3):
        watched.step(k, 0.01 * k, 0.0, proposed(START + step), peak)
        assert bool(asked) == (step > 0.5)


@pytest.mark.parametrize("is_warranted", [False, True])
def test_what_is_written_undecided_is_counted(is_warranted):
    """A disturbance explains the samples as well, and the parameters are predicted to do no harm in either case."""
    watched = guard(seen(*BOTH, truth=GOOD))
    proposal = replace(proposed(GOOD), possible_disturbance=np.array([0.5]), is_warranted=is_warranted)
    assert watched.step(3, 0.03, 0.0, proposal, lambda *plant: 0.01).write is not None
    assert watched.step(4, 0.04, 0.0, NOTHING, calm).write is None
    assert [watched.summary()[kind] for kind in ("written", "undecided")] == [1, not is_warranted]


@pytest.mark.parametrize(("may_be_noise", "is_on_trial"), [(False, False), (True, False), (True, True)])
def test_a_small_change_that_may_be_noise_is_looked_into_unless_others_are_on_trial(may_be_noise, is_on_trial):
    def peak(controller, plant, disturbance):
        return 1.0 if controller[0] in (2.2, 4.2) else 0.01

    watched = guard(seen(*BOTH, truth=GOOD if is_on_trial else START), material=0.05)
    if is_on_trial:
        assert watched.step(2, 0.02, 0.0, proposed(GOOD), peak).write is not None
    proposal = proposed([4.2, 4.2] if is_on_trial else [2.2, 2.2])
    rival, if_noise = np.array([0.5]), START if may_be_noise else None
    proposal = replace(proposal, possible_disturbance=rival, if_noise=if_noise)
    reviewed = watched.step(3, 0.03, 0.0, proposal, peak)
    assert (reviewed.write is None) == (may_be_noise and not is_on_trial)
    assert kinds(reviewed) == (["veto"] if reviewed.write is None else [])


# After a write.


MUTE = Sample(9.0, (0.0, 0.0), (), (0.0,))
"""A sample that any parameters explain."""
OF_START = Sample(9.0, (1.0, 1.0), (), (4.0,))
"""A sample that START explains, and GOOD does not."""


def written(peak=calm, **settings):
    """A guard that has written GOOD at k = 1, and then gets a sample that tells nothing; the tolerance is 0.5."""
    support = seen(*BOTH)
    watched = guard(support, **settings)
    assert watched.step(1, 0.01, 0.0, proposed(GOOD), peak).write is not None
    support.append(MUTE)
    return watched


def test_an_error_within_the_tolerance_confirms():
    watched = written(probation=10)
    told = [kinds(watched.step(k, 0.01 * k, 0.5, NOTHING, calm)) for k in range(2, 12)]
    assert told == [[]] * 9 + [["confirm"]]
    assert watched.summary()["confirmed"] == 1


def test_a_regression_takes_the_write_back():
    watched = written()
    reviewed = watched.step(2, 0.02, 0.51, proposed(BETTER), calm)
    np.testing.assert_array_equal(reviewed.write, START)
    np.testing.assert_array_equal(watched.held, START)
    assert kinds(reviewed) == ["revert"]
    assert watched.summary()["reverted"] == 1


def test_a_regression_is_borne_with_where_the_samples_contradict_the_way_back():
    """Its limit is 0.5, and growth is 2: up to 2."""
    watched = guard(growth=2.0)  # the newest sample is that of GOOD
    assert watched.step(1, 0.01, 0.0, proposed(GOOD), calm).write is not None
    assert [kinds(watched.step(k, 0.01 * k, 2.0, NOTHING, calm)) for k in (2, 3, 4)] == [[], [], []]
    assert watched.summary()["reverted"] == 0
    reviewed = watched.step(5, 0.05, 2.01, NOTHING, calm)
    assert (kinds(reviewed), reviewed.write.tolist()) == (["revert"], START.tolist())


FULL, FAINT = ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, -2.0)), ((0.01, 0.0), (0.0, 0.01)) * 4
"""Regressors, at which START is wrong by 2 to 4, 20 and more standard deviations, and by a fifth of one."""


@pytest.mark.parametrize(
    ("rows", "truth", "newest", "proposal", "told"),
    [
        (FULL, GOOD, MUTE, "proven", []),
        (FULL, GOOD, MUTE, "possible", ["revert"]),  # a disturbance explains them as well
        (FULL[:3], GOOD, MUTE, "proven", ["revert"]),  # three values, of which any parameters explain two
        (FAINT, GOOD, MUTE, "proven", ["revert"]),  # the way back is right but for noise
        (FULL, GOOD, OF_START, "proven", ["revert"]),  # what GOOD had followed is over
        (FULL, BETTER, MUTE, "proven", ["revert"]),  # both are wrong
    ],
    ids=["right", "unproven", "few", "no contradiction", "wrong now", "wrong"],
)
def test_a_newest_sample_that_tells_nothing_takes_nothing_back_that_those_before_prove(
    rows, truth, newest, proposal, told
):
    """The limit is 0.5, and growth is 2: up to 2 where the samples contradict what would return."""
    support = seen(*rows, truth=truth)
    watched = guard(support, growth=2.0)
    support.append(Sample(4.0, (1.0, 1.0), (), (8.0,)))  # of GOOD, so that it is written
    possible = None if proposal == "proven" else np.array([0.3])
    assert (
        watched.step(1, 0.01, 0.0, replace(proposed(GOOD), possible_disturbance=possible), lambda *plant: 0.01).write
        is not None
    )
    support.restore(support.snapshot()[:-1])
    support.append(newest)
    assert kinds(watched.step(2, 0.02, 2.0, NOTHING, calm)) == told
    if not told:
        assert kinds(watched.step(3, 0.03, 2.01, NOTHING, calm)) == ["revert"]
        np.testing.assert_array_equal(watched.held, START)


@pytest.mark.parametrize("is_contradicted", [False, True])
def test_an_error_that_is_no_number_is_a_regression(is_contradicted):
    for error in (nan, inf):
        watched = guard() if is_contradicted else written()
        if is_contradicted:
            watched.step(1, 0.01, 0.0, proposed(GOOD), calm)
        assert kinds(watched.step(2, 0.02, error, NOTHING, calm)) == ["revert"]


def test_an_error_that_was_predicted_is_no_regression():
    watched = written(lambda controller, plant, disturbance: 1.0, growth=1.5)
    assert kinds(watched.step(2, 0.02, 1.49, NOTHING, calm)) == []
    assert kinds(watched.step(3, 0.03, 1.51, NOTHING, calm)) == ["revert"]


@pytest.mark.parametrize(("error", "allowed"), [(0.0, 2.25), (2.0, 9.0)])
def test_what_a_prediction_excuses_is_at_most_three_times_the_error_or_the_tolerance(error, allowed):
    """A wrong sensor makes a plant plausible in which the error is large with or without the write."""
    support = seen(*BOTH)
    watched = guard(support, growth=1.5)
    assert watched.step(1, 0.01, error, proposed(GOOD), lambda *_: 1e3).write is not None
    support.append(MUTE)
    assert kinds(watched.step(2, 0.02, 0.99 * allowed, NOTHING, calm)) == []
    assert kinds(watched.step(3, 0.03, 1.01 * allowed, NOTHING, calm)) == ["revert"]


def test_the_way_back_leads_to_what_was_confirmed_and_then_to_the_start():
    support = seen(*BOTH)
    watched = guard(support, probation=10)
    watched.step(1, 0.01, 0.0, proposed(GOOD), calm)
    assert kinds(watched.step(11, 0.11, 0.0, NOTHING, calm)) == ["confirm"]
    support.append(Sample(4.0, (1.0, 1.0), (), (12.0,)))  # of BETTER
    assert watched.step(12, 0.12, 0.0, proposed(BETTER), calm).write is not None
    support.append(MUTE)
    np.testing.assert_array_equal(watched.step(13, 0.13, 1.0, NOTHING, calm).write, GOOD)
    np.testing.assert_array_equal(watched.step(14, 0.14, 2.0, NOTHING, calm).write, START)


def test_what_is_replaced_by_the_last_good_ones_is_never_good():
    """It was in force for one step: that nothing has happened since says nothing about it."""
    support = seen(*BOTH)
    watched = guard(support, probation=10)
    watched.step(1, 0.01, 0.0, proposed(GOOD), calm)
    support.append(MUTE)
    assert watched.step(2, 0.02, 0.0, proposed(START * (1.0 + 1e-15)), calm).write is not None
    told = [kind for k in range(3, 20) for kind in kinds(watched.step(k, 0.01 * k, 0.0, NOTHING, calm))]
    assert told == []
    assert watched.summary()["confirmed"] == 0


@pytest.mark.parametrize("share", [0.0, 0.8])
def test_what_was_in_force_for_a_step_is_not_confirmed_unless_what_follows_is_close(share):
    """The next write is that share of the way from GOOD to BETTER short of BETTER."""
    support = seen(*BOTH)
    watched = guard(support, probation=10)
    assert watched.step(1, 0.01, 0.0, proposed(GOOD), calm).write is not None
    support.append(MUTE)
    following = BETTER + share * (GOOD - BETTER)
    assert watched.step(2, 0.02, 0.0, proposed(following), calm).write is not None
    told = [event for k in range(3, 20) for event in watched.step(k, 0.01 * k, 0.0, NOTHING, calm).events]
    assert [event.kind for event in told] == ["confirm"]
    np.testing.assert_array_equal(told[0].detail["theta"], following if share == 0.0 else GOOD)


def test_nothing_is_written_for_a_probation_after_a_revert():
    watched = written(probation=10)
    watched.step(2, 0.02, 1.0, NOTHING, calm)
    is_quiet = [watched.step(k, 0.01 * k, 0.0, proposed(GOOD), calm).write is None for k in range(3, 13)]
    assert is_quiet == [True] * 9 + [False]


def test_too_many_reverts_stop_re_tuning_with_the_parameters_of_the_start():
    watched = guard(probation=5, reverts=2)
    k = 0
    for n in (1, 2):
        k += 10
        assert watched.step(k, 0.01 * k, 0.0, proposed(GOOD), calm).write is not None
        reviewed = watched.step(k + 1, 0.01 * (k + 1), 9.0, NOTHING, calm)
        assert kinds(reviewed) == (["revert"] if n == 1 else ["revert", "stop"])
        np.testing.assert_array_equal(reviewed.write, START)
    assert watched.summary() | {"stopped_at": 0.21} == watched.summary()


def test_a_controller_that_holds_something_else_stops_re_tuning():
    watched = written()
    assert watched.not_taken(0.02, GOOD.tolist(), GOOD, ["c.a", "c.b"]) is None
    assert watched.not_taken(0.02, np.float32(GOOD * 1.1 / 1.1).tolist(), GOOD, ["c.a", "c.b"]) is None
    event = watched.not_taken(0.02, [4.0, 2.0], GOOD, ["c.a", "c.b"])
    assert event.kind == "stop"
    assert event.detail["reason"] == "c.b reads back as 2, but 4 was written: re-tuning stops"
    assert watched.guard.stopped_at == 0.02
