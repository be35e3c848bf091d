"""Replays: an estimator that gets the samples of its own run again makes the same of them, bit for bit."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim import Run, ScenarioError, run
from cosim.campaigns.replay import replay, replayed
from cosim.errors import CosimError, FolderError
from cosim.files import sha256
from cosim.runs.manifest import write_manifest
from cosim.runs.result import read_run
from cosim.runs.run_files import LATENCIES, MANIFEST, RESULT, SERIES
from cosim.scenarios.scenario import Scenario

pytestmark = pytest.mark.fmu

EARLY_CHANGE = {
    "scenario.stop_time": "0.5",
    'changes."plant.m"': "[[0.0, 1.75], [0.1, 4.271]]",
    'changes."plant.l"': "[[0.0, 0.75], [0.1, 0.981]]",
}
INNOVATION = {"estimation.trigger": '{ kind = "innovation" }'}
NOISY_STATES = {'sampling.states."plant.phi".noise': "1e-4", 'sampling.states."plant.phi_dot".noise': "1e-3"}
FILTER = NOISY_STATES | {
    "sampling.derivatives": '{ "plant.der(phi_dot)" = { of = "plant.phi_dot" } }',
    "sampling.filter": '{ kind = "savitzky-golay", points = 5, order = 2 }',
}
OWN = {
    "innovation": ("least-squares", INNOVATION),
    "noise on the states": ("target", INNOVATION | NOISY_STATES),
    "tracking": ("target", {}),
    "derivatives from a filter": ("target", FILTER),
    "a solver on them": ("least-squares", FILTER),
    "each of them once": ("rls", FILTER),
    "each candidate written": ("paper", {}),
    "a solver": ("sqp", INNOVATION),
    "always": ("rls", {}),
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A recorded run of `target` with innovation trigger and noise on the states."""
    folder = tmp_path_factory.mktemp("recorded")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cosim.runs.record.ROWS_PER_BATCH", 25)
        return run(Scenario.load("pendulum", EARLY_CHANGE | INNOVATION | NOISY_STATES), "target", 5, folder)


@pytest.fixture
def folder(recorded: Run, tmp_path: Path) -> Path:
    """A copy of its folder, to be spoilt."""
    assert recorded.folder is not None
    return Path(shutil.copytree(recorded.folder, tmp_path / "run"))


@pytest.mark.full_but("innovation")
@pytest.mark.parametrize(("estimator", "settings"), OWN.values(), ids=OWN)
def test_a_runs_own_estimator_makes_the_same_of_its_samples(
    tmp_path: Path, estimator: str, settings: dict[str, str]
) -> None:
    # A replay, which has no consequences, has no guard; what the diagnosis finds possible only waits in both then.
    settings = settings | {"guard.enabled": "false", "diagnosis.enabled": "false"}
    original = run(Scenario.load("pendulum", EARLY_CHANGE | settings), estimator, 5, tmp_path)
    again = replayed(read_run(tmp_path), estimator, 5)
    for name, values in original.estimates.items():
        assert len(np.unique(values)) > 1, "nothing was estimated"
        np.testing.assert_array_equal(again.estimates[name], values)
    assert (again.n_evaluations, again.n_episodes) == (original.n_evaluations, original.n_episodes)
    assert [len(step) for step in again.latencies] == [len(step) for step in original.latencies]


def test_a_lag_of_the_actuator_is_that_of_the_steps_in_a_run_and_its_replay(tmp_path: Path) -> None:
    """Not of the filter's samples: what arrives in each step is averaged as they are."""
    late = {"changes": '{ "plant.m" = 1.75, "plant.l" = 0.75, "plant.tau_u" = 0.03 }', "scenario.stop_time": "1.0"}
    late |= {"components.reference.start.phi_final": "0.7", "guard.enabled": "false"}
    original = run(Scenario.load("pendulum", late | FILTER), "least-squares", 5, tmp_path)
    again = replayed(read_run(tmp_path), "least-squares", 5)
    for one in (original, again):
        assert one.diagnosis is not None
        assert one.diagnosis["input_lag"]["time_constant"] == pytest.approx(0.03, rel=0.1)
    assert again.diagnosis == original.diagnosis


def test_a_replay_reports_no_guard_of_the_recorded_run(recorded: Run) -> None:
    again = replayed(recorded, "least-squares", 5)
    assert recorded.guard is not None
    assert again.guard is None


@pytest.mark.full
def test_another_seed_searches_otherwise_on_the_same_samples(recorded: Run) -> None:
    """Without the diagnosis, which finds the same parameters for both."""
    by_itself = Scenario.load("pendulum", EARLY_CHANGE | INNOVATION | NOISY_STATES | {"diagnosis.enabled": "false"})
    a, b = (replayed(replace(recorded, scenario=by_itself), "paper", seed) for seed in (5, 6))
    assert not np.array_equal(a.estimates["m"], b.estimates["m"])
    for name in recorded.series.keys() - {p.writes for p in recorded.scenario.estimation.parameters}:
        np.testing.assert_array_equal(a[name], recorded[name])


def test_a_run_is_read_as_it_was(recorded: Run) -> None:
    assert recorded.folder is not None
    again = read_run(recorded.folder)
    assert list(again.series) == list(recorded.series)
    for name, values in recorded.series.items():
        np.testing.assert_array_equal(again[name], values)
    assert again.summary() == recorded.summary()
    assert again.summary() == json.loads((recorded.folder / RESULT).read_text())
    for name in ("scenario", "plant", "estimator", "seed", "status", "error", "latencies", "wall", "folder"):
        assert getattr(again, name) == getattr(recorded, name)


def killed(folder: Path, n_bytes_lost: int) -> None:
    """Make the folder what a killed run leaves behind."""
    for name in (RESULT, LATENCIES, "series.csv", "estimates.ssv"):
        (folder / name).unlink()
    manifest = json.loads((folder / MANIFEST).read_text())
    write_manifest(folder, manifest | {"status": "running"}, is_own=True)
    content = (folder / SERIES).read_bytes()
    (folder / SERIES).write_bytes(content[: len(content) - n_bytes_lost])


def test_a_killed_run_is_replayed_as_far_as_it_was_written(recorded: Run, folder: Path, tmp_path: Path) -> None:
    killed(folder, 100)
    left = read_run(folder)
    assert (left.status, left.error, left.latencies, len(left.time)) == ("unfinished", None, (), 50)
    again = replayed(left, "target", 5)
    assert len(np.unique(again.estimates["m"])) > 1, "nothing was estimated"
    np.testing.assert_array_equal(again.estimates["m"], replayed(recorded, "target", 5).estimates["m"][:50])
    comparison = replay(folder, ["target", "least-squares"], out=tmp_path / "out")
    assert "recorded up to t = 0.49 s" in comparison.table()
    assert json.loads((tmp_path / "out" / "comparison.json").read_text())["seeds"] == [5]
    # The scenario's instants lie beyond the run: compared at its end, which the record does not reach.
    assert comparison.instants == (0.5,)
    assert [row["parameter_errors"][0]["errors"]["m [kg]"]["n"] for row in comparison.rows()] == [0, 0]


def test_all_estimators_of_a_replay_see_the_same_and_are_asked_once(recorded: Run) -> None:
    assert recorded.folder is not None
    comparison = replay(recorded.folder, ["target", "least-squares", "target"])
    assert comparison.estimators == ("target", "least-squares")
    assert [r["mse"] for r in comparison.runs] == [recorded.mse] * 2
    own = comparison.rows()[0]["parameter_errors"][0]["errors"]["m [kg]"]["worst"]
    assert own == abs(recorded.estimates["m"][-1] - 4.271)
    assert "tracking error" not in comparison.table()


def test_a_replay_writes_nothing_into_the_run_and_overwrites_nothing(folder: Path) -> None:
    before = {p: p.read_bytes() for p in folder.iterdir()}
    replay(folder, ["least-squares"])
    for out in (folder, folder / MANIFEST):
        with pytest.raises(FolderError):
            replay(folder, ["least-squares"], out=out)
    assert {p: p.read_bytes() for p in folder.iterdir()} == before


def rewrite(name: str, **changes: object):
    def spoil(folder: Path) -> None:
        content = json.loads((folder / name).read_text()) | changes
        write_manifest(folder, {k: v for k, v in content.items() if v != "gone"}, is_own=True)

    return spoil


def without_column(name: str):
    def spoil(folder: Path) -> None:
        import pyarrow as pa

        with open(folder / SERIES, "rb") as file:
            table = pa.ipc.open_stream(file).read_all()
        with pa.ipc.new_stream(folder / SERIES, table.drop_columns([name]).schema) as writer:
            writer.write_table(table.drop_columns([name]))
        accepted(folder)

    return spoil


def accepted(folder: Path) -> None:
    """Let the manifest say that its files are as they are."""
    manifest = json.loads((folder / MANIFEST).read_text())
    there = [path for path in folder.iterdir() if path.is_file() and path.name != MANIFEST]
    write_manifest(folder, manifest | {"sha256": {path.name: sha256(path) for path in there}}, is_own=True)


def written(name: str, text: str):
    def spoil(folder: Path) -> None:
        (folder / name).write_text(text)
        accepted(folder)

    return spoil


SPOILT = {
    "nothing there": (shutil.rmtree, "no run folder: cannot read manifest.json: No such file"),
    "a file": (lambda f: (shutil.rmtree(f), f.write_text("")), "no run folder: cannot read manifest.json"),
    "no manifest": (lambda f: (f / MANIFEST).unlink(), "no run folder: cannot read manifest.json"),
    "a manifest that is no JSON": (lambda f: (f / MANIFEST).write_bytes(b"{\xff"), "manifest.json: Invalid JSON"),
    "a manifest that is a list": (lambda f: (f / MANIFEST).write_text("[]"), "manifest.json: Input should be"),
    "no plant": (rewrite(MANIFEST, plant="gone"), "manifest.json: plant: Field required"),
    "a text for a seed": (rewrite(MANIFEST, seed="x"), "manifest.json: seed: "),
    "an unknown status": (rewrite(MANIFEST, status="gone fishing"), "manifest.json: status"),
    "an old scenario": (rewrite(MANIFEST, scenario={}), "scenario of another version: scenario: Field required"),
    "no result": (lambda f: (f / RESULT).unlink(), "cannot read result.json"),
    "a result that is a list": (written(RESULT, "[]"), "result.json: Input should be"),
    "latencies that are none": (written(LATENCIES, "{}"), "latencies.json: Input should be"),
    "no series": (lambda f: (f / SERIES).unlink(), "cannot read series.arrow"),
    "a series that is none": (written(SERIES, "x"), "no readable series.arrow"),
    "no row": (lambda f: killed(f, (f / SERIES).stat().st_size - 3000), "has no rows"),
    "no held input": (without_column("held.plant.u"), "lacks the column 'held.plant.u'"),
    "no tracked output": (without_column("plant.phi"), "lacks the column 'plant.phi'"),
    "no reference": (without_column("reference.phi_ref"), "lacks the column 'reference.phi_ref'"),
    "no truth": (without_column("plant.m"), "lacks the column 'plant.m'"),
    "no time": (without_column("time"), "lacks the column 'time'"),
}


@pytest.mark.parametrize(("spoil", "reason"), SPOILT.values(), ids=SPOILT)
def test_a_folder_without_a_whole_run_is_refused_in_one_line(folder: Path, spoil, reason: str) -> None:
    spoil(folder)
    with pytest.raises(FolderError) as caught:
        replay(folder, ["least-squares"])
    assert reason in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("estimator", "reason"),
    [
        ("targt", "no estimator 'targt'; did you mean 'target'"),
        ("none", "'none' estimates nothing; replay an estimator"),
        ("true", "'true' estimates nothing; replay an estimator"),
        ("nowhere:Nobody", "cannot load 'nowhere:Nobody'"),
    ],
)
def test_what_estimates_nothing_is_refused_before_a_folder_is_made(
    recorded: Run, tmp_path: Path, estimator: str, reason: str
) -> None:
    assert recorded.folder is not None
    with pytest.raises(ScenarioError, match=reason):
        replay(recorded.folder, ["target", estimator], out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_model_that_is_gone_is_told_in_one_line(folder: Path) -> None:
    scenario = json.loads((folder / MANIFEST).read_text())["scenario"]
    scenario["estimation"]["model"] = "gone_with_the_wind:derivative"
    rewrite(MANIFEST, scenario=scenario)(folder)
    with pytest.raises(CosimError, match="cannot load 'gone_with_the_wind:derivative'"):
        replay(folder, ["least-squares"])


@pytest.mark.full
def test_a_replay_tells_how_candidates_were_judged_and_what_was_found_in_vain(tmp_path: Path) -> None:
    """Roll-outs from the start, of a plant that is pushed by what its inputs do not hold."""
    rollouts = {
        "estimation.objective": "rollout",
        "sampling.outputs": '{"plant.phi" = {noise = 1e-4}}',
        "estimation.rollout.start": "replay",
        "changes": '{"plant.F_d" = [[0.0, 0.0], [0.2, "8*sin(40*t)"]]}',
    }
    recorded = run(Scenario.load("pendulum", {"scenario.stop_time": "2.0"} | rollouts), "none", 0, tmp_path)
    assert recorded.folder is not None
    table = replay(recorded.folder, ["target"]).table()
    assert "Candidates are judged by roll-outs" in table
    assert "target: failed searches: " in table
