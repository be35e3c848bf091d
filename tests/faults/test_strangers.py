"""Files from strangers: their Python runs when it is asked for, and else leaves no trace."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from cosim import Scenario, load_scenario, read_run, resume, run
from cosim.campaigns.replay import replay
from cosim.errors import FolderError, ScenarioError
from cosim.plots.runs import draw_run
from cosim.runs.manifest import write_manifest
from cosim.runs.run_files import MANIFEST
from cosim.ssp.scenario import EXTRA
from cosim.ssp.write import to_ssp

pytestmark = [pytest.mark.fmu, pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")]
ROWS = tomllib.loads(Path(__file__).with_name("catalogue.toml").read_text(encoding="utf-8"))["strangers"]
EVIL = """
import os
open(os.environ["TRACE"], "a").close()
from fmu_models.pendulum import coefficients, derivative, regression

def residual(theta, samples):
    return [1.0]
"""
SHORT = {"scenario.stop_time": "0.3", 'changes."plant.m"': "[[0.0, 1.75], [0.1, 4.271]]"}
OF_MODEL = ROWS[0]["replace"]


@pytest.fixture
def trace(tmp_path, monkeypatch) -> Path:
    """A file that is there once a stranger's code has run."""
    path = tmp_path / "trace"
    monkeypatch.setenv("TRACE", str(path))
    loaded = set(sys.modules)
    yield path
    for name in set(sys.modules) - loaded:
        if name.partition(".")[0] in ("evil", "mine"):
            del sys.modules[name]


@pytest.fixture(scope="module")
def sound() -> bytes:
    """A package of the pendulum."""
    return to_ssp(Scenario.load("pendulum", SHORT))


@pytest.fixture
def package(sound, tmp_path):
    """package(old, new, modules): the package of a stranger's, whose scenario has `new` in place of `old`."""

    def make(old: str = "", new: str = "", modules: dict[str, str] | None = None) -> Path:
        path, original = tmp_path / "theirs.ssp", tmp_path / "sound.ssp"
        original.write_bytes(sound)
        with zipfile.ZipFile(original) as before, zipfile.ZipFile(path, "w") as after:
            for name in before.namelist():
                content = before.read(name)
                if name.endswith("scenario.toml") and old:
                    assert old in content.decode()
                    content = content.decode().replace(old, new).encode()
                after.writestr(name, content)
            for name, text in (modules or {"evil.py": EVIL}).items():
                after.writestr(f"{EXTRA}/{name}", text)
        return path

    return make


@pytest.mark.full_but("model", "objective", "what is ours, but no plant", "FMUs in our process")
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["fault"])
def test_what_a_package_asks_for_is_told_and_not_done(package, trace, command, tmp_path, row):
    modules = {"evil.py": EVIL} if "inner" not in row["asks"] else {"evil/__init__.py": EVIL, "evil/inner.py": EVIL}
    path, out = package(*row["replace"], modules), tmp_path / "out"
    Path("of_the_user.py").write_text(EVIL)
    line = f"retune: {path} would {row['asks']}, which only --trust allows: look at it first.\n"
    for words in (["run"], ["compare", "--seeds", 1], ["build", "--estimator"]):
        assert command(words[0], *words[1:], path, "--out", out) == (2, "", line)
    assert not out.exists()
    code, printed, err = command("check", path)
    assert (code, err) == (0, "")
    assert f"{path}: scenario: warning: it would {row['asks']}, which only --trust allows\n" in printed
    assert re.search(f"note: .*{row['notes']}", printed) if "notes" in row else "note: " not in printed
    assert command("export", path, "--ssp", tmp_path / "again.ssp")[0] == 0
    Path("of_the_user.py").unlink()
    assert not trace.exists()


def test_what_is_trusted_runs(package, trace, command, tmp_path):
    code, _, err = command("run", package(*OF_MODEL), "--only", "--trust", "--out", tmp_path / "out")
    assert (code, err, trace.exists()) == (0, "", True)


@pytest.mark.full
def test_in_python_it_is_asked_for_too(package, trace):
    path = package(*OF_MODEL)
    with pytest.raises(ScenarioError, match=r"would run Python code \(module evil\)"):
        run(load_scenario(path))
    assert not trace.exists()
    assert run(load_scenario(path, trust=True)).status == "done"


@pytest.mark.full_but(r"no\n-False")
@pytest.mark.parametrize(("answer", "is_run"), [("y\n", True), ("\n", False), ("no\n", False), ("\4", False)])
def test_on_a_terminal_it_is_asked_for(package, trace, tmp_path, answer, is_run):
    path, out = package(*OF_MODEL), tmp_path / "out"
    ours, theirs = os.openpty()
    words = [sys.executable, "-m", "cosim.cli", "run", path, "--only", "--out", out]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(words, stdin=theirs, stderr=theirs, stdout=subprocess.PIPE, env=environment) as process:
        os.close(theirs)
        asked = b""
        while b"[y/N] " not in asked:
            asked += os.read(ours, 1000)
        os.write(ours, answer.encode())
        process.communicate()
    os.close(ours)
    assert asked.decode().endswith(f"{path}: run Python code (module evil)? [y/N] ")
    assert (process.returncode, trace.exists(), out.exists()) == ((0, True, True) if is_run else (2, False, False))


@pytest.mark.full
def test_modules_of_a_package_hide_none_of_ours(package, trace, tmp_path):
    """Those that are loaded before a run and in it, in a fresh interpreter."""
    names = ("json", "numpy", "matplotlib", "GPy", "scipy", "tqdm", "fmu_models", "estimator", "pyarrow", "csv", "html")
    path = package(modules={f"{name}.py": EVIL for name in names})
    words = [sys.executable, "-P", "-m", "cosim.cli", "run", path, "--only", "--out", tmp_path / "out"]
    subprocess.run(words, check=True, capture_output=True, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
    assert not trace.exists()


@pytest.mark.full
def test_a_model_that_the_user_names_is_not_searched_for_in_the_package(package, trace, command, tmp_path):
    path = package(modules={"mine.py": EVIL})
    Path("mine.py").write_text("from fmu_models.pendulum import derivative\n")
    try:
        code, _, err = command(
            "run", path, "--only", "--set", "estimation.model=mine:derivative", "--out", tmp_path / "out"
        )
    finally:
        Path("mine.py").unlink()
        shutil.rmtree("__pycache__", ignore_errors=True)
    assert (code, err, trace.exists()) == (0, "", False)


class Stopped(Exception):
    """The run is left where it is, as when it is killed."""


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> Path:
    """Runs of the user's own, with a model beside the scenario: `done`, and `left` before its end."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "evil.py").write_text(EVIL)
    settings = SHORT | {"estimation.model": "evil:derivative", "scenario.checkpoint": "5"}
    scenario = Scenario.load("pendulum", settings).model_copy(update={"folder": folder})

    def stop(t, _):
        if t > 0.15:
            raise Stopped

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TRACE", str(folder / "trace"))
        run(scenario, "least-squares", 0, folder / "done")
        with pytest.raises(Stopped):
            run(scenario, "least-squares", 0, folder / "left", stop)
    del sys.modules["evil"]
    return folder


@pytest.fixture
def made(runs, tmp_path):
    """made("done" or "left"): a copy of such a run."""
    return lambda name="done": Path(shutil.copytree(runs / name, tmp_path / "run"))


def claimed(folder: Path, is_own: bool = False, **changes: object) -> None:
    """Make it a run that somebody else might have made, or wants to have made, of these settings of the estimation."""
    content = json.loads((folder / MANIFEST).read_text())
    content["scenario"]["estimation"] |= changes
    write_manifest(folder, content, is_own)


def test_a_run_of_the_users_own_is_replayed_and_resumed(made, trace, command):
    assert command("replay", made(), "--estimator", "least-squares")[0] == 0
    assert trace.exists()


@pytest.mark.full
def test_a_run_of_the_users_own_goes_on(made, trace, command):
    code, _, err = command("resume", made("left"))
    assert (code, err, trace.exists()) == (0, "", True)


@pytest.mark.parametrize("words", [["replay", "--estimator", "target"], ["resume"]], ids=["replay", "resume"])
def test_a_run_of_somebody_elses_runs_nothing_of_its_own(made, trace, command, words):
    folder = made("left" if words[0] == "resume" else "done")
    claimed(folder)
    before = {path: path.read_bytes() for path in folder.iterdir()}
    line = f"retune: {folder} would run Python code (module evil), which only --trust allows: look at it first.\n"
    assert command(*words, folder) == (2, "", line)
    assert not trace.exists()
    assert {path: path.read_bytes() for path in folder.iterdir()} == before
    assert command(*words, folder, "--trust")[0] == 0
    assert trace.exists()


def test_no_signature_of_another_key_or_content_is_taken(made, trace, command, monkeypatch, tmp_path):
    folder = made()
    words = ["replay", folder, "--estimator", "target"]
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another user"))
    assert command(*words)[0] == 2
    monkeypatch.undo()
    content = json.loads((folder / MANIFEST).read_text())
    signature = content["signature"]
    claimed(folder, model="evil.other:derivative")
    (folder / MANIFEST).write_text(
        (folder / MANIFEST).read_text().replace('"signature": ""', f'"signature": "{signature}"')
    )
    assert command(*words)[0] == 2
    assert not trace.exists()


@pytest.mark.parametrize("mode", [0o644, 0o660])
def test_a_key_that_others_may_know_is_none(made, trace, command, tmp_path, monkeypatch, mode):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    folder = made()
    words = ["replay", folder, "--estimator", "least-squares"]
    claimed(folder, is_own=True)
    assert command(*words)[::2] == (0, "")
    (key,) = (path for path in (tmp_path / "state").rglob("*") if path.is_file())
    assert key.stat().st_mode & 0o777 == 0o600
    key.chmod(mode)
    assert command(*words)[0] == 2


def test_where_no_key_can_be_kept_nothing_is_signed(made, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    folder = made()
    claimed(folder, is_own=True)
    assert json.loads((folder / MANIFEST).read_text())["signature"] == ""


def test_a_model_that_has_changed_since_is_not_the_one_of_the_run(made, runs, trace, command):
    folder, module = made(), runs / "evil.py"
    module.write_text(EVIL + "# new\n")
    code, out, err = command("replay", folder, "--estimator", "target")
    module.write_text(EVIL)
    assert (code, out) == (2, "")
    assert err == f"retune: estimation.model: {module} is not as it was in the run: only --trust runs it as it is.\n"
    assert not trace.exists()


def test_an_estimator_that_a_manifest_names_is_code_as_well(made, trace, command):
    folder = made("left")
    content = json.loads((folder / MANIFEST).read_text())
    content["scenario"]["estimation"]["model"] = "fmu_models.pendulum:derivative"
    write_manifest(folder, content | {"estimator": "evil:Estimator"}, is_own=False)
    with pytest.raises(ScenarioError, match=r"would run Python code \(module evil\)"):
        resume(folder)
    assert command("resume", folder)[0] == 2
    assert not trace.exists()


def test_the_runs_inside_a_run_are_asked_for_as_well(made, runs, trace, command):
    folder = made()
    shutil.copytree(runs / "left", folder / "none")
    claimed(folder / "none")
    code, out, err = command("resume", folder)
    assert (code, out) == (2, "")
    assert err.startswith(f"retune: {folder / 'none'} would run Python code (module evil)")
    assert not trace.exists()


@pytest.mark.full
def test_pictures_of_a_run_load_nothing_of_a_strangers(made, trace):
    folder = made()
    claimed(folder)
    assert draw_run(read_run(folder), {})
    assert not trace.exists()


@pytest.mark.full
@pytest.mark.parametrize("name", ["report", "plot"])
def test_a_report_runs_nothing_of_a_strangers_and_opens_no_file_that_it_names(made, trace, command, tmp_path, name):
    folder = made("left")
    content = json.loads((folder / MANIFEST).read_text())
    fifo = tmp_path / "Plant.fmu"
    os.mkfifo(fifo)  # whoever opens it waits for ever
    content["scenario"]["components"]["plant"]["fmu"] = str(fifo)
    write_manifest(folder, content | {"estimator": "evil:Estimator"}, is_own=False)
    out = tmp_path / "out.png" if name == "plot" else tmp_path / "out.html"
    assert command(name, folder, "-o", out)[::2] == (0, "")
    assert out.stat().st_size > 10_000
    assert not trace.exists()


@pytest.mark.full
def test_what_was_not_trusted_once_is_not_signed(package, trace, command, tmp_path):
    """A model of the user's own on a stranger's system does not make the stranger's linear form the user's."""
    out = tmp_path / "out"
    command("run", package(), "--only", "--out", out)
    assert json.loads((out / MANIFEST).read_text())["signature"] == ""
    claimed(out, linear={"rows": "evil:regression", "coefficients": "evil:coefficients"})
    with pytest.raises(ScenarioError, match="would run Python code"):
        replay(out, ["rls"])
    with pytest.raises((FolderError, ScenarioError)):
        resume(out)
    assert not trace.exists()


@pytest.mark.full
def test_a_manifest_that_is_replaced_while_the_run_goes_on_is_not_signed_at_its_end(tmp_path):
    """By an FMU, say, which may write in the run folder."""
    out = tmp_path / "out"

    def progress(t, _):
        if t > 0.15 and not json.loads((out / MANIFEST).read_text())["scenario"]["estimation"]["model"].startswith(
            "evil"
        ):
            claimed(out, model="evil:derivative")

    run(Scenario.load("pendulum", SHORT), "none", 0, out, progress)
    assert json.loads((out / MANIFEST).read_text())["signature"] == ""
    with pytest.raises(ScenarioError, match=r"would run Python code \(module evil\)"):
        replay(out, ["target"])


def test_a_run_that_has_recorded_no_modules_loads_none_from_where_the_command_works(made, trace, command, runs):
    folder = made()
    content = json.loads((folder / MANIFEST).read_text())
    (elsewhere := runs / "elsewhere").mkdir(exist_ok=True)
    write_manifest(folder, content | {"modules": {}, "folder": str(elsewhere)}, is_own=True)
    Path("evil.py").write_text(EVIL)
    code, _, err = command("replay", folder, "--estimator", "target")
    Path("evil.py").unlink()
    assert (code, trace.exists()) == (2, False)
    assert "cannot load 'evil:derivative'" in err


def test_an_estimator_fmu_ships_the_users_model_and_not_its_namesake_in_the_package(package, trace, command, tmp_path):
    path = package(modules={"mine.py": EVIL})
    Path("mine.py").write_text("from fmu_models.pendulum import derivative\n")
    try:
        words = ["build", "--estimator", path, "--set", "estimation.model=mine:derivative", "--out", tmp_path / "fmus"]
        code, _, err = command(*words)
        assert command("export", path, *words[3:5], "--ssp", tmp_path / "again.ssp")[0] == 0
    finally:
        Path("mine.py").unlink()
        shutil.rmtree("__pycache__", ignore_errors=True)
    assert (code, err, trace.exists()) == (0, "", False)
    for made in ("fmus/PendulumEstimator.fmu", "again.ssp"):
        with zipfile.ZipFile(tmp_path / made) as archive:
            contents = {name: archive.read(name) for name in archive.namelist()}
        assert any("mine" in name for name in contents)
        assert not any(b"TRACE" in content for content in contents.values())
