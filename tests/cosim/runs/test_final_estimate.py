"""The estimate that a run ends with."""

import numpy as np

from cosim.retuning.decision import Decision
from cosim.runs.final_estimate import EstimateTracker
from cosim.scenarios.scenario import Scenario
from estimator import Estimate
from estimator.events import Event


def decided(m, *kinds):
    estimate = Estimate(np.array([m, 0.75]), np.array([0.01, 0.01]), (True, True), 1.0, 30, "given")
    return Decision(estimate=estimate, events=tuple(Event(1.0, kind, {}) for kind in kinds))


def ends_with(*decisions):
    tracker = EstimateTracker(Scenario.load("pendulum"), "target")
    for k, decision in enumerate(decisions):
        tracker.take(0.1 * k, decision)
    return tracker.final().values[0]


def test_an_unfinished_episode_counts_only_where_none_was_completed():
    assert ends_with(decided(1.0, "trigger", "candidate"), decided(2.0, "candidate")) == 2.0
    assert ends_with(decided(1.0, "candidate", "end"), decided(2.0, "trigger", "candidate")) == 1.0


def test_samples_after_a_search_count():
    assert ends_with(decided(1.0, "candidate", "end"), decided(2.0), decided(3.0, "write")) == 3.0
    assert ends_with(decided(1.0, "candidate", "end"), decided(2.0), decided(3.0, "trigger", "candidate")) == 2.0


def test_an_estimate_that_was_taken_back_says_so_and_nothing_about_bounds():
    tracker = EstimateTracker(Scenario.load("pendulum"), "target")
    tracker.take(0.1, decided(5.0, "candidate", "end"))
    tracker.take(0.2, Decision(events=(Event(0.2, "undo", {}),)))
    (finding,) = tracker.final().findings
    assert "taken back" in finding
    tracker.take(0.3, decided(2.0, "candidate", "end"))
    assert tracker.final().findings == ()
