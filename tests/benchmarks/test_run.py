"""Where a run's time goes: what is counted to which part. No time is asserted."""

import pytest

from benchmarks import run


def test_a_part_has_its_own_time_without_that_of_the_parts_it_calls(monkeypatch):
    ticks = iter([0.0, 1.0, 3.0, 3.5, 4.0, 10.0])  # outer begins, inner begins and ends, twice, outer ends
    monkeypatch.setattr(run, "perf_counter", lambda: next(ticks))
    clock = run.Clock()
    inner = clock.timed(lambda: None, "inner")
    clock.timed(lambda: (inner(), inner()), "outer")()
    assert clock.seconds == {"inner": 2.5, "outer": 7.5}


@pytest.mark.full
@pytest.mark.fmu
def test_every_part_of_a_run_is_found_and_the_product_is_left_as_it_was():
    methods = [(owner, name, owner.__dict__[name]) for _, owner, names in run.PARTS for name in names]
    scenario = run.Scenario.load("pendulum", {"scenario.stop_time": "3.2", "estimation.instants": "[]"})
    parts = run.measured(scenario, "target", 0)
    assert all(owner.__dict__[name] is method for owner, name, method in methods)
    always = [
        "whole run",
        "FMUs",
        "sampling",
        "trigger",
        "window",
        "ask",
        "tell",
        "estimate",
        "model calls",
        "recording",
    ]
    assert all(parts[part] > 0.0 for part in always)
