"""The loop around an estimator: when it begins, how much it evaluates, what it writes. The estimator is a script."""

import math

import numpy as np
import pytest

from estimator import (
    EpisodeWindow,
    Estimate,
    Evaluation,
    NoEstimateError,
    Parameter,
    ParameterSpace,
    ResidualWindow,
    Sample,
)
from estimator.baselines.kalman import UnscentedKalman
from estimator.retuning.retuner import Retuner
from estimator.retuning.search import Budget
from estimator.triggers import AlwaysTrigger, InnovationTrigger, TrackingTrigger

START = np.array([0.0])


class Scripted:
    """Asks for the given values in turn and believes in the best; the truth is 10."""

    is_whitened = False

    def __init__(self, *script):
        self.script, self.told, self.restarts = list(script), [], []

    def restart(self, start):
        self.restarts.append(float(start[0]))
        self.told = []

    def ask(self):
        return np.array([float(self.script.pop(0))])

    def tell(self, theta, residual):
        self.told.append((float(residual @ residual), float(theta[0])))

    def estimate(self):
        cost, best = min(self.told)
        return Estimate(np.array([best]), np.array([0.5]), (True,), cost, len(self.told), "best so far")


class Rescored(Scripted):
    """The same, with candidates that can be judged anew."""

    is_whitened = True

    def __init__(self, *script):
        super().__init__(*script)
        self.rescored = []

    @property
    def candidates(self):
        return np.array([[theta] for _, theta in self.told])

    def rescore(self, residuals):
        self.rescored.append(np.asarray(residuals).tolist())
        self.told = [(float(r @ r), theta) for r, (_, theta) in zip(residuals, self.told, strict=True)]


def residual(theta, sample):
    return np.array([sample.xdot[0] - theta[0]])


class Loop:
    """A retuner, and a controller that takes whatever is proposed."""

    def __init__(self, *parts):
        self.retuner, self.held = Retuner(*parts), START

    def step(self, t, sample, tracking_error):
        proposal = self.retuner.step(t, sample, tracking_error, self.held)
        self.held = self.held if proposal.theta is None else proposal.theta
        return proposal

    def __getattr__(self, name):
        return getattr(self.retuner, name)


def retuner(estimator, budget, trigger=None, window=1):
    trigger = trigger or TrackingTrigger(1.0)
    return Loop(estimator, ResidualWindow(residual, 1, window), trigger, budget)


def sample(t=0.0, value=10.0):
    return Sample(t, (0.0,), (0.0,), (value,))


def steps(loop, errors):
    return [loop.step(0.01 * k, sample(0.01 * k), error) for k, error in enumerate(errors)]


def kinds(decision):
    return [event.kind for event in decision.events]


def test_an_idle_loop_asks_nothing_and_writes_nothing():
    estimator = Scripted(1)
    loop = retuner(estimator, Budget())
    for decision in steps(loop, [0.0, 0.5, 0.999]):
        assert (decision.theta, decision.estimate, decision.events, decision.latencies) == (None, None, (), ())
    assert (estimator.script, estimator.restarts, loop.n_evaluations, loop.n_episodes) == ([1], [], 0, 0)


def test_a_point_without_a_sample_triggers_nothing_even_where_the_error_is_large():
    estimator, seen = Scripted(1, 2, 3), []

    def trigger(*arguments):
        seen.append(arguments)
        return "always"

    loop = retuner(estimator, Budget(3, 1), trigger)
    decision = loop.step(0.0, None, 99.0)
    assert (decision.theta, decision.events, decision.latencies, seen, estimator.restarts) == (None, (), (), [], [])


def test_a_search_goes_on_between_samples_on_those_that_it_has():
    estimator = Scripted(1, 9, 3)
    loop = retuner(estimator, Budget(3, 1))
    loop.step(0.01, sample(), 99.0)
    decision = loop.step(0.02, None, 99.0)
    assert decision.theta.tolist() == [9.0]
    assert {event.t for event in decision.events} == {0.02}
    assert [kind for event in loop.step(0.03, None, 99.0).events if (kind := event.kind) == "end"] == ["end"]
    assert loop.step(0.04, None, 99.0).events == ()  # the next episode waits for a sample
    assert (loop.n_episodes, loop.n_evaluations) == (1, 3)


def test_a_solver_solves_each_window_once():
    class Counting(Scripted):
        n_solved = 0

        def solve(self, objective):
            self.n_solved += 1
            self.told = [(objective.residual(START) @ objective.residual(START), 0.0)]

    estimator = Counting()
    loop = retuner(estimator, Budget(3, 1))
    loop.step(0.01, sample(), 99.0)
    assert loop.step(0.02, None, 99.0).events == ()
    loop.step(0.03, sample(), 99.0)
    assert estimator.n_solved == 2


def test_a_sample_that_is_taken_back_leaves_nothing_in_a_recursive_estimator_or_in_the_window():
    space = ParameterSpace([Parameter("a", 0.0, 20.0)])

    def loop():
        window = ResidualWindow(residual, 1, 30)
        return Loop(UnscentedKalman(space, START, None), window, AlwaysTrigger(), Budget(math.inf))

    values = [10.1, 9.8, 10.2, 9.9, 10.0, 10.3]
    clean, spoilt = loop(), loop()
    for k, value in enumerate(values):
        expected = clean.step(0.01 * k, sample(0.01 * k, value), 0.0)
        if k == 3:
            before, held = spoilt.snapshot(), spoilt.held
            outlier = spoilt.step(0.01 * k - 0.005, sample(0.01 * k - 0.005, 500.0), 0.0)
            assert abs(outlier.theta[0] - held[0]) > 0.1
            spoilt.restore(before, held)
            spoilt.held = held
        found = spoilt.step(0.01 * k, sample(0.01 * k, value), 0.0)
        np.testing.assert_array_equal(found.theta, expected.theta)
        np.testing.assert_array_equal(found.estimate.std, expected.estimate.std)
    assert spoilt.n_evaluations > clean.n_evaluations  # what was evaluated stays counted


def test_an_episode_that_an_outlier_began_has_not_begun():
    loop = retuner(Rescored(*range(1, 9)), Budget(3, 1), InnovationTrigger(residual, 1e-6), window=5)
    loop.step(0.01, sample(value=0.1), 0.0)
    before = loop.snapshot()
    assert kinds(loop.step(0.02, sample(value=50.0), 0.0))[:2] == ["trigger", "candidate"]
    loop.restore(before, START)
    loop.held = START
    decision = loop.step(0.03, sample(value=0.1), 0.0)
    assert decision.events == ()
    assert decision.theta is None


def test_an_episode_ends_when_its_evaluations_are_spent():
    loop = retuner(Scripted(*range(1, 6)), Budget(evaluations=5, evaluations_per_step=2))
    decisions = steps(loop, [2.0, 0.0, 0.0, 0.0])  # the error is small again: the episode goes on
    assert [kinds(d).count("candidate") for d in decisions] == [2, 2, 1, 0]
    assert [len(d.latencies) for d in decisions] == [2, 2, 1, 0]
    assert all(seconds >= 0.0 for d in decisions for seconds in d.latencies)
    assert (loop.n_evaluations, loop.n_episodes) == (5, 1)


def test_events_come_in_the_order_in_which_things_happen():
    decisions = steps(retuner(Scripted(4, 6, 7, 1), Budget(4, 2)), [2.0, 0.0])
    assert kinds(decisions[0]) == ["trigger", "candidate", "candidate"]
    assert kinds(decisions[1]) == ["candidate", "candidate", "end"]
    assert [event.t for d in decisions for event in d.events] == [0.0] * 3 + [0.01] * 3
    first, *candidates = decisions[0].events
    assert first.detail == {"reason": "tracking error 2 reached 1", "episode": 1}
    # the cost is |10 - theta|^2
    assert [c.detail for c in candidates] == [{"theta": [4.0], "cost": 36.0}, {"theta": [6.0], "cost": 16.0}]
    assert decisions[1].events[2].detail == {
        "episode": 1, "cost": 9.0, "theta": [7.0], "std": [0.5], "is_identifiable": [True], "reason": "best so far",
    }  # fmt: skip


def test_incumbents_are_written_only_when_they_are_better():
    decisions = steps(retuner(Scripted(4, 1, 9, 9.5, 2), Budget(5, 1)), [2.0] + [0.0] * 4)
    written = [None if d.theta is None else d.theta.tolist() for d in decisions]
    assert written == [[4.0], None, [9.0], [9.5], None]


def test_candidates_are_written_each_and_the_incumbent_at_the_end():
    loop = retuner(Scripted(4, 1, 9, 2), Budget(4, 1, "candidate"))
    decisions = steps(loop, [2.0, 0.0, 0.0, 0.0])
    assert [d.theta.tolist() for d in decisions[:3]] == [[4.0], [1.0], [9.0]]
    assert [d.is_candidate for d in decisions] == [True, True, True, False]
    assert decisions[3].theta is None  # the incumbent, 9, is in force already
    ending = steps(retuner(Scripted(9, 1, 2), Budget(3, 1, "candidate")), [2.0, 0.0, 0.0])[-1]
    assert ending.theta.tolist() == [9.0]
    assert not ending.is_candidate


def test_of_several_candidates_a_step_the_newest_is_written():
    decision = steps(retuner(Scripted(9, 4, 1, 1), Budget(4, 2, "candidate")), [2.0])[0]
    assert decision.theta.tolist() == [4.0]


def test_each_episode_begins_from_what_is_in_force():
    estimator = Scripted(4, 7, 8, 9)
    loop = retuner(estimator, Budget(2, 1))
    decisions = steps(loop, [2.0, 2.0, 0.0, 2.0, 2.0])
    assert estimator.restarts == [0.0, 7.0]
    assert (loop.n_episodes, loop.n_evaluations) == (2, 4)
    triggers = [e.detail["episode"] for d in decisions for e in d.events if e.kind == "trigger"]
    assert triggers == [1, 2]


def test_the_trigger_is_asked_only_between_episodes_and_told_what_is_in_force():
    seen = []

    def trigger(sample, tracking_error, theta):
        seen.append((sample.t, tracking_error, theta.tolist()))
        return "again" if len(seen) in (1, 2) else None

    steps(retuner(Scripted(4, 6, 7, 8), Budget(2, 1), trigger), [1.0, 2.0, 3.0, 4.0, 5.0])
    assert seen == [(0.0, 1.0, [0.0]), (0.02, 3.0, [6.0]), (0.04, 5.0, [8.0])]


def test_stored_candidates_are_judged_by_the_newest_samples_before_new_ones_are_asked_for():
    estimator = Rescored(4, 9, 3, 20)
    loop = retuner(estimator, Budget(4, 2))
    loop.step(0.0, sample(0.0, 10.0), 2.0)
    decision = loop.step(0.01, sample(0.01, 3.0), 0.0)  # the truth has become 3
    assert estimator.rescored == [[[3.0 - 4.0], [3.0 - 9.0]]]
    assert decision.theta.tolist() == [3.0]


def test_a_stale_best_is_given_up_when_the_truth_has_jumped():
    estimator = Rescored(10, 50, 60, 4)
    loop = retuner(estimator, Budget(4, 1))
    decisions = [loop.step(0.01 * k, sample(0.01 * k, truth), 2.0) for k, truth in enumerate([10.0, 10.0, 52.0])]
    assert decisions[-1].theta.tolist() == [50.0]


def test_an_estimator_that_cannot_rescore_is_left_with_what_it_was_told():
    loop = retuner(Scripted(10, 50, 4), Budget(3, 1))
    for k, truth in enumerate([10.0, 10.0, 52.0]):
        last = loop.step(0.01 * k, sample(0.01 * k, truth), 2.0)
    assert last.estimate.theta.tolist() == [10.0]


def test_the_tracking_trigger_fires_from_its_threshold_on():
    trigger = TrackingTrigger(0.01)
    assert trigger(sample(), math.nextafter(0.01, 0.0), START) is None
    assert trigger(sample(), 0.01, START) == "tracking error 0.01 reached 0.01"


def whitened(theta, sample):
    return np.array(sample.xdot) - theta[0]


@pytest.mark.parametrize("false_alarm", [0.3, 1e-2, 1e-6, 1e-12, 1e-20])
def test_the_innovation_limit_of_two_channels_is_that_of_the_exponential_distribution(false_alarm):
    trigger = InnovationTrigger(whitened, false_alarm)
    limit = -2.0 * math.log(false_alarm)  # |r|^2 of two unit normals: P(|r|^2 > c) = exp(-c/2)
    below, above = (math.sqrt(limit * factor) for factor in (1.0 - 1e-4, 1.0 + 1e-4))
    assert trigger(Sample(0.0, (), (), (below, 0.0)), 9.9, START) is None
    assert "exceeds" in trigger(Sample(0.0, (), (), (0.0, above)), 0.0, START)


@pytest.mark.parametrize("n_channels", [1, 2, 6])
@pytest.mark.parametrize("false_alarm", [0.1, 0.01])
def test_the_innovation_trigger_fires_by_chance_as_often_as_it_says(n_channels, false_alarm):
    trigger, n = InnovationTrigger(whitened, false_alarm), 10_000
    noise = np.random.default_rng(1).standard_normal((n, n_channels))
    fired = sum(trigger(Sample(0.0, (), (), tuple(r)), 0.0, START) is not None for r in noise)
    five_sigma = 5.0 * math.sqrt(n * false_alarm * (1.0 - false_alarm))  # binomial
    assert abs(fired - n * false_alarm) < five_sigma


def test_the_innovation_trigger_sees_a_jump_in_one_sample():
    trigger = InnovationTrigger(whitened, 1e-6)
    noise = np.random.default_rng(2).standard_normal((1000, 6))
    assert all(trigger(Sample(0.0, (), (), tuple(r)), 0.0, np.array([8.0])) for r in noise)
    assert not any(trigger(Sample(0.0, (), (), tuple(r + 8.0)), 0.0, np.array([8.0])) for r in noise)


class Hopeless(Scripted):
    """No candidate of its has succeeded before the third."""

    def estimate(self):
        if len(self.told) < 3:
            raise NoEstimateError("no candidate has succeeded yet")
        return super().estimate()


def test_before_a_candidate_has_succeeded_nothing_is_written():
    loop = retuner(Hopeless(4, 6, 9), Budget(3, 1))
    first, second, third = (loop.step(t, sample(t), 2.0) for t in (0.0, 0.1, 0.2))
    assert [d.theta for d in (first, second)] == [None, None]
    assert [e.kind for e in first.events] == ["trigger", "candidate"]
    assert third.theta == [9.0]


class Broken(Scripted):
    """Raises what is no part of the contract."""

    def __init__(self, error):
        super().__init__(4)
        self.error = error

    def estimate(self):
        raise self.error


@pytest.mark.parametrize("error", [RuntimeError("mine"), RecursionError("too deep")], ids=lambda e: type(e).__name__)
def test_other_errors_of_an_estimator_are_not_taken_for_a_missing_estimate(error):
    with pytest.raises(type(error), match=str(error)):
        retuner(Broken(error), Budget()).step(0.0, sample(), 2.0)


def test_an_episode_without_any_success_ends_without_a_cost():
    loop = retuner(Hopeless(4, 6), Budget(2, 2))
    decision = loop.step(0.0, sample(), 2.0)
    assert (decision.theta, decision.estimate) == (None, None)
    assert (decision.events[-1].kind, decision.events[-1].detail["cost"]) == ("end", None)


def test_model_calls_are_samples_at_which_a_candidate_was_judged():
    """What is in force and two candidates on one sample; both stored ones on the next, and a new one on both."""
    loop = retuner(Rescored(4, 6, 9), Budget(3, 2), window=5)
    loop.step(0.0, sample(), 2.0)
    assert loop.n_model_calls == 1 + 2
    loop.step(0.1, sample(0.1), 2.0)
    assert loop.n_model_calls == 3 + 2 + 2
    assert loop.n_evaluations == 3


@pytest.mark.parametrize("estimator", [Scripted, Rescored])
def test_a_step_takes_no_more_memory_and_time_the_more_candidates_there_were(estimator, monkeypatch):
    """The window keeps residuals of what is still asked for: all candidates of an episode, or what is in force."""
    kept = []
    loop = retuner(estimator(*range(100)), Budget(100, 1), window=3)
    keep = ResidualWindow.keep
    monkeypatch.setattr(ResidualWindow, "keep", lambda self, c: kept.append(len(c := list(c))) or keep(self, c))
    steps(loop, [2.0] * 100)
    assert kept == ([1] * 100 if estimator is Scripted else list(range(1, 100)))


def test_the_latencies_of_a_step_add_up_to_all_of_it(monkeypatch):
    """A clock that ticks once a reading: begun, begun of the search, two candidates, the end."""
    ticks = iter(range(100))
    for module in ("retuner", "search"):
        monkeypatch.setattr(f"estimator.retuning.{module}.perf_counter", lambda: float(next(ticks)))
    decision = retuner(Scripted(4, 6), Budget(2, 2)).step(0.0, sample(), 2.0)
    assert len(decision.latencies) == 2
    assert sum(decision.latencies) == 4.0


# -- windows that stay as they are for an episode -----------------------------------------------------------------


class SequenceObjective:
    """Residual 10 - theta at every sample; fails above 100. The log is what it was asked, a list a call."""

    is_ready, is_of_outputs = True, False

    def __init__(self):
        self.log = []

    def add_sample(self, sample): ...
    def revert(self, theta): ...

    def move_inputs(self, moved, stretch): ...

    def accept(self, theta, stretch): ...
    def snapshot(self, is_needed):
        return True

    def evaluate(self, thetas, stretch):
        self.log.append([float(theta[0]) for theta in thetas])
        return [self.one(theta, stretch) for theta in thetas]

    def one(self, theta, stretch):
        if theta[0] > 100.0:
            return Evaluation(np.array([np.nan]), "too large")
        return Evaluation(np.full(stretch.n_steps, 10.0 - theta[0]))

    def track(self, theta, stretch):
        return self.one(theta, stretch).residual


class Batches(Rescored):
    """Asks for as many as it may."""

    def ask_many(self, n):
        return [self.ask() for _ in range(min(n, len(self.script)))]


def episodic(estimator, budget, trigger=None, window=3):
    objective = SequenceObjective()
    loop = Loop(estimator, EpisodeWindow(objective, window), trigger or TrackingTrigger(1.0), budget)
    return loop, objective


def test_an_episode_waits_for_its_samples_and_then_all_candidates_see_the_same():
    estimator = Rescored(4, 9, 7)
    loop, objective = episodic(estimator, Budget(3, 1))
    decisions = steps(loop, [0.0] * 4 + [2.0] + [0.0] * 6)
    assert [kinds(d) for d in decisions[4:]] == [
        ["trigger"], [], [], ["candidate"], ["candidate"], ["candidate", "end"], [],
    ]  # fmt: skip
    assert decisions[4].events[0].detail["samples"] == "the next 3"
    assert objective.log == [[0.0], [4.0], [9.0], [7.0]]  # that in force, on the samples of before; then each once
    assert all(len(r) == 0 or np.all(np.isnan(r)) for r in estimator.rescored)
    assert loop.n_evaluations == 3


def test_candidates_of_earlier_episodes_are_forgotten():
    estimator = Rescored(4, 9, 8, 6)
    loop, _ = episodic(estimator, Budget(2, 2))
    steps(loop, [0.0] * 4 + [2.0] + [0.0] * 3)
    assert len(estimator.candidates) == 2
    loop.step(0.08, sample(0.08), 2.0)
    assert all(np.isnan(r) for rows in estimator.rescored[-1:] for row in rows for r in row)


def test_candidates_of_a_step_are_judged_together_where_the_estimator_can_ask_for_several():
    loop, objective = episodic(Batches(4, 9, 7, 8, 6), Budget(5, 3))
    steps(loop, [0.0] * 4 + [2.0] + [0.0] * 6)
    assert objective.log[1:] == [[4.0, 9.0, 7.0], [8.0, 6.0]]
    one_by_one, objective = episodic(Rescored(4, 9, 7, 8, 6), Budget(5, 3))
    steps(one_by_one, [0.0] * 4 + [2.0] + [0.0] * 6)
    assert objective.log[1:] == [[4.0], [9.0], [7.0], [8.0], [6.0]]


def test_a_candidate_that_failed_is_in_the_record_with_its_reason():
    loop, _ = episodic(Scripted(4, 200, 7), Budget(3, 3))
    (decision,) = [d for d in steps(loop, [0.0] * 4 + [2.0] + [0.0] * 6) if d.latencies]
    candidates = [e.detail for e in decision.events if e.kind == "candidate"]
    assert [c.get("failed") for c in candidates] == [None, "too large", None]
    assert decision.theta is not None
    assert loop.n_evaluations == 3


class Solves:
    """Evaluates 1, 2, 3, ... as long as it is let."""

    is_whitened = True

    def __init__(self):
        self.costs = {}

    def restart(self, start): ...
    def solve(self, objective):
        for k in range(1, 1000):
            r = objective.residual(np.array([0.01 * k]))
            if not np.all(np.isfinite(r)):
                break
            self.costs[0.01 * k] = float(r @ r)

    def estimate(self):
        best = min(self.costs, key=self.costs.get)
        return Estimate(np.array([best]), np.array([0.5]), (True,), self.costs[best], len(self.costs), "solved")


def test_a_solver_spends_the_budget_of_an_episode_in_one_solve():
    loop, objective = episodic(Solves(), Budget(7, 2))
    decisions = steps(loop, [0.0] * 4 + [2.0] + [0.0] * 6)
    assert loop.n_evaluations == 7
    assert len(objective.log) == 8
    assert [kinds(d) for d in decisions if d.latencies] == [["candidate", "end"]]


def test_the_innovation_of_a_window_is_judged_by_its_chi_square_limit():
    """0.9999 quantiles of chi-square: 15.14 for one degree, 18.42 for two (Abramowitz and Stegun, table 26.8)."""
    for n, limit in ((1, 15.137), (2, 18.421)):
        for squared, fires in ((limit - 0.01, False), (limit + 0.01, True)):
            trigger = InnovationTrigger(lambda theta, _, r=np.full(n, np.sqrt(squared / n)): r, 1e-4)
            assert (trigger(sample(), 0.0, START) is not None) == fires
    assert InnovationTrigger(lambda theta, _: np.empty(0), 1e-4)(sample(), 0.0, START) is None
