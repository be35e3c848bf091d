"""Each rule of the guard at its limits, with invented samples and prediction; data support on linear regression."""

from math import inf, nan, sqrt

import numpy as np
import pytest

from cosim.retuning.data_support import DataSupport, NoDataSupport
from cosim.retuning.guard import Guard, within_rate
from cosim.scenarios.schema.guard import GuardSettings
from estimator import Estimate, Sample
from estimator.identifiability import Information
from estimator.retuning.proposal import Proposal
from tests.cosim.retuning.linear_plant import BETTER, GOOD, SPACE, START, Watched, linear_rows, seen

NOTHING = Proposal()


class Told(NoDataSupport):
    """A support that says what it is told: costs by theta, 0 for others, and the plants besides the estimate."""

    def __init__(self, costs=(), plants=()):
        self._costs, self._plants = dict(costs), plants
        self.asked = []

    def cost(self, theta):
        return self._costs.get(tuple(theta), 0.0)

    def identifiable_part(self, theta, held, at, unseen, little, known=None):
        self.asked.append((*theta, *held, *at, unseen))
        return theta, ()

    def plausible_parameters(self, theta, n_std, little):
        yield "estimate", theta
        yield from (("neighbour", plant) for plant in self._plants)


class Peaks:
    """A prediction that says what it is told, by controller and plant, else by controller, else 0.01."""

    def __init__(self, peaks):
        self._peaks, self.asked = peaks, []

    def __call__(self, controller, plant, disturbance):
        assert disturbance is None
        one, other = tuple(controller), tuple(plant)
        self.asked.append((one, other))
        return self._peaks[one, other] if (one, other) in self._peaks else self._peaks.get(one, 0.01)


def guard(support=None, start=START, **settings):
    made = Guard(GuardSettings(**({"tolerance": 0.5} | settings)), SPACE, np.array(start), 100.0, support or Told())
    return Watched(made, np.array(start))


def proposed(theta, estimate=None):
    theta = np.array(theta, dtype=float)
    best = Estimate(
        theta if estimate is None else np.array(estimate), np.full(2, 0.1), (True, True), 0.0, 1, "incumbent"
    )
    return Proposal(theta, best)


def step(watched, k, theta=None, error=0.0, peak=None):
    """Kinds of the events, and what is written, as a tuple."""
    ruling = watched.step(k, 0.01 * k, error, NOTHING if theta is None else proposed(theta), peak)
    return [e.kind for e in ruling.events], None if ruling.write is None else tuple(ruling.write.tolist())


PASSED, VETOED = [], ["veto"]


# Before a write.


def test_a_move_by_the_rate_itself_is_not_limited():
    theta = np.array([5.0, 0.0])
    assert within_rate(theta, np.zeros(2), SPACE, 0.5) == (theta, ())


def test_the_parameter_that_moves_most_is_named_whichever_way_it_moves():
    limited, ((_, reason),) = within_rate(np.array([4.0, 1.0]), np.array([2.0, 9.0]), SPACE, 0.4)
    np.testing.assert_allclose(limited, [3.0, 5.0])  # half the way
    assert reason == "b would move by 0.8 of its bounds in a macro step, at most 0.4 is allowed"


def test_a_limited_move_starts_from_what_is_held_and_is_what_is_looked_into():
    support, peak = Told({tuple(BETTER): 1e9}), Peaks({tuple(BETTER): 1e9})
    watched = guard(support, rate=0.125, unseen=0.3)
    for k, value in ((1, 3.25), (2, 4.5), (3, 5.75), (4, 6.0)):
        kinds, theta = step(watched, k, BETTER, peak=peak)
        if value == 6.0:  # small, and no longer looked into
            assert (kinds, theta) == (PASSED, (6.0, 6.0))
            break
        assert kinds == ["limit"]
        assert theta == pytest.approx((value, value))
        assert support.asked[-1] == pytest.approx((value, value, *[value - 1.25] * 2, 6.0, 6.0, 0.3))
        assert (theta, tuple(BETTER)) in peak.asked
    assert watched.summary() == {
        "written": 4, "undecided": 0, "limited": 3, "held": 0, "vetoed": 0, "confirmed": 0, "reverted": 0,
        "retracted": 0, "undone": 0, "stopped_at": None,
    }  # fmt: skip


def test_a_move_that_the_rate_makes_small_is_not_looked_into():
    peak = Peaks({})
    kinds, theta = step(guard(rate=0.0625), 1, GOOD, peak=peak)
    assert peak.asked
    peak = Peaks({})
    kinds, theta = step(guard(rate=0.03125), 1, GOOD, peak=peak)
    assert kinds == ["limit"]
    assert theta == pytest.approx((2.3125, 2.3125))
    assert not peak.asked


@pytest.mark.parametrize(
    ("theta", "is_looked_into"),
    [((5.0, 2.5), False), ((5.01, 2.5), True), ((2.5, 4.9), False), ((0.0, 2.5), False), ((0.0, 5.01), True)],
)
def test_more_than_material_is_looked_into(theta, is_looked_into):
    peak = Peaks({})
    step(guard(start=(2.5, 2.5), material=0.25), 1, theta, peak=peak)
    assert bool(peak.asked) == is_looked_into


def test_a_move_down_is_looked_into():
    peak = Peaks({})
    step(guard(), 1, (1.0, 1.0), peak=peak)
    assert peak.asked


def test_small_is_what_is_small_beside_the_last_that_was_looked_into():
    watched, peak = guard(), Peaks({})
    step(watched, 1, GOOD)
    assert step(watched, 2, GOOD + 0.3, peak=peak)[0] == PASSED
    assert not peak.asked
    step(watched, 3, GOOD + 0.6, peak=peak)
    assert peak.asked


def squared(deviations):
    return deviations * deviations


@pytest.mark.parametrize(
    ("cost", "before", "is_written"),
    [
        (squared(4.88), 0.0, True),  # of noise alone, with a probability of 1e-6: 4.892 standard deviations
        (squared(4.90), 0.0, False),
        (199.0, 100.0, True),
        (201.0, 100.0, False),
        (inf, 100.0, False),
        (nan, 0.0, False),
        (inf, inf, True),  # nothing is better left alone
        (1e9, nan, True),
    ],
)
def test_how_much_worse_the_newest_sample_may_be_explained(cost, before, is_written):
    support = Told({tuple(GOOD): cost, tuple(START): before})
    assert step(guard(support), 1, GOOD)[0] == (PASSED if is_written else VETOED)


def test_what_explains_the_newest_sample_is_compared_with_what_is_held():
    support = Told({tuple(START): 1e6, tuple(BETTER): 1e3})
    watched = guard(support)
    assert step(watched, 1, GOOD)[0] == PASSED
    assert step(watched, 2, BETTER)[0] == VETOED


@pytest.mark.parametrize(
    ("found", "stay", "error", "is_written"),
    [
        (0.5, 0.1, 0.25, True),  # growth is 2
        (0.51, 0.1, 0.25, False),
        (0.5, 0.25, 0.1, True),
        (0.51, 0.25, 0.1, False),
        (0.5, None, 0.0, False),  # without the write nothing is known
        (None, 0.1, 0.0, True),
    ],
)
def test_how_much_worse_may_be_predicted(found, stay, error, is_written):
    peak = Peaks({tuple(GOOD): found, tuple(START): stay})
    kinds, _ = step(guard(growth=2.0), 1, GOOD, error, peak)
    assert kinds == (PASSED if is_written else VETOED)


def test_every_plant_is_asked_for_with_the_candidate_and_with_what_is_held():
    plants = (7.0, 1.0), (1.0, 7.0)
    good, held, estimate = tuple(BETTER), tuple(GOOD), (5.0, 5.0)
    peak = Peaks({(good, estimate): None, (good, plants[0]): 1.0, (held, plants[0]): 1.0, (good, plants[1]): 9.0})
    watched = guard(Told(plants=[np.array(p) for p in plants]))
    step(watched, 1, GOOD)
    reviewed = watched.step(2, 0.02, 0.0, proposed(BETTER, estimate), peak)
    assert peak.asked == [(good, estimate), *[(who, plant) for plant in plants for who in (good, held)]]
    told = "predicted peak of the tracking error 9, without the write 0.01 (neighbour)"
    assert reviewed.events[-1].detail["reason"] == told


def test_reasons_come_in_their_order():
    support, peak = Told({(3.0, 3.0): 1e9}), Peaks({(3.0, 3.0): 1e9})
    assert step(guard(support, rate=0.125, start=(1.75, 1.75)), 1, GOOD)[0] == ["limit", "veto"]
    assert step(guard(rate=0.125, start=(1.75, 1.75)), 1, GOOD, peak=peak)[0] == ["limit", "veto"]


def test_what_was_refused_is_not_judged_again_for_half_a_horizon():
    watched, bad = guard(horizon=10), Peaks({tuple(BETTER): 1.0})
    assert step(watched, 1, BETTER, peak=bad)[0] == VETOED
    for k in range(2, 6):
        assert step(watched, k, BETTER, peak=bad) == ([], None)
    assert step(watched, 6, BETTER, peak=bad)[0] == VETOED
    assert step(watched, 7, GOOD, peak=bad)[0] == PASSED  # another one
    assert watched.summary()["vetoed"] == 2


# After a write.


def test_the_tolerance_is_a_hundredth_of_the_divergence():
    watched = guard(tolerance=None)
    step(watched, 1, GOOD)
    assert step(watched, 2, error=1.0) == ([], None)
    assert step(watched, 3, error=1.01) == (["revert"], tuple(START))


def test_the_error_of_a_write_may_grow():
    watched = guard(growth=1.5)
    step(watched, 1, GOOD, error=1.0)
    assert step(watched, 2, error=1.49) == ([], None)
    assert step(watched, 3, error=1.51) == (["revert"], tuple(START))


def test_the_largest_of_the_predicted_errors_is_what_is_expected():
    plants = [np.array([7.0, 1.0]), np.array([1.0, 7.0])]
    peaks = {(tuple(GOOD), tuple(plants[0])): 1.0, (tuple(START), tuple(plants[0])): 1.0}
    watched = guard(Told(plants=plants), growth=1.5)
    step(watched, 1, GOOD, peak=Peaks(peaks))
    assert step(watched, 2, error=1.49) == ([], None)
    assert step(watched, 3, error=1.51)[0] == ["revert"]


def test_a_later_write_does_not_widen_what_the_first_one_is_allowed():
    watched = guard()
    step(watched, 1, GOOD)
    peak = Peaks({tuple(BETTER): 1.0, tuple(GOOD): 1.0})
    assert step(watched, 2, BETTER, peak=peak)[0] == PASSED
    assert step(watched, 3, error=0.51) == (["revert"], tuple(START))


CLOSE = GOOD + 0.6
"""Six hundredths of the bounds further: material, and not far away."""


def test_writes_are_confirmed_in_their_order():
    watched = guard(probation=10)
    for k, theta in ((1, GOOD), (3, CLOSE)):
        step(watched, k, theta)
    assert step(watched, 11)[0] == ["confirm"]
    assert step(watched, 12, error=0.51) == (["revert"], tuple(GOOD))


def test_what_is_due_is_confirmed_at_once():
    watched = guard(probation=10)
    for k, theta in ((1, GOOD), (3, CLOSE)):
        step(watched, k, theta)
    assert step(watched, 13)[0] == ["confirm", "confirm"]
    assert watched.summary()["confirmed"] == 2


def test_a_step_tells_all_that_happens_in_it():
    bad = Peaks({(8.0, 8.0): 1.0})
    for theta, peak, expected in (
        (BETTER, None, ["confirm"]),
        ((8.0, 8.0), bad, ["confirm", "veto"]),
    ):
        watched = guard(probation=10)
        step(watched, 1, GOOD)
        assert step(watched, 11, theta, peak=peak)[0] == expected
    watched = guard(probation=10, horizon=100)
    step(watched, 1, GOOD)
    step(watched, 2, (8.0, 8.0), peak=bad)
    assert step(watched, 11, (8.0, 8.0), peak=bad) == (["confirm"], None)
    step(watched, 12, BETTER)
    assert step(watched, 13, BETTER, error=1.0) == (["revert"], tuple(GOOD))
    assert step(watched, 14, BETTER) == ([], None)  # it rests


def test_the_start_is_not_watched():
    watched = guard()
    step(watched, 1, GOOD)
    assert step(watched, 2, error=0.51) == (["revert"], tuple(START))
    assert step(watched, 3, error=9.0) == ([], None)
    assert watched.summary()["reverted"] == 1


def reverted_to_good(**settings):
    """A guard that went back to GOOD, which was confirmed, at k = 13 and an error of 1."""
    watched = guard(probation=10, growth=1.5, **settings)
    step(watched, 1, GOOD)
    step(watched, 11)
    step(watched, 12, BETTER)
    assert step(watched, 13, error=1.0) == (["revert"], tuple(GOOD))
    return watched


def test_what_was_good_is_watched_too():
    watched = reverted_to_good()
    assert step(watched, 14, error=1.49) == ([], None)
    assert step(watched, 15, error=1.51) == (["revert"], tuple(START))


def test_what_was_good_and_failed_is_good_no_longer():
    watched = reverted_to_good(reverts=9)
    assert step(watched, 14, error=9.0) == (["revert"], tuple(START))
    assert step(watched, 24, BETTER)[0] == PASSED
    assert step(watched, 25, error=9.0) == (["revert"], tuple(START))


def test_what_returns_and_fails_in_the_rest_after_it_is_no_further_revert_and_the_next_write_that_fails_is():
    watched = reverted_to_good(reverts=2)
    ruling = watched.step(14, 0.14, 9.0, NOTHING, None)
    assert [(e.kind, e.detail["n"]) for e in ruling.events] == [("revert", 1)]
    assert tuple(watched.held) == tuple(START)
    assert [step(watched, k, BETTER) for k in range(15, 24)] == [(PASSED, None)] * 9  # it rests once more
    assert step(watched, 24, BETTER) == (PASSED, tuple(BETTER))
    assert step(watched, 25, error=9.0) == (["revert", "stop"], tuple(START))
    assert watched.summary()["reverted"] == 3


def test_what_comes_back_is_what_small_changes_are_counted_from():
    watched, peak = reverted_to_good(), Peaks({})
    assert step(watched, 23, GOOD + 0.3, peak=peak)[0] == ["confirm"]
    assert not peak.asked


def test_the_last_revert_goes_to_the_start_though_something_was_good():
    watched = guard(probation=10, reverts=1)
    step(watched, 1, GOOD)
    step(watched, 11)
    step(watched, 12, BETTER)
    assert step(watched, 13, error=1.0) == (["revert", "stop"], tuple(START))
    assert watched.guard.stopped_at == pytest.approx(0.13)


def test_what_is_taken_back_is_no_longer_watched_and_what_was_before_it_is():
    watched, peak = guard(), Peaks({})
    step(watched, 1, GOOD)
    before = watched.snapshot()
    step(watched, 2, BETTER)
    watched.restore(before)
    watched.held = GOOD
    assert step(watched, 3, GOOD + 0.3, peak=peak)[0] == PASSED
    assert not peak.asked  # small, beside what is held
    assert step(watched, 4, error=0.51) == (["revert"], tuple(START))
    before = watched.snapshot()
    step(watched, 200, GOOD)
    watched.restore(before)
    watched.held = START
    assert step(watched, 202, error=9.0) == ([], None)
    assert watched.summary()["retracted"] == 2


def test_what_an_outlier_has_taken_off_probation_is_watched_again():
    watched = guard()
    step(watched, 1, GOOD)
    before = watched.snapshot()
    step(watched, 2, START)  # the last good parameters: nothing is on probation
    watched.restore(before)
    watched.held = GOOD
    assert step(watched, 3, error=0.51) == (["revert"], tuple(START))


def test_a_write_into_a_loop_that_diverges_either_way_is_still_watched():
    watched = guard()
    peak = Peaks({tuple(START): np.inf, tuple(GOOD): np.inf})
    assert step(watched, 1, GOOD, peak=peak)[0] == PASSED
    assert step(watched, 2, error=0.51) == (["revert"], tuple(START))


@pytest.mark.parametrize(
    ("read", "is_taken"),
    [
        ((0.0, 1e-9, 1e4), True),
        ((1e-39, 1e-9 * (1.0 - 9e-7), 1e4 * (1.0 + 9e-7)), True),
        ((2e-6, 1e-9, 1e4), False),
        ((0.0, 5e-7, 1e4), False),
        ((0.0, 1e-9, 1e4 * (1.0 + 2e-6)), False),
        ((0.0, 1e-9, nan), False),
    ],
)
def test_single_precision_is_no_reason_to_stop(read, is_taken):
    watched = guard(start=(0.0, 1e-9, 1e4))
    assert (watched.not_taken(1.0, read, watched.held, ["c.a", "c.b", "c.c"]) is None) == is_taken
    assert watched.guard.stopped_at == (None if is_taken else 1.0)


# What the samples see: y = x . theta, measured with SIGMA.


@pytest.mark.parametrize(("weight", "is_seen"), [(0.03, True), (0.028, False)])
def test_which_deviation_is_unseen(weight, is_seen):
    """b has the deviation SIGMA / weight, 1/3 and 0.357 of its bounds; a is seen well."""
    theta, reasons = seen((1.0, 0.0), (0.0, weight)).identifiable_part(GOOD, START, GOOD, 0.35, 0.01)
    np.testing.assert_allclose(theta, GOOD if is_seen else (4.0, 2.0), atol=1e-6)
    assert len(reasons) == (not is_seen)


@pytest.mark.parametrize(("b", "is_let_be"), [(2.9, True), (2.8, False)])
def test_a_small_part_that_is_not_seen_is_let_be(b, is_let_be):
    """A move by (0.1, 0.09) of the bounds has 0.01 / sqrt(2) along (1, -1), which only the sum does not see."""
    watched, theta = guard(seen((1.0, 1.0), truth=(3.0, b))), (3.0, b)
    kinds, written = step(watched, 1, theta)
    assert (written == theta) == is_let_be
    assert kinds == (PASSED if is_let_be else ["hold"])
    assert watched.summary()["held"] == (not is_let_be)


KNOWN = Information(np.array([100.0, 50.0]), np.eye(2))
"""That of an estimate whose standard deviations are 0.01 and 0.02 of the bounds."""
KNOWS_THE_SUM = Information(np.array([100.0, 0.0]), np.array([[1.0, 1.0], [1.0, -1.0]]) / sqrt(2.0))


@pytest.mark.parametrize(
    ("reason", "known", "disturbance", "written"),
    [
        ("filtered", KNOWN, None, (6.0, 2.0)),
        ("filtered", KNOWS_THE_SUM, None, (4.0, 4.0)),
        ("filtered", None, None, (4.0, 4.0)),
        ("filtered", KNOWN, 0.3, (4.0, 4.0)),  # older samples may be of a disturbance, too
        ("unscented Kalman filter", KNOWN, None, (4.0, 4.0)),  # a prior is in what it knows
    ],
)
def test_what_all_samples_since_the_change_have_shown_is_written_though_the_newest_do_not_show_it(
    reason, known, disturbance, written
):
    """These show the sum only, of which the move by (4, 0) has (2, 2)."""
    watched = guard(seen((1.0, 1.0), (1.0, 1.0)), start=(2.0, 2.0))
    theta, rival = np.array([6.0, 2.0]), None if disturbance is None else np.array([disturbance])
    filtered = Estimate(theta, np.array([0.1, 0.2]), (True, True), 0.0, 0, reason, known)
    ruling = watched.step(2, 0.02, 0.0, Proposal(theta, filtered, possible_disturbance=rival), lambda *plant: 0.01)
    np.testing.assert_allclose(ruling.write, written, atol=1e-6)
    assert [event.kind for event in ruling.events] == ([] if written == (6.0, 2.0) else ["hold"])


def test_a_move_that_is_held_in_part_stays_inside_the_bounds():
    theta, _ = seen((1.0, 1.0)).identifiable_part(np.array([10.0, 9.0]), np.array([0.0, 9.0]), GOOD, 0.35, 0.01)
    np.testing.assert_allclose(theta, [5.0, 10.0], atol=1e-6)  # the move along (1, 1) of (10, 0), as far as it goes


@pytest.mark.parametrize(("n_std", "n"), [(0.9, 1), (1.1, 3)])
def test_an_estimate_that_is_certain_is_not_widened(n_std, n):
    """The direction seen least has the deviation SIGMA: a hundredth of the bounds."""
    assert len([*seen((1.0, 0.0), (0.0, 1.0), (1.0, 1.0)).plausible_parameters(GOOD, n_std, 0.01)]) == n


def test_an_estimate_is_widened_by_a_quarter_of_the_bounds_at_most_and_not_beyond_them():
    plants = [plant for _, plant in seen((1.0, 1.0)).plausible_parameters(np.array([9.9, 5.0]), 2.0, 0.01)]
    away = 2.5 / sqrt(2.0)
    expected = sorted([(10.0, 5.0 - away), (9.9 - away, 5.0 + away)])
    np.testing.assert_allclose(sorted(map(tuple, plants[1:])), expected, rtol=1e-5)


def test_the_newest_sample_costs_until_it_is_taken_back():
    support = DataSupport(linear_rows, SPACE, 1, 30)
    assert support.cost(GOOD) == 0.0
    support.append(Sample(0.0, (1.0, 0.0), (), (4.1,)))
    before = support.snapshot()
    support.append(Sample(0.0, (1.0, 0.0), (), (4.3,)))
    assert support.cost(GOOD) == pytest.approx(squared(3.0))
    support.restore(before)
    assert support.cost(GOOD) == pytest.approx(squared(1.0))


def test_a_sample_that_has_no_number_says_nothing():
    support = seen((1.0, 0.0), (0.0, 1.0))
    before = support.information(GOOD).singular_values
    support.append(Sample(9.0, (nan, 1.0), (), (1.0,)))
    np.testing.assert_array_equal(support.information(GOOD).singular_values, before)
