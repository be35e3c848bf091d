"""The lines of the report on what a diagnosis has found."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cosim.runs.diagnosis_report import diagnosed, diagnosis_report, resting
from cosim.runs.recorded_events import read_events
from cosim.runs.report import report
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario

QUIET = {"noise_ratio": 1.0, "scale": 1.0, "correlation": 0.0, "disturbance": 0.0, "is_resting": False}


def found(**channel):
    return {"channels": {"plant.der(v)": QUIET | channel}, "disturbance": 0, "disturbances": [], "unexplained": 0}


def test_of_a_model_that_explains_the_samples_there_is_nothing_to_say():
    assert diagnosed(found()) == resting(found()) == []


def test_white_residuals_that_are_larger_are_noise_and_correlated_ones_are_not():
    (noise,) = diagnosed(found(scale=4.1))
    assert (
        noise
        == "the model explains plant.der(v) to 4.1 times its declared noise: if that is noise, multiply it by as much"
    )
    (lacking,) = diagnosed(found(scale=4.1, correlation=0.9))
    assert lacking.startswith(
        "the model explains plant.der(v) to 4.1 times its declared noise, and the rest is smooth: the model lacks"
    )


def test_a_rest_at_the_end_is_told_whatever_has_led_to_it():
    (line,) = resting(found(is_resting=True))
    assert line == "re-tuning rests at the end: plant.der(v) left out"


def test_what_was_written_for_a_disturbance_is_undone():
    named = {"disturbance": 1, "disturbances": [{"t": 2.0, "size": {"plant.der(v)": 0.3}}]}
    (line,) = diagnosed(found() | named)
    assert line.startswith("1 disturbance named, the last at t = 2 s (plant.der(v) 0.3): what was written for them")


def test_a_run_that_faulted_before_its_first_row_is_reported(tmp_path):
    one = run(Scenario.load("pendulum", SHORT | {"scenario.stop_time": "0.01"}), "none", out=tmp_path)
    nothing = {name: values[:0] for name, values in one.series.items()}
    channels = {"plant.der(phi_dot)": found()["channels"]["plant.der(v)"]}
    empty = replace(
        one, series=nothing, status="faulted", error="plant: a fault", guard={"written": 0},
        diagnosis=found() | {"channels": channels},
    )  # fmt: skip
    assert diagnosis_report(empty, ()) == []


@pytest.mark.parametrize("n", [0, 3, 4])
def test_estimates_that_a_disturbance_explains_in_every_write_are_doubted(tmp_path, n):
    counts = {"written": 4, "undecided": n, "limited": 0, "held": 0, "vetoed": 0, "reverted": 0, "stopped_at": None}
    one = run(Scenario.load("pendulum", SHORT | {"scenario.stop_time": "0.01"}), "none", out=tmp_path)
    lines = [line for line in report(replace(one, guard=counts), {}).splitlines() if "±" in line]
    assert lines == ["if such a disturbance acted, the estimates and their ± are wrong: no write speaks against it"] * (
        n == 4
    )


SHORT = {
    "scenario.stop_time": "1.0",
    "scenario.isolation": "none",
    "changes": '{"plant.m" = [[0.0, 1.75], [0.5, 3.0]]}',
}


def noted(run):
    lines = diagnosis_report(run, read_events(run.folder) if run.folder else [])
    return [line for line in lines if line.startswith(("nothing", "the declared", "re-tuning rested"))]


@pytest.mark.full
@pytest.mark.fmu
def test_a_noise_that_hides_its_signal_is_why_nothing_was_re_tuned():
    hidden = {"sampling.derivatives": '{"plant.der(phi_dot)" = {noise = 1e4}}'}
    result = run(Scenario.load("pendulum", SHORT | hidden), "target")
    first, second = noted(result)
    assert first.startswith("nothing was re-tuned: the samples never contradicted the parameters in force")
    size = np.std(result["plant.der(phi_dot)"])
    assert second == f"the declared noise of plant.der(phi_dot), 10000, hides it: its standard deviation is {size:.3g}"
    assert noted(run(Scenario.load("pendulum", SHORT), "target")) == []


@pytest.mark.full
@pytest.mark.fmu
def test_a_threshold_that_is_never_reached_is_why_nothing_was_re_tuned():
    high = {"estimation.trigger": '{kind = "tracking", threshold = 3.0}'}
    (line,) = noted(run(Scenario.load("pendulum", SHORT | high), "target"))
    assert line == "nothing was re-tuned: the tracking error never passed the trigger's threshold, 3"


@pytest.mark.fmu
def test_a_rest_is_told_with_its_end_and_with_what_changed_in_it(tmp_path):
    result = run(Scenario.load("pendulum", SHORT), "target", out=tmp_path / "run")
    lines = {
        (0.3, 40): "re-tuning rested from t = 0.3 s until t = 0.7 s, for 40 samples (diagnosis.rest); what changes "
        "meanwhile is not seen: m at t = 0.5 s",
        (0.6, 20): "re-tuning rested from t = 0.6 s until t = 0.8 s, for 20 samples (diagnosis.rest)",
        (0.6, 1000): "re-tuning rested from t = 0.6 s to the end, for 1000 samples (diagnosis.rest)",
        (0.3, 0): None,
    }
    for (t, n), line in lines.items():
        event = {"t": t, "kind": "rest", "channels": ["plant.der(phi_dot)"], "n_samples": n, "reason": "in vain"}
        (tmp_path / "run" / "events.jsonl").write_text(json.dumps(event) + "\n")
        assert noted(result) == ([line] if line else [])
    events = [event | {"t": 0.3, "n_samples": 40}, event | {"t": 0.55, "n_samples": 0, "reason": "it was over"}]
    (tmp_path / "run" / "events.jsonl").write_text("".join(json.dumps(e) + "\n" for e in events))
    until = "until t = 0.55 s, when it was over"
    assert noted(result) == [f"re-tuning rested from t = 0.3 s {until}"]
    friction = {"t": 0.55, "kind": "friction", "terms": [], "reason": "it explains the samples"}
    (tmp_path / "run" / "events.jsonl").write_text("".join(json.dumps(e) + "\n" for e in (events[0], friction)))
    assert noted(result) == ["re-tuning rested from t = 0.3 s until t = 0.55 s, when friction was named"]
    events = [event | {"t": t, "n_samples": 20} for t in (0.3, 0.4, 0.45, 0.8)]
    (tmp_path / "run" / "events.jsonl").write_text("".join(json.dumps(e) + "\n" for e in events))
    assert noted(result) == [
        "re-tuning rested from t = 0.3 s until t = 0.65 s, again and again (diagnosis.rest); what changes meanwhile is "
        "not seen: m at t = 0.5 s",
        "re-tuning rested from t = 0.8 s until t = 1 s, for 20 samples (diagnosis.rest)",
    ]


def test_of_the_plant_s_own_fmu_it_is_not_said_that_the_model_lacks_something():
    (line,) = diagnosed(found() | {"unexplained": 2}, "something acts on the plant that its inputs do not hold")
    assert line.startswith("failed searches: 2, no parameters explain the samples; something acts on the plant")
