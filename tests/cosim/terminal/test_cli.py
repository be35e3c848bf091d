"""The command: what it prints, what it returns, what it leaves behind."""

import errno
import gc
import importlib.util
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
import zipfile
from importlib.resources import files
from pathlib import Path

import fmpy
import numpy as np
import pytest

import cosim
from cosim.errors import FolderError
from cosim.fmi.folder import remove_abandoned
from cosim.runs.result import read_run
from cosim.runs.series import read_series
from cosim.system.fmu_cache import build_into
from fmu_models.build import NAMES, PLANTS

pytestmark = [pytest.mark.fmu, pytest.mark.usefixtures("leaves_nothing", "workplace")]

RETUNE = Path(sys.executable).parent / "retune"
PENDULUM = (files("cosim") / "scenarios" / "pendulum.toml").read_text(encoding="utf-8")
SHORT = ["run", "pendulum", "--only", "--set", "scenario.stop_time=0.1"]
EARLY_CHANGE = ["--set", 'changes."plant.m"=[[0.0, 1.75], [0.05, 4.271]]']
LATE_TRIGGER = '--set=estimation.trigger={kind = "tracking", threshold = 0.01}'
KEYS = [
    "scenario", "estimator", "seed", "mse", "max_error", "parameters", "gains", "final_estimate", "instants",
    "evaluations", "episodes", "model_calls", "objective", "guard", "observations", "diagnosis", "latency_ms",
    "latency_steps", "deadline_ms", "missed_deadlines", "wall_s", "status", "diverged_at", "error", "run",
]  # fmt: skip


def retune(*arguments):
    """The installed command in a process of its own."""
    return subprocess.run([RETUNE, *arguments], capture_output=True, text=True, timeout=120, stdin=subprocess.DEVNULL)


# JSON.


def test_json_is_one_object_with_the_documented_keys_and_nothing_else_is_printed(workplace):
    late = '--set=estimation.trigger={kind = "tracking", threshold = 0.01}'
    done = retune(
        *SHORT, *EARLY_CHANGE, late, "--json", "--seed", "7", "--set", "estimation.instants=[0.04, 0.05, 9.0]"
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("\n") == 1
    result = json.loads(done.stdout)
    assert list(result) == KEYS
    assert (result["scenario"], result["estimator"], result["seed"]) == ("pendulum", "target", 7)
    assert (result["status"], result["diverged_at"], result["error"]) == ("done", None, None)
    assert result["deadline_ms"] == 10.0
    assert result["run"] == "runs/pendulum-1"
    series = read_series(workplace / result["run"])
    error = series["plant.phi"] - series["reference.phi_ref"]
    assert result["mse"] == [pytest.approx(np.mean(error**2), rel=1e-12)]
    assert result["max_error"] == pytest.approx(np.max(np.abs(error)), rel=1e-12)
    assert [list(p) for p in result["parameters"]] == [["name", "unit", "true", "estimated"]] * 2
    assert [(p["name"], p["unit"], p["true"]) for p in result["parameters"]] == [("m", "kg", 4.271), ("l", "m", 0.75)]
    assert [i["t"] for i in result["instants"]] == [0.04, 0.05]
    assert [i["parameters"][0]["true"] for i in result["instants"]] == [1.75, 4.271]
    assert list(result["diagnosis"]) == [
        "channels",
        "disturbances",
        "input_lag",
        "disturbance",
        "lag",
        "friction",
        "unexplained",
        "rest",
        "known_friction",
    ]
    assert list(result["diagnosis"]["channels"]) == ["plant.der(phi_dot)"]
    assert list(result["latency_ms"]) == ["p50", "p99", "max"]
    assert result["final_estimate"] is None  # nothing has triggered yet
    assert json.loads((workplace / result["run"] / "result.json").read_text()) == result


@pytest.mark.parametrize("is_captured", [False, True], ids=["in a process of its own", "with a stream in its place"])
def test_what_a_model_prints_is_no_part_of_the_json(called, workplace, is_captured):
    """Python's print, and what a library writes to the file descriptor, go to standard error."""
    raw = "" if is_captured else 'os.write(1, b"at the descriptor\\n"), '
    (workplace / "printing_model.py").write_text(
        "import os\nfrom fmu_models.pendulum import derivative as quiet\n\n\n"
        f"def derivative(x, u, m, l):\n    {raw}print('by print')\n    return quiet(x, u, m, l)\n"
    )
    text = PENDULUM.replace('model = "fmu_models.pendulum:derivative"', 'model = "printing_model:derivative"')
    (workplace / "printing.toml").write_text(text)
    command = ["run", "printing.toml", "--only", "--json", "--set", "scenario.stop_time=0.1"]
    if is_captured:
        code, out, err = called(*command)
    else:
        done = retune(*command)
        code, out, err = done.returncode, done.stdout, done.stderr
    assert (code, json.loads(out)["status"]) == (0, "done")
    assert "by print" in err
    assert ("at the descriptor" in err) != is_captured


def test_json_has_null_where_there_is_no_figure(called):
    code, out, err = called(*SHORT, "--json", "--estimator", "none")
    result = json.loads(out)
    assert (code, err) == (0, "")
    assert result["latency_ms"] == {"p50": None, "p99": None, "max": None}
    assert (result["evaluations"], result["episodes"], result["missed_deadlines"]) == (0, 0, 0)


@pytest.mark.full
def test_a_seed_is_repeated_exactly(called):
    arguments = [*SHORT, *EARLY_CHANGE, "--json", "--set", "scenario.stop_time=0.3"]
    results = [json.loads(called(*arguments, "--seed", seed)[1]) for seed in ("3", "3", "4")]
    for result in results:
        for key in ("latency_ms", "missed_deadlines", "wall_s", "run"):
            del result[key]
    assert results[0] == results[1]
    assert results[0]["parameters"] != results[2]["parameters"]


@pytest.mark.full
def test_isolation_does_not_change_a_bit(workplace):
    # A process of its own: FMUs that are loaded into a process stay there.
    for isolation in ("none", "process"):
        settings = ["--set", f"scenario.isolation={isolation}", "--set", "scenario.stop_time=0.3"]
        done = retune(*SHORT, *EARLY_CHANGE, *settings, "--out", isolation)
        assert (done.returncode, done.stderr) == (0, "")
    assert (workplace / "none" / "events.jsonl").stat().st_size > 0
    for name in ("series.arrow", "events.jsonl", "series.csv", "estimates.ssv"):
        assert (workplace / "none" / name).read_bytes() == (workplace / "process" / name).read_bytes()


# The report and the pictures.


@pytest.mark.full
def test_a_whole_run_is_compared_with_nominal_and_true_parameters_and_drawn(workplace):
    done = retune("run", "pendulum", "--out", "mine", "--set", "scenario.stop_time=0.5", *EARLY_CHANGE)
    assert (done.returncode, done.stderr) == (0, "")
    for part in ("nominal controller", "true parameters (floor)", "re-tuned by target", "m [kg]", "run folder mine"):
        assert part in done.stdout
    folder = workplace / "mine"
    names = {p.name for p in folder.iterdir()}
    assert names >= {"manifest.json", "result.json", "series.arrow", "series.csv", "events.jsonl", "none", "true"}
    pictures = [p for p in folder.iterdir() if p.suffix == ".png"]
    assert {p.name for p in pictures} >= {"tracking.png", "error.png", "parameters.png"}
    assert all(p.read_bytes().startswith(b"\x89PNG\r\n\x1a\n") for p in pictures)
    for name in ("none", "true"):
        assert json.loads((folder / name / "result.json").read_text())["estimator"] == name
    final_estimate = json.loads((folder / "result.json").read_text())["final_estimate"]
    assert [list(p) for p in final_estimate["parameters"]] == [["name", "unit", "value", "std", "is_identifiable"]] * 2
    assert abs(final_estimate["parameters"][0]["value"] - 4.271) < 4.0 * final_estimate["parameters"][0]["std"]
    assert read_run(folder).final_estimate.to_json() == final_estimate
    assert f"last estimate, at t = {final_estimate['t']:g} s" in done.stdout
    assert all(finding in done.stdout for finding in final_estimate["findings"])


def test_only_leaves_out_comparisons_and_pictures(called, workplace):
    code, out, err = called(*SHORT, "--out", "mine")
    assert (code, err) == (0, "")
    assert "nominal controller" not in out
    assert not [p for p in (workplace / "mine").iterdir() if p.is_dir() or p.suffix == ".png"]


def test_run_folders_are_numbered(called, workplace):
    for _ in range(2):
        assert called(*SHORT, "--estimator", "none")[0] == 0
    assert {p.name for p in (workplace / "runs").iterdir()} == {"pendulum-1", "pendulum-2"}


@pytest.mark.full
def test_a_scenario_of_ones_own_finds_its_fmu_and_its_model_beside_it(called, workplace, cache):
    (workplace / "lab").mkdir()
    assert called("build", "--out", "lab")[0] == 0
    (workplace / "lab" / "my_model_of_a_pendulum.py").write_text(
        "def derivative(x, u, m, l):\n    from math import sin\n"
        "    return x[1], -9.81 / l * sin(x[0]) - 0.1 / m * x[1] + u[0] / (m * l)\n"
    )
    text = PENDULUM.replace('"Pendulum"', '"Pendulum.fmu"').replace("fmu_models.pendulum", "my_model_of_a_pendulum")
    (workplace / "lab" / "mine.toml").write_text(text)
    code, out, err = called(
        "run", "lab/mine.toml", "--only", "--json", "--set", "scenario.stop_time=0.2", *EARLY_CHANGE
    )
    assert (code, err) == (0, "")
    assert json.loads(out)["evaluations"] > 0


@pytest.mark.parametrize("command", ["run", "compare"])
def test_help_names_every_scenario(called, command):
    code, out, err = called(command, "--help")
    assert (code, err) == (0, "")
    assert "magnetic-levitation, pendulum, quadrotor, rigid-body, stiction, " in " ".join(out.split())


def test_the_version_is_printed(called):
    assert called("--version") == (0, f"fmu-retune {cosim.__version__}\n", "")


# Refusals.


def write_inputs(folder):
    (folder / "reversed.toml").write_text(PENDULUM.replace("lower = 0.1\nupper = 5.0", "lower = 5.0\nupper = 0.1"))
    (folder / "plain.toml").write_text(re.sub("linear = .*", "", PENDULUM))
    (folder / "broken.toml").write_text("[[[")
    (folder / "a file").write_text("")
    (folder / "full").mkdir()
    (folder / "full" / "mine").write_text("precious")
    (folder / "text.fmu").write_text("no zip")
    with zipfile.ZipFile(folder / "empty.fmu", "w") as archive:
        archive.writestr("readme.txt", "no FMU")


COMPARE = ["compare", "pendulum", "--seeds", "1", "--estimators", "none", "--set", "scenario.stop_time=0.1"]
NEEDS_LINEAR = "estimator 'rls' needs estimation.linear"


def plant(folder, fmu):
    return ["--set", f"components.plant.fmu={folder / fmu}"]


REFUSED = [
    ("no command", lambda f: [], "COMMAND"),
    ("unknown command", lambda f: ["frobnicate"], "frobnicate"),
    ("unknown option", lambda f: ["run", "pendulum", "--jsn"], "--jsn"),
    ("no scenario", lambda f: ["run"], "SCENARIO"),
    ("unknown scenario", lambda f: ["run", "pendulm"], "did you mean 'pendulum'"),
    ("missing file", lambda f: ["run", f / "gone.toml"], "gone.toml"),
    ("broken file", lambda f: ["run", f / "broken.toml"], "broken.toml: not a readable TOML file"),
    ("a page as a scenario", lambda f: ["run", "x" * 5000], "no scenario"),
    ("reversed bounds", lambda f: ["run", f / "reversed.toml"], "reversed.toml: estimation.parameters.0"),
    ("macro step zero", lambda f: [*SHORT, "--set", "scenario.macro_step=0"], "scenario.macro_step"),
    ("macro step that does not divide", lambda f: [*SHORT, "--set", "scenario.macro_step=0.03"], "whole multiple"),
    ("unknown estimator", lambda f: [*SHORT, "--estimator", "tru"], "did you mean 'true'"),
    ("negative seed", lambda f: [*SHORT, "--seed", "-1"], "--seed"),
    ("fractional seed", lambda f: [*SHORT, "--seed", "1.5"], "--seed"),
    ("seed of other digits", lambda f: [*SHORT, "--seed", "²"], "--seed"),
    ("setting without a value", lambda f: [*SHORT, "--set", "scenario.macro_step"], "KEY=VALUE"),
    ("unknown setting", lambda f: [*SHORT, "--set", "scenario.macro_stp=1"], "did you mean 'macro_step'"),
    ("setting that is no key", lambda f: [*SHORT, "--set", "a b=1"], "not a TOML key"),
    ("full folder", lambda f: [*SHORT, "--out", f / "full"], "is not empty"),
    ("file as folder", lambda f: [*SHORT, "--out", f / "a file"], "cannot make the run folder"),
    ("folder below a file", lambda f: [*SHORT, "--out", f / "a file" / "x"], "cannot make the run folder"),
    ("missing FMU", lambda f: [*SHORT, *plant(f, "gone.fmu")], "retune: pendulum: components.plant.fmu: no FMU"),
    ("text as FMU", lambda f: [*SHORT, *plant(f, "text.fmu")], "text.fmu is not a usable FMU"),
    ("zip that is no FMU", lambda f: [*SHORT, *plant(f, "empty.fmu")], "empty.fmu is not a usable FMU"),
    ("wrong wire", lambda f: [*SHORT, "--set", 'connections."plant.u"=controller.v'], 'm: connections."plant.u": '),
    ("start out of range", lambda f: [*SHORT, "--set", "components.plant.start.m=-3"], "components.plant.start: "),
    ("function as formula", lambda f: [*SHORT, "--set", 'changes."plant.m"=sin'], "plant.m"),
    ("unknown model", lambda f: [*SHORT, "--set", "estimation.model=nowhere:f"], "nowhere"),
    ("setting of the estimator", lambda f: [*SHORT, "--set", "estimation.paper.n_initial=-5"], "n_initial"),
    ("unknown kernel", lambda f: [*SHORT, "--set", "estimation.target.kernel=Matern25"], "did you mean 'Matern52'"),
    (
        "kernel that is code",
        lambda f: [*SHORT, "--set", 'estimation.target.kernel="exec(1)"'],
        "names of GPy's kernels",
    ),
    ("kernel of one dimension", lambda f: [*SHORT, "--set", "estimation.target.kernel=Brownian"], "in 2 dimensions"),
    ("build over a file", lambda f: ["build", "--out", f / "a file"], "cannot build into"),
    ("an estimator's package", lambda f: [*SHORT, "--estimator", "nowhere:Nobody"], "cannot load 'nowhere:Nobody'"),
    ("compare nothing", lambda f: ["compare"], "SCENARIO"),
    ("compare an unknown scenario", lambda f: ["compare", "pendulm"], "did you mean 'pendulum'"),
    ("compare an unknown estimator", lambda f: [*COMPARE, "--estimators", "targt"], "did you mean 'target'"),
    ("compare without a name", lambda f: [*COMPARE, "--estimators", "target,,sqp"], "separated by commas"),
    ("compare no seed", lambda f: [*COMPARE, "--seeds", "0"], "--seeds"),
    ("compare with no job", lambda f: [*COMPARE, "--jobs", "0"], "--jobs"),
    ("compare into a full folder", lambda f: [*COMPARE, "--out", f / "full"], "is not empty"),
    ("compare an unknown setting", lambda f: [*COMPARE, "--set", "scenario.macro_stp=1"], "did you mean 'macro_step'"),
    ("compare without a linear form", lambda f: ["compare", f / "plain.toml", "--estimators", "rls"], NEEDS_LINEAR),
    ("run without a linear form", lambda f: ["run", f / "plain.toml", "--estimator", "rls"], NEEDS_LINEAR),
    ("replay nothing", lambda f: ["replay", "--estimator", "target"], "RUN"),
    ("replay by nobody", lambda f: ["replay", f], "--estimator"),
    ("replay what is gone", lambda f: ["replay", f / "gone", "--estimator", "target"], "no run folder"),
    ("replay a file", lambda f: ["replay", f / "a file", "--estimator", "target"], "no run folder"),
    ("replay a folder of something else", lambda f: ["replay", f / "full", "--estimator", "target"], "no run folder"),
    ("replay with a negative seed", lambda f: ["replay", f, "--estimator", "target", "--seed", "-1"], "--seed"),
    ("figures into a full folder", lambda f: ["figures", "--out", f / "full"], "is not empty"),
    ("figures with no job", lambda f: ["figures", "--jobs", "0"], "--jobs"),
    ("figures with a fractional seed", lambda f: ["figures", "--seed", "1.5"], "--seed"),
    ("picture over a file", lambda f: ["illustrate", "--out", f / "a file"], "exists"),
]


def test_a_command_that_a_program_calls_leaves_the_garbage_collector_as_it_was(called):
    before = gc.get_threshold()
    assert called("info", "nothing.fmu")[0] == 2
    assert gc.get_threshold() == before


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("arguments", "subject"), [r[1:] for r in REFUSED], ids=[r[0] for r in REFUSED])
def test_bad_input_is_refused_in_one_line_with_exit_code_2_and_nothing_left_behind(
    called, workplace, tmp_path, arguments, subject
):
    inputs = tmp_path / "inputs"
    inputs.mkdir()
    write_inputs(inputs)
    before = {p: p.is_file() and p.read_bytes() for p in inputs.rglob("*")}
    code, out, err = called(*arguments(inputs))
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert err.startswith("retune")
    assert subject in err
    assert "Traceback" not in err
    assert list(workplace.iterdir()) == []
    assert {p: p.is_file() and p.read_bytes() for p in inputs.rglob("*")} == before


@pytest.mark.full_but("FMU")
@pytest.mark.parametrize(
    "arguments", [["run", "pendulm"], [*SHORT, "--set", "components.plant.fmu=Pendulm"]], ids=["scenario", "FMU"]
)
def test_the_installed_command_refuses_in_one_line_too(workplace, arguments):
    done = retune(*arguments)
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)
    assert list(workplace.iterdir()) == []


def test_an_empty_folder_that_was_there_before_is_there_after_a_refusal(called, workplace):
    (workplace / "mine").mkdir()
    assert called(*SHORT, "--out", "mine", "--set", "components.plant.fmu=Pendulm")[0] == 2
    assert [p.name for p in workplace.iterdir()] == ["mine"]


def test_ipopt_is_asked_for_where_it_is_missing(called, workplace, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *a: None if name == "cyipopt" else find(name, *a))
    for command in ([*SHORT, "--estimator", "ipm"], [*COMPARE, "--estimators", "ipm-wide-step"]):
        code, out, err = called(*command)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert "needs Ipopt: pip install 'fmu-retune[ipopt]'; 'ipm-scipy' does without." in err
    assert list(workplace.iterdir()) == []


# Many runs, and old ones.


@pytest.mark.full
def test_a_comparison_is_printed_and_written(called, workplace):
    command = ["compare", "pendulum", "--seeds", "2", "--estimators", "least-squares", "--jobs", "2"]
    code, out, err = called(*command, "--set", "scenario.stop_time=0.2", *EARLY_CHANGE)
    assert (code, err) == (0, "")
    assert out.splitlines()[-2] == "written to runs/pendulum-compare-1"
    assert out.splitlines()[-1].startswith("next: retune run pendulum --estimator ")
    assert max(map(len, out.splitlines()[:-1])) <= 120
    (folder,) = (workplace / "runs").iterdir()
    result = json.loads((folder / "comparison.json").read_text())
    assert [row["estimator"] for row in result["estimators"]] == ["none", "true", "least-squares"]
    assert (result["seeds"], len(result["runs"])) == ([0, 1], 6)


def test_a_run_is_replayed(called, workplace):
    assert called(*SHORT, *EARLY_CHANGE, "--seed", "4", "--out", "mine")[0] == 0
    code, out, err = called("replay", "mine", "--estimator", "least-squares, target", "--json", "--out", "again")
    assert (code, err) == (0, "")
    result = json.loads(out)
    assert [row["estimator"] for row in result["estimators"]] == ["least-squares", "target"]
    assert (result["seeds"], result["folder"]) == ([4], "again")
    assert json.loads((workplace / "again" / "comparison.json").read_text()) == result
    before = {p: p.read_bytes() for p in workplace.rglob("*") if p.is_file()}
    for arguments in (["target", "--out", "again"], ["none", "--out", "new"], ["targt", "--out", "new"]):
        code, out, err = called("replay", "mine", "--estimator", *arguments)
        assert (code, out, err.count("\n")) == (2, "", 1)
    assert {p: p.read_bytes() for p in workplace.rglob("*") if p.is_file()} == before
    assert not (workplace / "new").exists()


def test_figures_are_listed_as_they_are_written(called, workplace, monkeypatch):
    given = []

    def made_up(folder, seed, jobs, progress):
        given.append((folder, seed, jobs))
        progress({"scenario": "pendulum", "estimator": "none", "seed": seed, "status": "done"}, 1, 2)
        return [folder / "a.png", folder / "b.svg"]

    monkeypatch.setattr("cosim.commands.figures.figures", made_up)
    code, out, err = called("figures", "--seed", "4", "--jobs", "2")
    assert (code, out, err) == (0, "figures/a.png\nfigures/b.svg\nnext: retune compare quadrotor\n", "")
    assert given == [(Path("figures"), 4, 2)]


# Estimators of the user's own.

OWN = """
from dataclasses import dataclass

import numpy as np

from estimator import Estimate


@dataclass(frozen=True)
class Settings:
    value: float = 2.0

    def __post_init__(self):
        if self.value <= 0.0:
            raise ValueError(f"value must be positive, got {self.value}.")


class Believer:
    \"\"\"Believes what it was told to.\"\"\"

    Settings = Settings
    is_whitened = True

    def __init__(self, space, start, rng, settings):
        self.theta, self.n = np.array([settings.value, 1.5]), 0

    def restart(self, start):
        self.n = 0

    def estimate(self):
        return Estimate(self.theta, np.ones(2), (True, True), 0.0, self.n, "I was told")


class Asker(Believer):
    def ask(self):
        return self.theta

    def tell(self, theta, residual):
        self.n += 1


class Solver(Believer):
    def solve(self, objective):
        self.n += 1
        objective.residual(self.theta)


class Raises(Asker):
    def __init__(self, *_):
        raise RuntimeError("not today")


class Tires(Solver):
    def solve(self, objective):
        super().solve(objective)
        if self.n == 3:
            raise RuntimeError("no\\nmore")


class Linear(Believer):
    defaults = {"budget": 1, "value": 4.0}
    needs_linear_form = True

    def solve(self, objective):
        self.n += 1
        objective.residual(self.theta)
        self.theta = np.array([self.theta[0], 1.5 if objective.linear is None else 0.5])


class Forgets(Asker):
    def estimate(self):
        if self.n == 3:
            raise RuntimeError("no\\nmore")
        return super().estimate()


class Deep(Asker):
    def estimate(self):
        return self.estimate()


class Mute:
    def __init__(self, *_):
        pass


function = len
"""


@pytest.fixture
def own(workplace):
    """Module with the estimators above, beside the scenario or in the working directory; no two tests share one."""
    name = f"own_{workplace.parent.name}"
    (workplace / f"{name}.py").write_text(OWN)
    yield name
    sys.modules.pop(name, None)


@pytest.mark.full
@pytest.mark.parametrize("kind", ["Asker", "Solver"])
def test_an_estimator_of_ones_own_is_run_with_its_settings(called, own, workplace, kind):
    name = f"{own}:{kind}"
    (workplace / "mine.toml").write_text(f'{PENDULUM}\n[estimation."{name}"]\nvalue = 3.0\nbudget = 2\n')
    run = [
        "run",
        "mine.toml",
        "--only",
        "--json",
        "--estimator",
        name,
        "--set",
        "scenario.stop_time=0.2",
        *EARLY_CHANGE,
        LATE_TRIGGER,
    ]
    for settings, value in (([], 3.0), (["--set", f'estimation."{name}".value=2.5'], 2.5)):
        code, out, err = called(*run, *settings)
        assert (code, err) == (0, "")
        result = json.loads(out)
        assert (result["estimator"], result["evaluations"] > 0) == (name, True)
        assert [p["estimated"] for p in result["parameters"]] == [value, 1.5]
    code, out, err = called("replay", result["run"], "--estimator", name, "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["runs"][0]["parameters"] == result["parameters"]


@pytest.mark.full
def test_an_estimator_of_ones_own_may_have_defaults_and_need_the_linear_form(called, own, workplace):
    name = f"{own}:Linear"
    command = ["--only", "--json", "--estimator", name, "--set", "scenario.stop_time=0.2", *EARLY_CHANGE, LATE_TRIGGER]
    for settings, value in (([], 4.0), (["--set", f'estimation."{name}".value=2.5'], 2.5)):
        code, out, err = called("run", "pendulum", *command, *settings)
        assert (code, err) == (0, "")
        result = json.loads(out)
        assert [p["estimated"] for p in result["parameters"]] == [value, 0.5]
        assert result["episodes"] == result["evaluations"] > 1  # a budget of one
    (workplace / "plain.toml").write_text(re.sub("linear = .*", "", PENDULUM))
    code, out, err = called("run", "plain.toml", *command, "--out", "out")
    assert (code, out) == (2, "")
    assert err == f"retune: estimator '{name}' needs estimation.linear, the model's linear form.\n"


@pytest.mark.full
def test_an_estimator_of_ones_own_is_compared(called, own):
    command = [
        "compare",
        "pendulum",
        "--seeds",
        "1",
        "--estimators",
        f"{own}:Asker",
        "--keep",
        "--json",
        "--out",
        "out",
    ]
    code, out, err = called(
        *command, "--set", "scenario.stop_time=0.2", "--set", "diagnosis.enabled=false", *EARLY_CHANGE
    )
    assert (code, err) == (0, "")
    run = json.loads(out)["runs"][-1]
    assert (run["estimator"], run["run"]) == (f"{own}:Asker", f"out/{own}.Asker-0")
    assert run["parameters"][0]["estimated"] == 2.0


@pytest.mark.parametrize(
    ("kind", "settings", "reason"),
    [
        ("Nobody", {}, "has no attribute 'Nobody'"),
        ("function", {}, "must be a class, got builtin_function_or_method"),
        ("Mute", {}, "must have is_whitened, restart and estimate, and ask and tell or solve"),
        ("Believer", {}, "must have is_whitened, restart and estimate, and ask and tell or solve"),
        ("Raises", {}, "cannot be made: RuntimeError: not today"),
        ("Asker", {"valu": "1.0"}, "has no setting 'valu'; did you mean 'value'"),
        ("Asker", {"value": "-1.0"}, "value must be positive, got -1.0"),
        ("Asker", {"value": "text"}, "value: must be a number"),
        ("Asker", {"budget": "0"}, "budget"),
    ],
)
def test_an_estimator_of_ones_own_that_is_wrong_is_told_in_one_line(called, own, workplace, kind, settings, reason):
    name = f"{own}:{kind}"
    sets = [part for k, v in settings.items() for part in ("--set", f'estimation."{name}".{k}={v}')]
    code, out, err = called(*SHORT, "--estimator", name, *sets, "--out", "out")
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert reason in err
    assert {p.name for p in workplace.iterdir()} <= {f"{own}.py", "__pycache__"}


@pytest.mark.full_but("Tires-RuntimeError: no more")
@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("Tires", "RuntimeError: no more"),
        ("Forgets", "RuntimeError: no more"),
        ("Deep", "RecursionError: maximum recursion depth exceeded"),
    ],
)
def test_an_estimator_that_raises_ends_the_run_with_its_rows_kept(called, own, workplace, kind, reason):
    command = ["run", "pendulum", "--only", "--estimator", f"{own}:{kind}", "--out", "out", *EARLY_CHANGE]
    code, _, err = called(*command, "--set", "scenario.stop_time=0.5", "--set", "estimation.budget=100")
    assert (code, len(err.splitlines())) == (1, 1)
    assert re.search(rf"estimator '{own}:{kind}' failed at t = 0\.\d+ s: {reason}", err)
    assert "rows up to 0." in err
    assert json.loads((workplace / "out" / "result.json").read_text())["status"] == "faulted"


# Runs that do not finish.


def test_a_diverged_run_is_told_in_one_line_with_exit_code_1(called, workplace):
    settings = ["--set", "limits.divergence=0.001", "--set", "scenario.stop_time=0.5", "--estimator", "none"]
    code, out, err = called(*SHORT, *EARLY_CHANGE, *settings, "--json", "--out", "mine")
    result = json.loads(out)
    assert (code, result["status"], result["run"]) == (1, "diverged", "mine")
    assert err.count("\n") == 1
    assert f"diverged at t = {result['diverged_at']:.3f} s" in err
    assert err.endswith("are in mine.\n")
    assert read_series(workplace / "mine")["time"][-1] == result["diverged_at"]


def test_a_faulted_run_is_told_in_one_line_with_exit_code_1(workplace, faulty_toml):
    arguments = ["--only", "--json", "--estimator", "none", "--set", "limits.divergence=10", "--out", "mine"]
    done = retune("run", faulty_toml, *arguments)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert done.stderr.startswith("retune: reference: do_step at t = 0.050 s returned fatal")
    assert "boom" in done.stderr
    assert done.stderr.endswith("; rows up to 0.050 s are in mine.\n")
    result = json.loads(done.stdout)
    assert result["status"] == "faulted"
    assert "boom" in result["error"]
    assert read_series(workplace / "mine")["time"].tolist() == [k * 0.01 for k in range(6)]


def test_a_change_that_ceases_to_have_a_value_is_a_fault_told_in_one_line(called, workplace):
    change = 'changes."plant.m"=1.75 if t < 0.045 else log(-t)'
    code, out, err = called(*SHORT, "--json", "--estimator", "none", "--set", change, "--out", "mine")
    assert (code, json.loads(out)["status"], err.count("\n")) == (1, "faulted", 1)
    assert 'changes."plant.m" has no value at t = 0.050 s: math domain error; rows up to 0.040 s are in mine.' in err
    assert read_series(workplace / "mine")["time"].tolist() == [k * 0.01 for k in range(5)]


def test_an_interrupt_before_the_first_row_promises_no_rows_and_leaves_no_folder(called, workplace, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("cosim.runs.simulation.open_slave", interrupted)
    code, out, err = called(*SHORT, "--out", "mine")
    assert (code, out, err.count("\n")) == (130, "", 1)
    assert "rows" not in err
    assert list(workplace.iterdir()) == []


def processes_of_session(session):
    found = set()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, _, its_session = (folder / "stat").read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue
        if int(its_session) == session and state != "Z":
            found.add(int(folder.name))
    return found


def is_far_enough(folder):
    path = folder / "series.arrow"
    return path.exists() and path.stat().st_size > 50_000


def start_endless(folder, becomes_true):
    arguments = ["run", "pendulum", "--only", "--estimator", "none", "--json", "--out", folder]
    process = subprocess.Popen(
        [RETUNE, *arguments, "--set", "scenario.stop_time=36000.0"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    assert becomes_true(lambda: is_far_enough(folder))
    assert len(processes_of_session(process.pid)) >= 4  # the command and three FMUs
    return process


@pytest.mark.full_but("SIGINT")
@pytest.mark.parametrize(
    ("send", "number"),
    [(os.kill, signal.SIGINT), (os.killpg, signal.SIGINT), (os.kill, signal.SIGTERM)],
    ids=["SIGINT", "Ctrl-C on a terminal", "SIGTERM"],
)
def test_an_interrupted_run_exits_130_with_its_rows_kept_and_no_process_left(workplace, becomes_true, send, number):
    folder = workplace / "mine"
    process = start_endless(folder, becomes_true)
    send(process.pid, number)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err.count("\n")) == (130, "", 1)
    assert "interrupted" in err
    assert json.loads((folder / "manifest.json").read_text())["status"] == "interrupted"
    times = read_series(folder)["time"]
    assert len(times) > 100
    np.testing.assert_array_equal(times, 0.01 * np.arange(len(times)))
    assert becomes_true(lambda: not processes_of_session(process.pid))


@pytest.mark.full
def test_two_signals_interrupt_a_run_as_one_does(workplace, leaves_nothing, becomes_true):
    process = start_endless(workplace / "mine", becomes_true)
    for _ in range(2):
        process.terminate()
        time.sleep(0.1)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err.count("\n")) == (130, "", 1)
    assert json.loads((workplace / "mine" / "manifest.json").read_text())["status"] == "interrupted"


def test_signals_are_handled_as_before_once_a_command_has_ended(called, workplace):
    names = (signal.SIGINT, signal.SIGTERM)
    before = [signal.getsignal(n) for n in names]
    assert called("--help")[0] == 0
    assert [signal.getsignal(n) for n in names] == before


def test_a_killed_run_leaves_readable_rows_and_no_process(workplace, leaves_nothing, becomes_true):
    folder = workplace / "mine"
    process = start_endless(folder, becomes_true)
    process.kill()
    process.communicate(timeout=60)
    times = read_series(folder)["time"]
    assert len(times) > 100
    np.testing.assert_array_equal(times, 0.01 * np.arange(len(times)))
    assert json.loads((folder / "manifest.json").read_text())["status"] == "running"
    assert becomes_true(lambda: not processes_of_session(process.pid))
    remove_abandoned(str(leaves_nothing))  # as the next start does: nobody was left to clear up


# Building.


@pytest.mark.full
def test_build_builds_all_and_then_leaves_them_unchanged(called, workplace):
    code, out, err = called("build", "--out", "fmus")
    assert (code, err) == (0, "")
    assert out.splitlines()[:-1] == [f"fmus/{name}.fmu  built" for name in NAMES]
    assert out.splitlines()[-1] == f"next: retune info fmus/{NAMES[-1]}.fmu"
    assert len(NAMES) == 20
    before = {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in (workplace / "fmus").iterdir()}
    assert {p.name for p in before} == {f"{name}.fmu" for name in NAMES}
    assert all(zipfile.is_zipfile(p) for p in before)
    code, out, err = called("build", "--out", "fmus")
    assert (code, err) == (0, "")
    assert out.splitlines()[:-1] == [f"fmus/{name}.fmu  unchanged" for name in NAMES]
    assert {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in (workplace / "fmus").iterdir()} == before


@pytest.mark.full
@pytest.mark.parametrize(
    ("options", "names", "interface"),
    [(["--fmi", "3"], NAMES, "coSimulation"), (["--model-exchange"], PLANTS, "modelExchange")],
    ids=["co-simulation", "model exchange"],
)
def test_build_makes_fmi_3(called, workplace, options, names, interface):
    code, out, err = called("build", "--out", "fmus", *options)
    assert (code, err) == (0, "")
    assert out.splitlines()[:-1] == [f"fmus/{name}.fmu  built" for name in names]
    for name in names:
        description = fmpy.read_model_description(str(workplace / "fmus" / f"{name}.fmu"))
        assert description.fmiVersion == "3.0"
        assert getattr(description, interface).modelIdentifier == name


@pytest.mark.full
def test_a_named_scenario_runs_on_fmi_3_and_is_read_back(called, workplace):
    """Its folder holds the names that the FMUs have, and `replay` finds them there; the model is an FMU."""
    settings = ("scenario.stop_time=0.1", "components.plant.fmi=3", "estimation.model=Quadrotor")
    code, _, err = called("run", "quadrotor", "--only", "--out", "run", *(o for s in settings for o in ("--set", s)))
    assert (code, err) == (0, "")
    header = (workplace / "run" / "series.csv").read_text().splitlines()[0]
    assert "plant.R[1,2]" in header
    code, out, err = called("replay", "run", "--estimator", "least-squares", "--out", "again")
    assert (code, err) == (0, "")
    assert "least-squares" in out


@pytest.mark.full
def test_build_replaces_a_different_file_only_when_forced(called, workplace):
    fmus = workplace / "fmus"
    fmus.mkdir()
    (fmus / "Quadrotor.fmu").write_text("mine")
    code, out, err = called("build", "--out", "fmus")
    assert (code, out, err) == (
        2,
        "",
        "retune: fmus/Quadrotor.fmu exists and differs; give --force or another --out.\n",
    )
    assert [(p.name, p.read_text()) for p in fmus.iterdir()] == [("Quadrotor.fmu", "mine")]
    code, out, err = called("build", "--out", "fmus", "--force")
    assert (code, err) == (0, "")
    assert [line for line in out.splitlines()[:-1] if not line.endswith("  built")] == ["fmus/Quadrotor.fmu  replaced"]
    assert zipfile.is_zipfile(fmus / "Quadrotor.fmu")
    assert len(list(fmus.iterdir())) == 20


def test_build_on_a_full_disk_keeps_the_file_that_it_was_to_replace(tmp_path, monkeypatch):
    def _builder(folder):
        (folder / "X.fmu").write_text("new")
        return {"X": folder / "X.fmu"}

    def _full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    fmus = tmp_path / "fmus"
    fmus.mkdir()
    (fmus / "X.fmu").write_text("mine")
    monkeypatch.setattr("os.fsync", _full)
    with pytest.raises(FolderError, match=r"X.fmu: No space left on device"):
        build_into(fmus, True, _builder)
    assert [(path.name, path.read_text()) for path in fmus.iterdir()] == [("X.fmu", "mine")]


# Output that nobody reads.


@pytest.mark.full
def test_a_reader_that_has_gone_is_no_traceback(workplace):
    process = subprocess.Popen([RETUNE, *SHORT, "--estimator", "none"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    err = process.stderr.read().decode()
    process.stderr.close()
    process.wait(timeout=60)
    assert "Traceback" not in err
    assert "BrokenPipe" not in err


def shell(command, **environment):
    """What the shell makes of it, with the streams of Python as they are for a user."""
    others = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    return subprocess.run(
        ["sh", "-c", command.replace("retune", str(RETUNE))], capture_output=True, text=True, timeout=120,
        env=others | environment, stdin=subprocess.DEVNULL,
    )  # fmt: skip


@pytest.mark.full
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no device that is always full")
@pytest.mark.parametrize("environment", [{}, {"PYTHONUNBUFFERED": "1"}], ids=["buffered", "unbuffered"])
def test_output_for_which_there_is_no_room_is_told_and_the_run_is_there(workplace, environment):
    done = shell(f"{shlex.join(['retune', *SHORT])} --out r > /dev/full", **environment)
    assert (done.returncode, done.stderr) == (1, "retune: cannot write its output: No space left on device\n")
    assert read_run(Path("r")).status == "done"


@pytest.mark.full
def test_output_without_the_characters_that_it_needs_is_escaped(workplace):
    done = shell(f"{shlex.join(['retune', *SHORT])} --out l\u00e4uft", PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "")
    assert "run folder l\\xe4uft" in done.stdout


@pytest.mark.full_but("refusal")
@pytest.mark.parametrize(
    ("command", "code"), [(shlex.join(["retune", *SHORT]), 0), ("retune check none.fmu", 2)], ids=["run", "refusal"]
)
def test_a_closed_standard_error_is_no_error(workplace, command, code):
    done = shell(f"{command} 2>&-")
    assert (done.returncode, bool(done.stdout), done.stderr) == (code, not code, "")
