"""The wheel and the sdist: what the package page shows, and a run from an environment that knows no clone."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

import cosim

ROOT = Path(__file__).parents[1]
LOOSE = ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "MANIFEST.in")

pytestmark = [pytest.mark.full, pytest.mark.fmu]


def called(*command, **options):
    """The output of a command that must succeed."""
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=600, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A folder with sdist and wheel, made of copies: a build leaves files beside its sources."""
    source, built = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("built")
    for name in LOOSE:
        shutil.copy(ROOT / name, source)
    for name in ("cosim", "estimator", "fmu_models"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    called(sys.executable, "-m", "build", "--outdir", built, source)
    return built


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory):
    """The scripts of an environment with the wheel in it, and what it depends on from this environment."""
    folder = tmp_path_factory.mktemp("environment")
    called(sys.executable, "-m", "venv", folder)
    scripts = folder / ("Scripts" if os.name == "nt" else "bin")
    paths = called(scripts / "python", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))")
    # Folders that a .pth file names are searched, but their own .pth files, the clone's among them, are not read.
    ours = dict.fromkeys(sysconfig.get_path(name) for name in ("purelib", "platlib"))
    (Path(paths.strip()) / "dependencies.pth").write_text("\n".join(ours) + "\n")
    (wheel,) = built.glob("*.whl")
    called(scripts / "python", "-m", "pip", "install", "--quiet", "--no-deps", "--ignore-installed", wheel)
    return scripts


@pytest.fixture
def clean(tmp_path):
    """Options of a command that is called elsewhere, with nothing of this environment, and a cache of its own."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
    work = tmp_path / "work"
    work.mkdir()
    return {"cwd": work, "env": environment | {"FMU_RETUNE_CACHE": str(tmp_path / "cache")}}


def test_the_package_index_takes_both(built):
    output = called(sys.executable, "-m", "twine", "check", "--strict", *built.iterdir())
    assert output.count("PASSED") == 2


def test_both_hold_every_file_that_is_beside_a_module(built):
    sources = {
        path.relative_to(ROOT).as_posix()
        for package in ("cosim", "estimator", "fmu_models")
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    with zipfile.ZipFile(*built.glob("*.whl")) as wheel, tarfile.open(*built.glob("*.tar.gz")) as sdist:
        in_sdist = {name.partition("/")[2] for name in sdist.getnames()}
        assert sources <= set(wheel.namelist())
        assert sources | set(LOOSE) <= in_sdist


def test_a_scenario_runs_from_the_wheel(installed, clean):
    assert called(installed / "retune", "--version", **clean) == f"fmu-retune {cosim.__version__}\n"
    where = called(installed / "python", "-c", "import cosim, estimator; print(cosim.__file__)", **clean)
    assert Path(where.strip()).is_relative_to(installed.parent)
    command = ["run", "pendulum", "--only", "--json", "--set", "scenario.stop_time=0.1"]
    assert json.loads(called(installed / "retune", *command, **clean))["status"] == "done"


def test_fmus_are_built_from_the_wheel_the_estimator_among_them(installed, clean):
    called(installed / "retune", "build", "--out", "fmus", **clean)
    called(installed / "retune", "build", "--out", "fmus", "--estimator", "pendulum", **clean)
    assert "PendulumEstimator.fmu" in {path.name for path in (clean["cwd"] / "fmus").iterdir()}
