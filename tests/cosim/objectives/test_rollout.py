"""Roll-outs against a solver that is not ours, in all three ways of beginning; and when they cannot be made."""

import dataclasses
import json
import math
import zipfile
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from pythonfmu import FmuBuilder
from scipy.integrate import solve_ivp

from cosim import Scenario, ScenarioError, run
from cosim.authoring.check import check
from cosim.campaigns.replay import replayed
from cosim.cli import main
from cosim.errors import CosimError
from cosim.estimator_fmu.settings import estimator_settings
from cosim.fmi.archive import FmuFile, read_description
from cosim.objectives.choice import chosen, open_objective
from cosim.objectives.rollout import RolloutObjective
from cosim.objectives.rollout_fmu import RunningPlant, shadow_of
from cosim.objectives.rollout_start import NoisyStartObjective
from cosim.runs.diagnosis_report import diagnosis_report
from cosim.runs.result import read_run
from cosim.slaves.slave import open_slave
from cosim.system.fmu_cache import find_fmu
from cosim.system.plant import plant_of
from estimator import EpisodeWindow, Sample, SampleSequence
from estimator.diagnosis.disturbed_inputs import disturbed_inputs

pytestmark = pytest.mark.fmu
slow = pytest.mark.slow

H, SIGMA = 0.01, (1e-3, 2e-3)
OUTPUTS = {"sampling.outputs": '{"plant.phi" = {noise = 1e-3}, "plant.phi_dot" = {noise = 2e-3}}'}
ROLLOUT = OUTPUTS | {
    "estimation.objective": "rollout",
    "estimation.rollout.jobs": "1",
    "scenario.isolation": "none",  # processes take their time to start; the shadows have their own in any case
}
SHORT = ROLLOUT | {"estimation.window": "10", "estimation.budget": "15"}
EARLY = {
    'changes."plant.m"': "[[0.0, 1.75], [0.3, 3.0]]",
    'changes."plant.l"': "[[0.0, 0.75], [0.3, 0.9]]",
}
TRUTH, OTHER = np.array([1.75, 0.75]), np.array([3.0, 0.9])


def swing(m, l, times, inputs, x0):
    """phi and phi_dot (n, 2) after each step of m l phi'' = u - m g sin(phi) - b l phi', by DOP853; b and g by hand."""
    states = [np.asarray(x0, dtype=float)]
    for a, b, u in zip(times, times[1:], inputs, strict=False):

        def derivative(t, x, u=u):
            return (x[1], (u - m * 9.81 * math.sin(x[0]) - 0.1 * l * x[1]) / (m * l))

        states.append(solve_ivp(derivative, (a, b), states[-1], "DOP853", rtol=1e-12, atol=1e-13).y[:, -1])
    return np.array(states[1:])


def push(k):
    return 8.0 * math.sin(0.4 * k) + 3.0


@pytest.fixture
def live_objective(leaves_nothing):
    """made(way, jobs): an objective, its plant, and a function that steps both n times; nothing of them is left.

    force: on the plant, as the scenario changes it, unknown to the objective; None where it is an input as others.
    """
    with ExitStack() as stack:

        def made(way, jobs=1, force=None, **settings):
            disturbed = {} if force is None else {'changes."plant.F_d"': str(force)}
            scenario = Scenario.load("pendulum", ROLLOUT | settings | disturbed)
            fmu = find_fmu("Pendulum", Path())
            slave = stack.enter_context(open_slave(fmu, "plant"))
            outputs = ("phi", "phi_dot", "der(phi_dot)", "u_held")
            slave.bind(["u", "F_d"], ["m", "l"], outputs)
            slave.initialize({"phi": 0.5, "phi_dot": 0.1})
            forces = {} if force is None else {"F_d": lambda t: force}
            live = RunningPlant(slave, outputs, {"m": lambda t: TRUTH[0], "l": lambda t: TRUTH[1]}, forces)
            plant = plant_of(scenario, slave)
            shadow = dataclasses.replace(shadow_of(scenario, plant, True), start={"phi": 0.5, "phi_dot": 0.1})
            objective = stack.enter_context(RolloutObjective(shadow, TRUTH, way, live, jobs))
            rng = np.random.default_rng(1)

            def step(n, is_heard=True):
                samples = []
                for k in range(step.k, step.k + n):
                    x = slave.step([push(k), force or 0.0], H * k, H, TRUTH)[:2]
                    y = tuple(v + s * e for v, s, e in zip(x, SIGMA, rng.standard_normal(2), strict=True))
                    samples.append(Sample(H * (k + 1), x, (push(k), 0.0)[: len(plant.inputs)], (), y))
                    if is_heard:
                        objective.add_sample(samples[-1])
                        step.origins.append(objective.snapshot(True))
                step.k += n
                return samples

            step.k, step.origins = 0, []
            return objective, step

        yield made


@pytest.mark.full_but("measured")
@pytest.mark.parametrize("way", ["state", "measured", "replay", None])
def test_a_residual_is_the_simulated_minus_the_measured_outputs(live_objective, way):
    """The FMU's own steps of 10 ms by the classical Runge-Kutta rule are good to 1e-7 rad here; the noise is 1e-3."""
    objective, step = live_objective(way)
    samples = step(40)
    stretch = SampleSequence(tuple(samples[20:]), step.origins[20])
    for theta in (TRUTH, OTHER):
        (found,) = objective.evaluate([theta], stretch)
        times, inputs = [s.t for s in stretch.samples], [s.u[0] for s in stretch.samples[1:]]
        simulated = swing(*theta, times, inputs, stretch.samples[0].x)
        expected = (simulated - [s.y for s in stretch.samples[1:]]) / SIGMA
        np.testing.assert_allclose(found.residual, expected.T.reshape(-1), atol=1e-3)
        np.testing.assert_allclose(found.squares, np.sum(expected**2, axis=1), rtol=1e-4, atol=1e-2)
    assert objective.way == (way or "state")


@pytest.mark.full_but("state")
@pytest.mark.parametrize("way", ["state", "measured"])
def test_a_force_that_acts_on_the_plant_is_in_no_simulation_that_begins_in_its_state(live_objective, way):
    """Not even in one from the state that was saved while it acted, which it is in; nor as it is followed."""
    objective, step = live_objective(way, force=6.0)
    samples = step(40)
    stretch = SampleSequence(tuple(samples[20:]), step.origins[20])
    times, inputs = [s.t for s in stretch.samples], [s.u[0] for s in stretch.samples[1:]]
    simulated = swing(*TRUTH, times, inputs, stretch.samples[0].x)
    expected = ((simulated - [s.y for s in stretch.samples[1:]]) / SIGMA).T.reshape(-1)
    (found,) = objective.evaluate([TRUTH], stretch)
    np.testing.assert_allclose(found.residual, expected, atol=1e-3)
    np.testing.assert_allclose(objective.track(TRUTH, stretch), expected, atol=1e-3)
    assert np.abs(expected).max() > 50.0


@pytest.mark.full
def test_all_ways_of_beginning_lead_to_the_same_residuals(live_objective):
    found = {}
    for way in ("state", "measured", "replay"):
        objective, step = live_objective(way, jobs=2)
        samples = step(30)
        stretch = SampleSequence(tuple(samples[12:]), step.origins[12])
        found[way] = [j.residual for j in objective.evaluate([TRUTH, OTHER, np.array([0.5, 2.0])], stretch)]
    for way in ("measured", "replay"):
        np.testing.assert_allclose(found[way], found["state"], rtol=1e-9, atol=1e-9)


def test_a_replay_takes_the_parameters_that_were_believed_then(live_objective):
    """From sample 10 on the shadow has other parameters than before it: the same as by DOP853 with a change there."""
    objective, step = live_objective("replay")
    samples = step(30)
    objective.accept(OTHER, SampleSequence(tuple(samples[9:15]), step.origins[9]))
    (found,) = objective.evaluate([TRUTH], SampleSequence(tuple(samples[19:]), step.origins[19]))
    times, inputs = [0.0, *(s.t for s in samples)], [s.u[0] for s in samples]
    x = swing(*TRUTH, times[:11], inputs[:10], (0.5, 0.1))[-1]
    x = swing(*OTHER, times[10:21], inputs[10:20], x)[-1]
    simulated = swing(*TRUTH, times[20:], inputs[20:], x)
    expected = (simulated - [s.y for s in samples[20:]]) / SIGMA
    np.testing.assert_allclose(found.residual, expected.T.reshape(-1), atol=2e-3)


def test_a_replay_forgets_what_was_accepted_and_is_reverted(live_objective):
    objective, step = live_objective("replay")
    samples = step(30)
    stretch = SampleSequence(tuple(samples[19:]), step.origins[19])
    (expected,) = objective.evaluate([TRUTH], stretch)
    for place, theta in ((9, OTHER), (14, 1.1 * OTHER)):
        objective.accept(theta, SampleSequence(tuple(samples[place : place + 5]), step.origins[place]))
    objective.revert(TRUTH)  # its start
    np.testing.assert_allclose(objective.evaluate([TRUTH], stretch)[0].residual, expected.residual, atol=1e-9)


def test_a_replay_takes_the_inputs_that_were_others_than_was_sampled(live_objective):
    """A push of 2 N from sample 10 on, known after sample 30: the same as by DOP853."""
    objective, step = live_objective("replay")
    samples = step(30)
    moved = [dataclasses.replace(s, u=(s.u[0] + 2.0, 0.0)) for s in samples[10:]]
    objective.move_inputs(np.array([2.0, 0.0]), SampleSequence((samples[9], *moved), step.origins[9]))
    (found,) = objective.evaluate([TRUTH], SampleSequence((samples[19], *moved[10:]), step.origins[19]))
    times, inputs = [0.0, *(s.t for s in samples)], [s.u[0] for s in (*samples[:10], *moved)]
    simulated = swing(*TRUTH, times, inputs, (0.5, 0.1))[20:]
    expected = (simulated - [s.y for s in samples[20:]]) / SIGMA
    np.testing.assert_allclose(found.residual, expected.T.reshape(-1), atol=2e-3)


@pytest.mark.full_but("measured")
@pytest.mark.parametrize("way", ["state", "measured", "replay"])
def test_following_gives_what_a_whole_roll_out_gives_a_step_at_a_time(live_objective, monkeypatch, way):
    objective, step = live_objective(way)
    window, track, stretches = EpisodeWindow(objective, 6), objective.track, []
    monkeypatch.setattr(objective, "track", lambda theta, s: stretches.append(s) or track(theta, s))
    for _ in range(28):
        window.append(*step(1, is_heard=False))
        followed = window.track(TRUTH).measured
        if stretches and objective.is_ready:
            (whole,) = objective.evaluate([TRUTH], stretches[-1])
            np.testing.assert_allclose(followed, whole.residual if len(followed) else [], rtol=1e-9, atol=1e-9)
    assert len(followed)


@pytest.mark.parametrize("way", ["auto", "measured"])
@pytest.mark.parametrize("states", ["{}", '{"plant.phi" = {}, "plant.phi_dot" = {}}'], ids=["unnamed", "named"])
def test_residuals_are_whitened_where_roll_outs_may_begin_in_states_that_are_noisy_outputs(way, states):
    """Also where a saved state is tried first: what is found not to work falls back to measured ones."""
    scenario = Scenario.load("pendulum", ROLLOUT | {"estimation.rollout.start": way, "sampling.states": states})
    with ExitStack() as stack:
        slave = stack.enter_context(open_slave(find_fmu("Pendulum", Path()), "plant"))
        live = RunningPlant(slave, ("phi", "phi_dot"), {})
        objective = open_objective(scenario, plant_of(scenario, slave), TRUTH, live, stack)
        assert isinstance(objective, NoisyStartObjective)
        assert objective._noise.tolist() == [1e-3, 2e-3]


def test_an_input_that_is_not_connected_has_the_start_value_that_the_scenario_gives_it():
    scenario = Scenario.load("pendulum", {"components.plant.start.F_d": "1.5"})
    with open_slave(find_fmu("Pendulum", Path()), "plant") as slave:
        assert dict(plant_of(scenario, slave).inputs) == {"u": 0.0, "F_d": 1.5}


# -- in the loop --------------------------------------------------------------------------------------------------


def end(result):
    return np.array([result.estimates[name][-1] for name in ("m", "l")])


@pytest.mark.full_but("measured")
@pytest.mark.parametrize("way", ["state", "measured", "replay"])
def test_a_changed_pendulum_is_found_from_its_outputs_alone(pendulum, leaves_nothing, way):
    settings = EARLY | ROLLOUT | {"estimation.rollout.start": way}
    result = run(pendulum(settings, 1.5), "target")
    assert result.status == "done", result.error
    assert result.n_episodes
    np.testing.assert_allclose(end(result), OTHER, rtol=0.1)
    nominal = run(pendulum(settings, 1.5), "none")
    assert result.mse[0] < 0.2 * nominal.mse[0]
    assert result.objective.startswith("roll-outs of Pendulum.fmu")
    assert "as asked" in result.objective


@pytest.mark.parametrize("way", ["state", "measured"])
def test_a_changed_pendulum_is_found_though_two_in_a_hundred_outputs_are_isolated(pendulum, way):
    faults = ", ".join(
        f'{{ kind = "spikes", sensor = "plant.{name}", size = 1.0, probability = 0.02 }}' for name in ("phi", "phi_dot")
    )
    settings = EARLY | ROLLOUT | {"estimation.rollout.start": way, "sampling.faults": f"[{faults}]"}
    result = run(pendulum(settings, 1.5), "target")
    np.testing.assert_allclose(end(result), OTHER, rtol=0.1)
    assert result.observations["found"]["outlier plant.phi"] >= 2


@pytest.mark.full
@pytest.mark.parametrize("trigger", [pytest.param("tracking", marks=slow), "innovation"])
def test_the_same_bits_come_of_any_number_of_processes_and_of_the_same_seed(
    pendulum, tmp_path, leaves_nothing, trigger
):
    seen = []
    kind = '{ kind = "innovation" }' if trigger == "innovation" else '{ kind = "tracking", threshold = 0.01 }'
    common = EARLY | SHORT | {"estimation.trigger": kind, "estimation.evaluations_per_step": "3"}
    for k, jobs in enumerate((1, 3, 3)):
        folder = tmp_path / f"run{k}"
        folder.mkdir()
        result = run(pendulum(common | {"estimation.rollout.jobs": str(jobs)}, 0.8), "target", 3, folder)
        assert result.n_episodes
        seen.append(((folder / "series.arrow").read_bytes(), (folder / "events.jsonl").read_bytes()))
    assert all(one == seen[0] for one in seen)


def test_innovations_of_outputs_begin_an_episode_where_the_jump_was(pendulum, tmp_path):
    settings = EARLY | SHORT | {"estimation.trigger": '{ kind = "innovation" }'}
    run(pendulum(settings, 0.8), "target", 0, tmp_path)
    events = [json.loads(line) for line in (tmp_path / "events.jsonl").read_text().splitlines()]
    first = next(e for e in events if e["kind"] == "trigger")
    assert 0.3 < first["t"] <= 0.33
    n_past = round((first["t"] - 0.3) / H)
    assert first["samples"] == f"the last {n_past}, which they do not explain, and the next {10 - n_past}"


@pytest.mark.full
def test_a_jump_in_mid_window_is_made_good_by_the_next_episode(pendulum, tmp_path):
    """The second jump, 50 ms after the first, is inside the window of thirty samples."""
    twice = {
        'changes."plant.m"': "[[0.0, 1.75], [0.3, 3.0], [0.35, 2.3]]",
        'changes."plant.l"': "[[0.0, 0.75], [0.3, 0.9], [0.35, 0.8]]",
    }
    settings = twice | ROLLOUT | {"estimation.trigger": '{ kind = "innovation" }'}
    result = run(pendulum(settings, 2.0), "target", 0, tmp_path)
    assert result.n_episodes >= 2
    np.testing.assert_allclose(end(result), [2.3, 0.8], rtol=0.1)


@pytest.mark.full
@pytest.mark.parametrize(
    "name",
    [
        "paper",
        "least-squares",
        *(pytest.param(n, marks=slow) for n in ("bo-scalar", "multi-start", "sqp", "ipm-scipy")),
    ],
)
def test_every_estimator_of_episodes_takes_roll_outs_within_its_budget(pendulum, leaves_nothing, name):
    settings = EARLY | SHORT | {f"estimation.{name}.budget": "12", f"estimation.{name}.window": "10"}
    result = run(pendulum(settings, 0.7), name)
    assert result.status == "done", result.error
    assert 0 < result.n_evaluations <= 12 * result.n_episodes
    assert result.summary()["model_calls"] >= result.n_evaluations


@pytest.mark.full
def test_a_recorded_run_is_replayed_from_its_measured_states(pendulum, tmp_path):
    """There is no plant to take a state of; the measured states, with the noise of the outputs, are on record.

    Without the diagnosis: what it finds possible only, a run predicts, and a replay, which cannot, leaves out.
    """
    settings = EARLY | SHORT | {"estimation.rollout.start": "measured", "diagnosis.enabled": "false"}
    original = run(pendulum(settings, 0.8), "target", 2, tmp_path)
    again = replayed(read_run(tmp_path), "target", 2)
    assert original.n_episodes
    for name, values in original.estimates.items():
        # the guard, which a replay has not, leaves out what rounding alone would write
        np.testing.assert_allclose(again.estimates[name], values, rtol=1e-15)


def test_a_disturbance_is_looked_for_in_the_connected_inputs_alone(pendulum, monkeypatch):
    """F_d, which is not connected, does the same as u but for rounding: shared among both, it would be any size."""
    found = []

    def searched(*arguments):
        found.append(disturbed_inputs(*arguments))
        return found[-1]

    monkeypatch.setattr("estimator.diagnosis.episode_diagnosis.disturbed_inputs", searched)
    heavier = {"changes": '{ "plant.m" = [[0.0, 1.75], [0.3, 3.0]] }', "estimation.trigger": '{ kind = "innovation" }'}
    result = run(pendulum(SHORT | heavier, 0.7), "target")
    assert result.status == "done", result.error
    assert found
    for disturbed in found:
        assert disturbed.fit.n_free == 1
        assert 0.0 < abs(disturbed.inputs[0]) < 20.0  # N; the ball weighs 30
        assert disturbed.inputs[1] == 0.0


@pytest.mark.full_but("auto")
@pytest.mark.parametrize("way", ["auto", "measured"])
def test_a_disturbance_does_not_keep_roll_outs_from_being_made_and_they_do_not_have_it(pendulum, way):
    """A changing force on the plant; the step that proves the saved state is repeated with the force of its time."""
    wired = '{ "controller.phi" = "plant.phi", "controller.phi_dot" = "plant.phi_dot" }'
    pushed = {"connections": wired, "changes": "{}", 'changes."plant.u"': "2 + 3*sin(20*t)"}
    scenario = pendulum(SHORT | pushed | {"estimation.rollout.start": way}, 0.3)
    result = run(scenario, "target")
    assert result.status == "done", result.error
    assert ("the plant's saved state (a repeated" if way == "auto" else "measured states") in result.objective
    assert [name for name in result.series if name.startswith("held.")] == ["held.plant.F_d"]  # the force is in none
    assert set(result["plant.u"]) == {2 + 3 * math.sin(20 * t) for t in result.time}


# -- FMUs that cannot ---------------------------------------------------------------------------------------------

SPOILT = """
import time
from pythonfmu import *


class Spoilt(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.gain, self.u, self.y, self.hidden = 1.0, 0.0, 0.0, 0.0
        self.register_variable(Real("gain", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        self.register_variable(Real("u", causality=Fmi2Causality.input))
        self.register_variable(Real("y", causality=Fmi2Causality.output, initial=Fmi2Initial.exact))
        self.register_variable(Real("der(y)", causality=Fmi2Causality.output, getter=lambda: self.gain * self.u))

    def do_step(self, t, h):
        self.hidden += h
        self.y += h * (self.gain * self.u + {hidden})
        {fault}
        return True
"""


def spoilt(folder, hidden="0.0", fault="pass", declared=()):
    """A plant y' = gain u, as an FMU with some fault; declared: pairs of text replaced in its description."""
    script = folder / "spoilt.py"
    script.write_text(SPOILT.format(hidden=hidden, fault=fault))
    path = FmuBuilder.build_FMU(script, dest=folder)
    with zipfile.ZipFile(path) as fmu:
        files = {name: fmu.read(name) for name in fmu.namelist()}
    text = files["modelDescription.xml"].decode()
    for old, new in declared:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    with zipfile.ZipFile(path, "w") as fmu:
        for name, content in (files | {"modelDescription.xml": text.encode()}).items():
            fmu.writestr(name, content)
    return path


SCENARIO = """
[scenario]
name = "spoilt"
stop_time = 0.6
macro_step = 0.01
timeout = 1.0
[components]
plant = {{ fmu = "{fmu}" }}
controller = {{ fmu = "{own}" }}
reference = {{ table = "ref.csv" }}
[connections]
"plant.u" = "reference.u"
[changes]
"plant.gain" = [[0.0, 1.0], [0.2, 2.0]]
[tracking]
"plant.y" = "reference.y"
[sampling.outputs]
"plant.y" = {{ noise = 1e-4 }}
[estimation]
trigger = {{ kind = "tracking", threshold = 0.01 }}
budget = 12
evaluations_per_step = 2
[[estimation.parameters]]
name = "gain"
lower = 0.2
upper = 9.0
writes = "controller.gain"
[estimation.rollout]
start = "{start}"
"""


def toml(folder, fmu, start="auto"):
    own = folder / "own"
    own.mkdir(exist_ok=True)
    rows = [f"{0.01 * k:.2f}, {1 + 0.5 * math.sin(0.3 * k):.6f}, 0.0" for k in range(62)]
    (folder / "ref.csv").write_text("time [s], u, y\n" + "\n".join(rows))
    path = folder / "spoilt.toml"
    path.write_text(SCENARIO.format(fmu=fmu, own=spoilt(own), start=start))
    return path


FAULTS = {
    "raises": "if self.gain > 2.5: raise ValueError('too much gain')",
    "hangs": "if 2.5 < self.gain < 4.0: time.sleep(60)",
    "exits": "import os; self.gain > 2.5 and os._exit(3)",
    "is not finite": "if self.gain > 2.5: self.y = float('nan')",
}


@pytest.mark.full
@pytest.mark.parametrize(
    "fault",
    [pytest.param(f, id=n, marks=slow if n in ("exits", "is not finite") else ()) for n, f in FAULTS.items()],
)
def test_a_roll_out_that_fails_is_a_bad_candidate_with_a_reason_and_the_run_goes_on(tmp_path, leaves_nothing, fault):
    # Its controller does not control: the error grows whatever is written, which the guard would take back.
    scenario = Scenario.load(toml(tmp_path, spoilt(tmp_path, fault=fault), "replay"), UNGUARDED)
    folder = tmp_path / "out"
    folder.mkdir()
    result = run(scenario, "target", 0, folder)
    assert result.status == "done", result.error
    events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    failed = [e for e in events if "failed" in e]
    assert failed
    assert all(e["theta"][0] > 2.5 and e["cost"] is None and "shadow: " in e["failed"] for e in failed)
    assert abs(result.estimates["gain"][-1] - 2.0) < 0.05


STATES = (
    (
        'canGetAndSetFMUstate="false" canSerializeFMUstate="false"',
        'canGetAndSetFMUstate="true" canSerializeFMUstate="true"',
    ),
)
RATE = (("<Real/>", '<Real derivative="3"/>'),)
FIXED = (('name="gain" valueReference="0" causality="parameter" variability="tunable"',
          'name="gain" valueReference="0" causality="parameter" variability="fixed"'),)  # fmt: skip
CAUTIONS = {
    "state": [
        "roll-outs from the plant's saved state hide disturbances inside it: an FMU's state holds what nobody "
        'measures; start = "measured" does not'
    ],
    "measured": [],
    "replay": ["roll-outs simulated again from the start diverge on an unstable plant"],
}


@pytest.mark.parametrize("way", CAUTIONS)
def test_check_notes_what_to_know_of_the_way_that_is_asked_for(tmp_path, way):
    found = check(toml(tmp_path, spoilt(tmp_path, declared=STATES + RATE), way))
    assert not [f for f in found if f.is_error]
    assert [f.what for f in found if f.is_note][1:] == CAUTIONS[way]


START_METHODS = {
    "states can be saved": (STATES + RATE, "0.0", "saved state (a repeated step was the plant's own)"),
    "they cannot": (RATE, "0.0", "measured states (state: Spoilt.fmu cannot save and restore its state)"),
    "no state is declared": ((), "0.0", "simulated again from the start (state: Spoilt.fmu cannot save"),
    "what is saved is not all": (
        STATES + RATE,
        "0.2 * self.hidden",
        "from the start (state: a repeated step gave y = ",
    ),
    "what is measured is not all": (RATE, "0.2 * self.hidden", "differs by 5"),
}


@pytest.mark.full_but("states can be saved")
@pytest.mark.parametrize(("declared", "hidden", "told"), START_METHODS.values(), ids=START_METHODS)
def test_the_first_way_that_is_seen_to_work_is_taken_and_why_is_said(tmp_path, leaves_nothing, declared, hidden, told):
    path = toml(tmp_path, spoilt(tmp_path, hidden, declared=declared))
    result = run(Scenario.load(path, {"scenario.stop_time": "0.5"}), "target")
    assert result.status == "done", result.error
    assert told in result.objective
    assert result.summary()["objective"] == result.objective
    assert abs(result.estimates["gain"][-1] - 2.0) < 0.05
    notes = [f for f in check(path) if f.is_note]
    assert {f.where for f in notes} == {"estimation.objective"}
    assert "roll-outs of Spoilt.fmu" in str(notes[0])
    first = next(way for way in CAUTIONS if f"'{way}'" in notes[0].what)  # begun by 'state' or else 'measured' ...
    assert [f.what for f in notes[1:]] == CAUTIONS[first]


@pytest.mark.full
def test_what_is_hidden_and_zero_at_rest_is_found_once_the_plant_moves(tmp_path):
    fault = "self.w = getattr(self, 'w', 0.0) + h * self.u"
    path = toml(tmp_path, spoilt(tmp_path, "5.0 * getattr(self, 'w', 0.0)", fault, STATES + RATE))
    rows = [f"{0.01 * k:.2f}, {(k > 10) * (1 + 0.5 * math.sin(0.3 * k)):.6f}, 0.0" for k in range(62)]
    (tmp_path / "ref.csv").write_text("time [s], u, y\n" + "\n".join(rows))
    result = run(Scenario.load(path, {"scenario.stop_time": "0.5"}), "none")
    assert result.status == "done", result.error
    result = run(Scenario.load(path, {"scenario.stop_time": "0.5"}), "target")
    assert result.status == "done", result.error
    assert "state: a repeated step gave y = " in result.objective


def test_a_state_that_is_too_large_is_an_obstacle_as_any_other(tmp_path, leaves_nothing, monkeypatch):
    monkeypatch.setattr("cosim.fmi.fmi2_calls.LARGEST_STATE", 10)
    path, short = toml(tmp_path, spoilt(tmp_path, declared=STATES + RATE)), {"scenario.stop_time": "0.5"}
    result = run(Scenario.load(path, short | {"scenario.isolation": "none"}), "target")
    assert result.status == "done", result.error
    assert "measured states (state: plant: get_state at t = 0.0" in result.objective


def test_what_was_asked_for_and_is_not_the_plant_ends_the_run_in_one_line(tmp_path, capfd):
    path = toml(tmp_path, spoilt(tmp_path, "0.2 * self.hidden", declared=STATES + RATE), "state")
    assert main(["run", str(path), "--only", "--out", str(tmp_path / "out")]) == 1
    (line,) = [x for x in capfd.readouterr().err.splitlines() if x.startswith("retune:")]
    assert "no way to begin a roll-out: state: a repeated step gave y = " in line
    assert "the plant" in line


REFUSED = {
    "no state to save": ({"estimation.rollout.start": "state"}, RATE, "start = 'state': Spoilt.fmu cannot save"),
    "no states to measure": ({"estimation.rollout.start": "measured"}, (), "'measured': the plant declares no states"),
    "a fixed parameter": ({"changes": "{}"}, FIXED, "no way to begin a roll-out: state: "),
    "another FMU's state": ({"estimation.rollout.start": "state", "estimation.rollout.fmu": "own/Spoilt.fmu"},
                            STATES + RATE, "start = 'state': Spoilt.fmu is not the plant's FMU"),
    "no such FMU": ({"estimation.rollout.fmu": "none.fmu"}, RATE, "estimation.rollout: no FMU 'none.fmu'"),
    "not the plant": ({"estimation.rollout.fmu": "Quadrotor"}, RATE, "no variable 'u' in Quadrotor"),
    "no outputs": ({"sampling.outputs": "{}", "sampling.derivatives": '{"plant.der(y)" = {noise = 1.0}}',
                    "estimation.objective": "rollout"}, RATE, "'rollout' needs sampling.outputs"),
    "no model": ({"estimation.objective": "derivative"}, RATE, "estimation.model: derivatives need it"),
    "an endless episode": ({"estimation.trigger": '{ kind = "always" }'}, RATE, "'always' is for derivatives"),
    "no such objective": ({"estimation.objective": "simulate"}, RATE, "'simulate'"),
    "no such function": ({"estimation.objective": "nowhere:f"}, RATE, "cannot load 'nowhere:f'"),
    "no function": ({"estimation.objective": "math:pi"}, RATE, "'math:pi' must be a function"),
    "no processes": ({"estimation.rollout.jobs": "0"}, RATE, "estimation.rollout.jobs"),
    "misspelt": ({"estimation.rollout.strat": "state"}, RATE, "unknown key; did you mean 'start'?"),
}  # fmt: skip


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("settings", "declared", "told"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_rolled_out_is_refused_in_one_line_by_run_and_check(tmp_path, capfd, settings, declared, told):
    path = toml(tmp_path, spoilt(tmp_path, declared=declared))
    options = [text for key, value in settings.items() for text in ("--set", f"{key}={value}")]
    assert main(["run", str(path), "--only", "--out", str(tmp_path / "out"), *options]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("retune: ")
    assert told in line
    assert main(["check", str(path), *options]) == 2
    assert told in capfd.readouterr().out.replace(": error", "")


@pytest.mark.parametrize("name", ["rls"])
def test_estimators_that_work_sample_by_sample_only_are_refused(pendulum, name):
    with pytest.raises(ScenarioError, match=f"estimator '{name}' takes derivatives sample by sample"):
        run(pendulum(ROLLOUT), name)


def test_an_estimator_fmu_holds_no_other(pendulum):
    with pytest.raises(ScenarioError, match="an estimator FMU takes derivatives"):
        estimator_settings(pendulum(ROLLOUT))


CHOICES = {
    "model and derivatives": ({}, "derivative"),
    "also outputs": (OUTPUTS, "derivative"),
    "outputs, on request": (ROLLOUT, "rollout"),
    "outputs alone": (OUTPUTS | {"sampling.derivatives": "{}"}, "rollout"),
    "a function": ({"estimation.objective": "math:hypot"}, "function"),
}


@pytest.mark.parametrize(("settings", "kind"), CHOICES.values(), ids=CHOICES)
def test_an_objective_is_chosen_by_what_there_is(pendulum, settings, kind):
    assert chosen(pendulum(settings)).kind == kind


# -- FMUs compiled from C, with neither states to save nor derivatives that are asked for -------------------------

STIFFER_TOO = """true = "plant.mass.m"
[[estimation.parameters]]
name = "c"
lower = 1.0
upper = 50.0
unit = "N/m"
scale = "log"
writes = "controller.c"
true = "plant.spring.c"
"""


@pytest.fixture
def swinging(axis):
    """The axis follows a sine; mass and stiffness jump, and are sought in measurements of its position."""
    t = np.arange(0.0, 3.01, 0.01)
    rows = [f"{x:.2f}, {math.sin(5 * x):.9f}, {5 * math.cos(5 * x):.9f}" for x in t]
    return axis(
        ("stop_time = 1.0", "stop_time = 3.0"),
        ('"Axis.fmu"', '"Axis.fmu", start = { "mass.v" = 5.0, "damper.d" = 20.0 }'),
        ('"AxisController.fmu"', '"AxisController.fmu", start = { d = 20.0 }'),
        ("[[0.0, 2.0], [0.3, 3.0]]", '[[0.0, 2.0], [1.0, 3.0]]\n"plant.spring.c" = [[0.0, 8.0], [1.0, 14.0]]'),
        ("[sampling.derivatives]", "[sampling.outputs]"),
        ('"plant.der(mass.v)" = { noise = 1e-3 }', '"plant.mass.s" = { noise = 1e-4 }'),
        ('model = "axis_model:derivative"', "window = 20"),
        ('unit = "kg"', 'unit = "kg"\nscale = "log"'),
        ('true = "plant.mass.m"\n', STIFFER_TOO),
        steps="\n".join(rows),
    )


UNGUARDED = {"guard.enabled": "false", "diagnosis.enabled": "false"}
AGAIN = "a second search makes up for the moment of the change, which the simulation from the start has a little wrong"


@pytest.mark.full
@pytest.mark.parametrize("way", ["auto", pytest.param("replay", marks=pytest.mark.xfail(strict=True, reason=AGAIN))])
def test_an_fmu_in_c_is_re_tuned_from_its_position_alone(swinging, leaves_nothing, way):
    scenario = Scenario.load(swinging, {"estimation.rollout.start": way})
    result = run(scenario, "target")
    assert result.status == "done", result.error
    assert ("measured states" if way != "replay" else "from the start") in result.objective
    found = np.array([values[-1] for values in result.estimates.values()])
    np.testing.assert_allclose(found, [3.0, 14.0], rtol=0.2)  # two tenths of a second of a position tell no more
    nominal, floor = (run(scenario, name).mse[0] for name in ("none", "true"))
    assert nominal - result.mse[0] > 0.6 * (nominal - floor)


# -- states that only the scenario knows ----------------------------------------------------------------------------

STATES_NAMED = '"plant.mass.s" = {}\n"plant.mass.v" = { noise = 1e-3 }\n'


@pytest.fixture
def bare(axis, bare_axis):
    """bare(states): the axis, whose mass jumps, with an FMU that declares no derivatives; its position is compared."""

    def write(states=STATES_NAMED, start="measured"):
        return axis(
            ('"Axis.fmu"', f'"{bare_axis.name}"'),
            ("[sampling.derivatives]", "[sampling.states]\n" + states + "[sampling.outputs]"),
            ('"plant.der(mass.v)" = { noise = 1e-3 }', '"plant.mass.s" = { noise = 1e-4 }'),
            ('model = "axis_model:derivative"\ntrigger = { kind = "innovation" }',
             'trigger = { kind = "tracking", threshold = 0.02 }\nwindow = 20\n'
             f'rollout = {{ start = "{start}" }}'),
        )  # fmt: skip

    return write


@pytest.mark.full
@pytest.mark.parametrize("start", ["measured", "auto"])
def test_roll_outs_begin_in_states_that_the_scenario_names_for_an_fmu_that_declares_none(bare, leaves_nothing, start):
    path = bare(start=start)
    (note,) = [f for f in check(path) if f.is_note]
    assert "'measured'" in note.what
    result = run(Scenario.load(path), "target")
    assert result.status == "done", result.error
    assert "from measured states" in result.objective
    assert abs(result.estimates["m"][-1] - 3.0) < 0.2
    noise = result["sampled.plant.mass.s"] - result["plant.mass.s"]  # the output's, once
    assert 0.7e-4 < np.std(noise) < 1.3e-4
    assert 0.7e-3 < np.std(result["sampled.plant.mass.v"] - result["plant.mass.v"]) < 1.3e-3


def test_named_states_are_in_the_scenarios_order(bare, bare_axis):
    fmu = FmuFile("plant", read_description(bare_axis))
    for names in (("mass.s", "mass.v"), ("mass.v", "mass.s")):
        scenario = Scenario.load(bare("".join(f'"plant.{name}" = {{}}\n' for name in names)))
        assert plant_of(scenario, fmu).states == names


@pytest.mark.parametrize(
    ("states", "by_run", "by_check"),
    [
        ('"plant.mass.m" = {}\n', "'plant.mass.m' is no state of plant", "'mass.m' is no output of BareAxis.fmu"),
        ('"controller.f_cmd" = {}\n', "'controller.f_cmd' is no state of plant", "no state with a declared derivative"),
        ('"plant.mass.s" = { noise = 1.0 }\n', "'plant.mass.s' must have its noise once", "must have its noise once"),
        ("", "the plant declares no states: name them in sampling.states", "name them in sampling.states"),
    ],
)
def test_what_cannot_be_a_named_state_is_refused_in_one_line(bare, states, by_run, by_check):
    path = bare(states)
    with pytest.raises(CosimError) as refused:
        run(Scenario.load(path), "target")
    assert by_run in str(refused.value)
    assert "\n" not in str(refused.value)
    assert any(by_check in f.what for f in check(path) if f.is_error), check(path)


# -- a function of the user's -------------------------------------------------------------------------------------

FUNCTION = """
import math


def residual(theta, samples):
    \"\"\"Change of velocity over each step against Newton's law, in standard deviations.\"\"\"
    found = []
    for a, b in zip(samples, samples[1:]):
        phi, phi_dot, u = a.x[0], a.x[1], b.u[0]
        force = u - theta["m"] * 9.81 * math.sin(phi) - 0.1 * theta["l"] * phi_dot
        found.append((b.x[1] - phi_dot - (b.t - a.t) * force / (theta["m"] * theta["l"])) / 1e-4)
    return found


def short(theta, samples):
    return [50.0] * (1 if theta["m"] > 2.0 else 2)


def wide(theta, samples):
    return [[0.0, 1.0]]


def wrong(theta, samples):
    return undefined


def partial(theta, samples):
    return [math.sqrt(2.5 - theta["m"])] + residual(theta, samples)
"""


@pytest.mark.full_but('{ kind = "innovation" }')
@pytest.mark.parametrize("trigger", ['{ kind = "innovation" }', '{ kind = "tracking", threshold = 0.01 }'])
def test_a_function_of_the_users_is_an_objective(pendulum, workplace, trigger):
    (workplace / "mine.py").write_text(FUNCTION)
    settings = EARLY | {"estimation.objective": "mine:residual", "estimation.trigger": trigger}
    result = run(pendulum(settings, 1.0), "target")
    assert result.status == "done", result.error
    assert result.objective == "residuals of mine:residual"
    np.testing.assert_allclose(end(result), OTHER, rtol=0.03)  # Euler's rule is what limits it


FUNCTION_FAULTS = {
    "another number": ("short", "must return as many residuals each time"),
    "a matrix": ("wide", "must return a row of residuals, got an array of shape (1, 2)"),
    "raises": ("wrong", "mine:wrong failed: NameError: name 'undefined' is not defined"),
}


@pytest.mark.full_but("raises")
@pytest.mark.parametrize(("function", "told"), FUNCTION_FAULTS.values(), ids=FUNCTION_FAULTS)
def test_a_function_that_gives_no_residuals_ends_the_run_in_one_line(pendulum, workplace, function, told):
    (workplace / "mine.py").write_text(FUNCTION)
    result = run(pendulum(EARLY | {"estimation.objective": f"mine:{function}"}, 0.8), "target")
    assert result.status == "faulted"
    assert "estimation.objective: " in result.error
    assert told in result.error


@pytest.mark.full
def test_candidates_at_which_a_function_has_no_value_have_failed(pendulum, workplace):
    (workplace / "mine.py").write_text(FUNCTION)
    (workplace / "out").mkdir()
    settings = EARLY | {"estimation.objective": "mine:partial"}
    result = run(pendulum(settings, 1.0), "target", 0, workplace / "out")
    events = [json.loads(line) for line in (workplace / "out" / "events.jsonl").read_text().splitlines()]
    failed = [e for e in events if "failed" in e]
    assert result.status == "done", result.error
    assert failed
    assert all(e["theta"][0] > 2.5 and "ValueError" in e["failed"] for e in failed)


@pytest.mark.parametrize(
    ("function", "told"),
    {
        "raising": ("raising", "which failed each time: ValueError: could not convert string to float: 'a'"),
        "NaN": ("endless", "which failed each time: 2 residuals are not finite"),
        "at first only": ("late", None),
    }.values(),
    ids=["raising", "NaN", "at first only"],
)
def test_a_function_that_fails_each_time_is_why_nothing_was_re_tuned(pendulum, workplace, function, told):
    (workplace / "mine.py").write_text(f"{FUNCTION}\n{FAILING}")
    quiet = {"estimation.objective": f"mine:{function}", "changes": '{"plant.m" = 1.75, "plant.l" = 0.75}'}
    result = run(pendulum(quiet, 0.3), "target")
    (line,) = [line for line in diagnosis_report(result, []) if line.startswith("nothing was re-tuned")]
    if told is None:
        assert result.objective == f"residuals of mine:{function}"
        assert "never contradicted" in line
    else:
        assert result.objective == f"residuals of mine:{function}, {told}"
        assert line == f"nothing was re-tuned: mine:{function} failed each time it was called"


FAILING = """
def raising(theta, samples):
    return [float("a")]


def endless(theta, samples):
    return [math.nan, math.inf]


def late(theta, samples):
    return [float("a" if samples[-1].t < 0.1 else 0.5)]
"""
