"""Whether 95 % intervals cover the truth on the named scenarios."""

import pytest

from benchmarks.coverage import FROZEN, count, frozen, share, summary
from benchmarks.report import table
from cosim.blas_threads import one_thread
from cosim.scenarios.scenario import Scenario

pytestmark = [pytest.mark.slow, pytest.mark.fmu]


@pytest.mark.parametrize("scenario", FROZEN)
def test_intervals_of_target_cover_as_often_as_they_say(scenario):
    """One episode on a frozen window: 90 to 98 % of 120 to 600 intervals, whose own deviation is some 1 to 2 %."""
    tally, space = {}, Scenario.load(scenario).estimation.space
    labels = {"scenario": scenario, "how": "frozen", "estimator": "target"}
    with one_thread():
        for seed in range(60):
            for interval in frozen(scenario, "target", seed):
                count(tally, space, labels, interval)
    rows = list(tally.values())
    print("\n" + table(summary(rows)))
    margin = 0.02  # two deviations of 120 intervals, of which those of one estimate err together
    assert 0.90 - margin <= share(rows) <= 0.98 + margin
