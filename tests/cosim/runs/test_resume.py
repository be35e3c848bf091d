"""A run that stops anywhere goes on to the bits of one that was never disturbed, or says why it cannot."""

import json
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cosim import Run, Scenario, resume, run
from cosim.errors import FolderError, UnfinishedError
from cosim.runs.diagnosis_report import diagnosed
from cosim.runs.manifest import write_manifest
from cosim.runs.result import read_run
from cosim.runs.run_files import CHECKPOINT, EVENTS, LATENCIES, RESULT, SERIES
from cosim.slaves.slave import Slave
from fmu_models.build import build

pytestmark = pytest.mark.fmu

EARLY_CHANGE = {
    "scenario.stop_time": "0.6",
    "scenario.checkpoint": "15",
    'changes."plant.m"': "[[0.0, 1.75], [0.1, 4.271]]",
    'changes."plant.l"': "[[0.0, 0.75], [0.1, 0.981]]",
}
INNOVATION = {"estimation.trigger": '{ kind = "innovation" }'}
NOISY_STATES = {'sampling.states."plant.phi".noise': "1e-4", 'sampling.states."plant.phi_dot".noise': "1e-3"}
IN_PROCESS = {"scenario.isolation": "none"}
"""Spares the start of a process for each FMU."""
FINAL = (SERIES, EVENTS, "series.csv", "estimates.ssv")


class Stopped(Exception):
    """The run is left where it is, as when it is killed."""


def stop_at(until: float):
    def progress(t, _):
        if t > until - 1e-9:
            raise Stopped

    return progress


def left_at(until: float, scenario: Scenario, estimator: str, folder: Path) -> None:
    folder.mkdir()
    with pytest.raises(Stopped):
        run(scenario, estimator, 5, folder, stop_at(until))


def figures(folder: Path) -> dict[str, object]:
    """Figures of a result, without wall times."""
    result = json.loads((folder / RESULT).read_text())
    return {k: v for k, v in result.items() if k not in ("run", "wall_s", "latency_ms", "missed_deadlines")}


def assert_same(a: Path, b: Path) -> None:
    assert sorted(p.name for p in a.iterdir()) == sorted(p.name for p in b.iterdir())
    for name in FINAL:
        assert (a / name).read_bytes() == (b / name).read_bytes(), name
    assert figures(a) == figures(b)
    counts = [[len(step) for step in json.loads((f / LATENCIES).read_text())] for f in (a, b)]
    assert counts[0] == counts[1]


def check_resume(scenario: Scenario, estimator: str, tmp_path: Path, *until: float) -> Run:
    (tmp_path / "undisturbed").mkdir()
    whole = run(scenario, estimator, 5, tmp_path / "undisturbed")
    assert whole.status == "done"
    for t in until or (0.37,):
        left = tmp_path / f"left at {t}"
        left_at(t, scenario, estimator, left)
        assert read_run(left).status == "unfinished"
        resumed = resume(left)
        assert resumed.wall > 0.0
        assert_same(tmp_path / "undisturbed", left)
    return whole


@pytest.mark.full_but("target")
@pytest.mark.parametrize(
    "estimator",
    [
        "none",
        "true",
        "target",
        "paper",
        "bo-scalar",
        "least-squares",
        "multi-start",
        "sqp",
        "rls",
        "ukf",
        "enkf",
        "mhe",
    ],
)
def test_every_estimator_goes_on_to_the_same_bits(tmp_path, estimator):
    whole = check_resume(Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS), estimator, tmp_path)
    assert (whole.n_evaluations > 0) == (estimator not in ("none", "true"))


@pytest.mark.full
@pytest.mark.parametrize(
    "fault", ["", 'kind = "dropout"', 'kind = "spikes", size = 20.0'], ids=["sound", "dropouts", "spikes"]
)
def test_what_is_known_of_late_inputs_comes_back_to_the_bit(tmp_path, fault):
    """Also where samples are kept out, or prove to be outliers: their inputs arrive nevertheless."""
    changes = {"changes": '{ "plant.m" = 1.75, "plant.l" = 0.75, "plant.tau_u" = 0.03 }'}
    faulty = f'[{{ {fault}, sensor = "plant.der(phi_dot)", probability = 0.1, start = 0.3 }}]'
    faults = {"sampling.faults": faulty} if fault else {}
    scenario = Scenario.load(
        "pendulum", IN_PROCESS | changes | faults | {"scenario.stop_time": "0.6", "scenario.checkpoint": "15"}
    )
    whole = check_resume(scenario, "target", tmp_path)
    assert whole.diagnosis["input_lag"]["time_constant"] == pytest.approx(0.03, rel=0.02)
    assert any(line.startswith("the plant's inputs arrive late") for line in diagnosed(whole.diagnosis))


@pytest.mark.full
def test_what_is_known_of_friction_comes_back_to_the_bit(tmp_path):
    changes = {"changes": '{ "plant.m" = 1.75, "plant.l" = 0.75, "plant.b" = 2.0 }'}
    slow = {"scenario.stop_time": "1.8", "scenario.checkpoint": "15", "components.reference.start.phi_final": "0.7"}
    whole = check_resume(Scenario.load("pendulum", IN_PROCESS | changes | slow), "target", tmp_path)
    (term,) = whole.diagnosis["known_friction"]
    assert (term["law"], term["acts_on"]) == ("viscous", "plant.u")
    assert term["coefficient"] == pytest.approx(1.9 * 0.75, rel=0.02)  # the model has b = 0.1 kg/s, on the mass
    assert any(line.startswith("the plant has friction") for line in diagnosed(whole.diagnosis))


VARIANTS = {
    "innovation and noise on the states": IN_PROCESS | INNOVATION | NOISY_STATES,
    "processes": {},
    "parallel": IN_PROCESS | {"scenario.coupling": "parallel"},
    "FMI 3.0": {f"components.{name}.fmi": "3" for name in ("plant", "controller", "reference")},
    "an FMU as the model": {"estimation.model": "Pendulum"},
    "a checkpoint between the batches": IN_PROCESS | {"scenario.checkpoint": "7"},
}


@pytest.mark.full
@pytest.mark.parametrize("settings", VARIANTS.values(), ids=VARIANTS)
def test_every_kind_of_run_goes_on_to_the_same_bits(tmp_path, settings):
    check_resume(Scenario.load("pendulum", EARLY_CHANGE | settings), "target", tmp_path)


@pytest.mark.full
@pytest.mark.parametrize("name", ["quadrotor", "rigid-body", "stiction"])
def test_every_scenario_goes_on_to_the_same_bits(tmp_path, name):
    scenario = Scenario.load(name, IN_PROCESS | {"scenario.stop_time": "0.6", "scenario.checkpoint": "15"})
    check_resume(scenario, "target", tmp_path)


ROLLOUT = IN_PROCESS | {
    "scenario.stop_time": "0.4",
    "scenario.checkpoint": "9",
    "sampling.outputs": '{"plant.phi" = {noise = 1e-3}, "plant.phi_dot" = {noise = 2e-3}}',
    "estimation.objective": "rollout",
    "estimation.rollout.jobs": "1",
    "estimation.window": "8",
    "estimation.budget": "8",
    'changes."plant.m"': "[[0.0, 1.75], [0.1, 3.0]]",
}
OTHERWISE = {
    "from the saved state": ROLLOUT | {"estimation.rollout.start": "state"},
    "from measured states": ROLLOUT | {"estimation.rollout.start": "measured"},
    "from noisy states": ROLLOUT
    | {
        "estimation.rollout.start": "measured",
        "sampling.outputs": '{"plant.phi_dot" = {noise = 2e-3}}',
        "sampling.states": '{"plant.phi" = {noise = 1e-3}}',
    },
    "again from the start": ROLLOUT | {"estimation.rollout.start": "replay"},
    "without a diagnosis": ROLLOUT | {"diagnosis.enabled": "false"} | INNOVATION,
    "on filtered derivatives": EARLY_CHANGE | IN_PROCESS | {
        "sampling.derivatives": '{ "plant.der(phi_dot)" = { of = "plant.phi_dot" } }',
        "sampling.states": '{ "plant.phi" = { noise = 1e-4 }, "plant.phi_dot" = { noise = 1e-4 } }',
        "sampling.filter": '{ kind = "savitzky-golay" }',
    },
    "with a sensor that fails": EARLY_CHANGE | IN_PROCESS | {
        "sampling.faults": '[{ kind = "spikes", sensor = "plant.der(phi_dot)", probability = 0.2, size = 3.0 }]'
    },
    "with coloured noise": EARLY_CHANGE | IN_PROCESS | {
        "sampling.faults": '[{ kind = "noise", sensor = "plant.der(phi_dot)", size = 1e-3, correlation = 0.9 }]'
    },
}  # fmt: skip


@pytest.mark.full
@pytest.mark.parametrize("settings", OTHERWISE.values(), ids=OTHERWISE)
def test_roll_outs_filters_and_sensors_go_on_to_the_same_bits(tmp_path, settings):
    whole = check_resume(Scenario.load("pendulum", settings), "target", tmp_path, 0.15, 0.33)
    assert whole.n_episodes


@pytest.mark.full
@pytest.mark.parametrize(
    ("start", "estimator"),
    [("from the saved state", "ukf"), ("from noisy states", "enkf"), ("again from the start", "mhe")],
)
def test_filters_on_roll_outs_go_on_to_the_same_bits(tmp_path, start, estimator):
    whole = check_resume(Scenario.load("pendulum", OTHERWISE[start]), estimator, tmp_path, 0.15, 0.33)
    assert whole.n_episodes
    assert whole.n_evaluations


GPYS = {
    "target": {"estimation.target.kernel": '"Matern52 + Linear"', "estimation.evaluations_per_step": "3"},
    "bo-scalar": {"estimation.bo-scalar.surrogate": '"gpy"'},
}


@pytest.mark.full
@pytest.mark.parametrize("estimator", GPYS)
def test_kernels_of_gpys_go_on_to_the_same_bits(tmp_path, estimator):
    scenario = Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS | GPYS[estimator])
    assert check_resume(scenario, estimator, tmp_path, 0.15, 0.37).n_evaluations


OWN_KERNEL = """
import GPy
from estimator import TargetSettings, TargetVector


class Smooth(TargetVector):
    Settings = TargetSettings

    def __init__(self, space, start, rng, settings):
        super().__init__(space, start, rng, settings, kernel=lambda d: GPy.kern.RBF(d, ARD=True) + GPy.kern.Bias(d))
"""


@pytest.mark.full
def test_a_kernel_of_the_users_goes_on_to_the_same_bits(tmp_path, monkeypatch):
    name = f"kernel_{tmp_path.name}"
    (tmp_path / f"{name}.py").write_text(OWN_KERNEL)
    monkeypatch.chdir(tmp_path)
    scenario = Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS)
    assert check_resume(scenario, f"{name}:Smooth", tmp_path).n_evaluations
    sys.modules.pop(name)


FUNCTION = """
def residual(theta, samples):
    return [
        1e3 * (b.x[1] - a.x[1] - (b.t - a.t) * (b.u[0] / theta["m"] / theta["l"] - 9.81 / theta["l"]))
        for a, b in zip(samples, samples[1:])
    ]
"""


@pytest.mark.full
def test_a_function_of_the_users_goes_on_to_the_same_bits(tmp_path, monkeypatch):
    name = f"function_{tmp_path.name}"
    (tmp_path / f"{name}.py").write_text(FUNCTION)
    monkeypatch.chdir(tmp_path)
    settings = EARLY_CHANGE | IN_PROCESS | INNOVATION | {"estimation.objective": f"{name}:residual"}
    assert check_resume(Scenario.load("pendulum", settings), "target", tmp_path).n_episodes
    sys.modules.pop(name)


@pytest.mark.full
def test_a_table_is_played_on_from_where_it_was(tmp_path):
    rows = "".join(f"{0.05 * k},{np.sin(k)},0.0\n" for k in range(20))
    (tmp_path / "reference.csv").write_text("time [s],phi_ref [rad],phi_dot_ref [rad/s]\n" + rows)
    table = {"components.reference": f"{{ table = '{tmp_path / 'reference.csv'}' }}"}
    check_resume(Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS | table), "least-squares", tmp_path)


@pytest.mark.full
def test_it_may_be_left_again_and_again_before_and_after_every_checkpoint(tmp_path):
    scenario = Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS)
    (tmp_path / "undisturbed").mkdir()
    run(scenario, "target", 5, tmp_path / "undisturbed")
    left_at(0.0, scenario, "target", tmp_path / "left")
    for until in (0.14, 0.15, 0.16, 0.29, 0.45, 0.6):
        with pytest.raises(Stopped):
            resume(tmp_path / "left", stop_at(until))
        left = read_run(tmp_path / "left")
        assert left.status == "unfinished"
        assert len(left.time) >= int(until / 0.15) * 15  # what was there at the last checkpoint is there
    resume(tmp_path / "left")
    assert_same(tmp_path / "undisturbed", tmp_path / "left")


@pytest.mark.full
def test_an_interrupted_run_goes_on_and_its_end_is_written_anew(tmp_path):
    scenario = Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS)
    for name in ("undisturbed", "interrupted"):
        (tmp_path / name).mkdir()
    run(scenario, "target", 5, tmp_path / "undisturbed")

    def interrupt(t, _):
        if t > 0.4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(scenario, "target", 5, tmp_path / "interrupted", interrupt)
    assert read_run(tmp_path / "interrupted").status == "interrupted"
    resume(tmp_path / "interrupted")
    assert_same(tmp_path / "undisturbed", tmp_path / "interrupted")


@pytest.mark.full
@pytest.mark.parametrize("name", ["write_json", "write_text", "write_csv", "write_manifest"])
def test_a_disk_that_is_full_at_the_end_leaves_a_run_that_goes_on(tmp_path, monkeypatch, name):
    scenario = Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS)
    for folder in ("undisturbed", "full"):
        (tmp_path / folder).mkdir()
    run(scenario, "least-squares", 5, tmp_path / "undisturbed")

    def full(folder, *others, **named):
        if name != "write_manifest" or (tmp_path / "full" / RESULT).exists():
            raise FolderError(f"cannot write {folder}: No space left on device.")
        write_manifest(folder, *others, **named)

    with monkeypatch.context() as patch:
        patch.setattr(f"cosim.runs.result.{name}", full)
        with pytest.raises(UnfinishedError, match="No space left on device; what is written stays: make room, then"):
            run(scenario, "least-squares", 5, tmp_path / "full")
    left = read_run(tmp_path / "full")
    assert (left.status, len(left.time)) == ("unfinished", 61)
    resume(tmp_path / "full")
    assert_same(tmp_path / "undisturbed", tmp_path / "full")


def test_wall_times_add_up(tmp_path, monkeypatch):
    left_at(0.5, Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS), "none", tmp_path / "left")
    now = time.perf_counter
    monkeypatch.setattr("cosim.runs.simulation.perf_counter", lambda: now() + 1e6)  # another process's clock
    resumed = resume(tmp_path / "left")
    assert 0.0 < resumed.wall < 1e5
    assert resumed.wall == json.loads((tmp_path / "left" / RESULT).read_text())["wall_s"]


@pytest.mark.full
def test_a_run_without_a_row_begins_anew(tmp_path):
    scenario = Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS)
    (tmp_path / "undisturbed").mkdir()
    run(scenario, "target", 5, tmp_path / "undisturbed")
    left_at(0.0, scenario, "target", tmp_path / "left")
    for name in (CHECKPOINT, EVENTS):  # killed between the manifest and the first checkpoint
        (tmp_path / "left" / name).unlink()
    (tmp_path / "left" / SERIES).write_bytes(b"")
    resume(tmp_path / "left")
    assert_same(tmp_path / "undisturbed", tmp_path / "left")


def test_a_folder_that_holds_a_run_is_not_run_in(tmp_path):
    scenario = Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS)
    left_at(0.3, scenario, "none", tmp_path / "left")
    before = {p: p.read_bytes() for p in (tmp_path / "left").iterdir()}
    with pytest.raises(FolderError, match="left holds a run already"):
        run(scenario, "none", 5, tmp_path / "left")
    assert {p: p.read_bytes() for p in (tmp_path / "left").iterdir()} == before


@pytest.mark.full
def test_without_a_change_the_same_seed_goes_on_with_the_same_noise(tmp_path):
    """Independent of any estimator: the residual noise after the checkpoint is the generator's own continuation."""
    scenario = Scenario.load("pendulum", IN_PROCESS | {"scenario.stop_time": "0.6", "scenario.checkpoint": "15"})
    left_at(0.4, scenario, "none", tmp_path / "left")
    resumed = resume(tmp_path / "left")
    noise = resumed["sampled.plant.der(phi_dot)"] - resumed["plant.der(phi_dot)"]
    stream = np.random.default_rng(np.random.SeedSequence(5).spawn(2)[0])
    sigma = np.array([1e-3, 0.0, 0.0])  # of the derivative and the two states
    expected = [(sigma * stream.standard_normal(3))[0] for _ in range(61)]
    np.testing.assert_allclose(noise, expected, rtol=0, atol=1e-12)


# What cannot go on.


def refused(folder: Path) -> str:
    before = {p: p.read_bytes() for p in folder.iterdir()}
    with pytest.raises(FolderError) as caught:
        resume(folder)
    assert {p: p.read_bytes() for p in folder.iterdir()} == before
    return str(caught.value)


def test_an_fmu_that_cannot_save_its_state_is_named(tmp_path, faulty_toml):
    (tmp_path / "run").mkdir()
    assert run(Scenario.load(faulty_toml), "none", 5, tmp_path / "run").status == "faulted"
    reason = "FaultyReference.fmu cannot save and restore its state"
    assert refused(tmp_path / "run") == f"{tmp_path / 'run'} cannot be resumed: {reason}."


OWN = """
import random
import threading
from dataclasses import dataclass

from estimator import TargetVector


@dataclass
class Memory:
    theta: list


class Hidden(TargetVector):
    def __init__(self, space, start, rng, settings):
        super().__init__(space, start, rng)
        self.random = random.Random(0)


class Locked(TargetVector):
    def __init__(self, space, start, rng, settings):
        super().__init__(space, start, rng)
        self.lock, self.function = threading.Lock(), lambda theta: theta
        self.memories = []

    def tell(self, theta, residual):
        with self.lock:
            self.memories = [*self.memories[-5:], Memory(theta.tolist())]
        shift = 1e-6 * sum(memory.theta[0] for memory in self.memories)
        super().tell(self.function(theta), residual + shift)


class Late(TargetVector):
    def __init__(self, space, start, rng, settings):
        super().__init__(space, start, rng)

    def restart(self, start):
        super().restart(start)
        if hasattr(self, "n_starts"):
            self.lines = (line for line in "abc")
        self.n_starts = 1
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """An estimator of one's own, in a module beside which one works."""
    name = f"own_{tmp_path.name}"
    (tmp_path / f"{name}.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    yield name
    sys.modules.pop(name, None)


def test_an_estimator_of_ones_own_with_hidden_state_runs_and_says_why_it_cannot_go_on(tmp_path, own):
    left_at(0.4, Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS), f"{own}:Hidden", tmp_path / "left")
    why = "its state cannot be saved: Hidden.random is a Random, which is no data"
    assert refused(tmp_path / "left") == f"{tmp_path / 'left'} cannot be resumed: {why}."


@pytest.mark.full
def test_one_with_functions_locks_and_classes_of_its_own_goes_on_to_the_same_bits(tmp_path, own):
    check_resume(Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS), f"{own}:Locked", tmp_path)


@pytest.mark.full
def test_one_that_can_be_saved_at_first_goes_on_from_there(tmp_path, own):
    check_resume(Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS), f"{own}:Late", tmp_path, 0.5)


def test_an_estimator_that_has_changed_is_not_gone_on_with(tmp_path, own):
    left_at(0.4, Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS), f"{own}:Late", tmp_path / "left")
    (tmp_path / f"{own}.py").write_text(OWN + "# better\n")
    assert f"{own}.py has changed since it was begun." in refused(tmp_path / "left")


@pytest.mark.full
def test_a_model_fmu_that_has_changed_is_not_gone_on_with(tmp_path, cache):
    model = build("Pendulum", tmp_path, 3, "ModelExchange")
    scenario = Scenario.load("pendulum", EARLY_CHANGE | {"estimation.model": str(model)})
    left_at(0.4, scenario, "target", tmp_path / "left")
    with zipfile.ZipFile(model, "a") as fmu:
        fmu.writestr("documentation/note.txt", "new")
    assert "Pendulum.fmu has changed." in refused(tmp_path / "left")


class Forgetful:
    """FMUs that lose a bit of their state when it is restored."""

    def set_state(self, state: bytes) -> None:
        values = json.loads(state)
        values["values"] = [v * (1 + 1e-15) for v in values["values"]]
        set_state(self, json.dumps(values).encode())


set_state = Slave.set_state


@pytest.mark.full
def test_an_fmu_that_forgets_a_bit_of_its_state_is_found_out(tmp_path, monkeypatch):
    left_at(0.4, Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS), "target", tmp_path / "left")
    monkeypatch.setattr(Slave, "set_state", Forgetful.set_state)
    assert "gives other outputs once its state is restored" in refused(tmp_path / "left")


@pytest.mark.full
def test_other_bits_would_be_seen(tmp_path):
    """The comparison of this file can fail: measurement noise of another seed gives another run."""
    for seed in (5, 6):
        (tmp_path / str(seed)).mkdir()
        run(Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS), "target", seed, tmp_path / str(seed))
    with pytest.raises(AssertionError, match=SERIES):
        assert_same(tmp_path / "5", tmp_path / "6")


@pytest.mark.full
def test_a_disturbance_goes_on_where_it_was(tmp_path):
    """A changing force takes the place of the controller's."""
    wired = '{ "controller.phi" = "plant.phi", "controller.phi_dot" = "plant.phi_dot" }'
    pushed = {"connections": wired, 'changes."plant.u"': "[[0, 1.0], [0.33, '2 + sin(9*t)']]", "guard.enabled": "false"}
    check_resume(Scenario.load("pendulum", EARLY_CHANGE | IN_PROCESS | pushed), "none", tmp_path)
