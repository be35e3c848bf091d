"""The oracles and the FMUs, shared by the tests of the models."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import fmu_models
from fmu_models import build
from tests.fmu_models import oracles as checks

KINDS = {2: (2, "CoSimulation"), 3: (3, "CoSimulation"), "me": (3, "ModelExchange")}


@pytest.fixture(scope="session")
def oracles():
    """Comparisons of a module of the physics with an independent truth; each raises AssertionError."""
    return checks


def build_every_kind(folder):
    for kind, how in KINDS.items():
        build.build_all(folder / str(kind), *how)


@pytest.fixture(scope="session")
def built(made_once):
    """Paths of all FMUs, by FMI version or "me", and name."""
    folder = made_once(build_every_kind, "every kind", Path(fmu_models.__file__).parent)
    return {kind: {path.stem: str(path) for path in (folder / str(kind)).glob("*.fmu")} for kind in KINDS}


@pytest.fixture(scope="session")
def host():
    """host(task, ...): what a task of fmu_host.py returned in an interpreter without site-packages."""

    def run(task, **arguments):
        script = Path(__file__).with_name("fmu_host.py")
        command = [sys.executable, "-I", "-S", str(script), task, json.dumps(arguments)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run
