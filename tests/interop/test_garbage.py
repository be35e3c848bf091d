"""FMUs in Python in an importer that fills every result with garbage first: which does a call leave unwritten?"""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import pytest
from find_libpython import find_libpython

from fmu_models.build import PLANTS, build

LIBPYTHON = find_libpython() if sys.platform == "linux" else None
QUIET_END = {"GLIBC_TUNABLES": "glibc.malloc.tcache_count=65535"}  # see docs/commands.md
pytestmark = [
    pytest.mark.interop,
    pytest.mark.fmu,
    pytest.mark.skipif(sys.platform != "linux", reason="LD_PRELOAD is Linux's"),
    pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler: gcc is not installed"),
    pytest.mark.skipif(LIBPYTHON is None, reason="this Python was built without a shared library"),
]

NOT_PASSED_ON = {"fmi3DoStep eventHandlingNeeded", "fmi3DoStep earlyReturn"}
"""What pythonfmu3 0.3.4's library never writes, whatever a model returns: see docs/interop.md."""


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    path = tmp_path_factory.mktemp("garbage") / "garbage"
    source = Path(__file__).with_name("garbage.c")
    subprocess.run(["gcc", "-Wall", "-Werror", "-o", path, source, "-ldl"], check=True)
    return path


def unwritten(program, fmu, kind, folder):
    """The results that the FMU has left as garbage, each as function and argument."""
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder)
    description = fmpy.read_model_description(fmu)
    part = description.coSimulation or description.modelExchange
    place = "linux64" if kind == "cs2" else "x86_64-linux"
    resources = (folder / "resources").as_uri() if kind == "cs2" else f"{folder / 'resources'}/"
    scalars = [v for v in description.modelVariables if not v.shape]
    last = {v.type: v for v in scalars}.values()  # one of each type, the outputs being last
    command = [program, kind, folder / "binaries" / place / f"{part.modelIdentifier}.so", description.guid, resources]
    done = subprocess.run(
        [*map(str, command), *(word for v in last for word in (v.type, str(v.valueReference)))],
        capture_output=True, text=True, timeout=60, env=os.environ | {"LD_PRELOAD": LIBPYTHON} | QUIET_END,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return set(done.stdout.splitlines())


@pytest.mark.full
@pytest.mark.parametrize("name", PLANTS)
def test_model_exchange_writes_every_result(program, tmp_path, name):
    """An importer goes on calling fmi3UpdateDiscreteStates for as long as discreteStatesNeedUpdate is true."""
    fmu = build(name, tmp_path, 3, "ModelExchange")
    assert unwritten(program, fmu, "me3", tmp_path / "unpacked") == set()


@pytest.mark.full
@pytest.mark.parametrize("name", ["Pendulum", "PendulumReference", "PendulumControllerAdaptive"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_co_simulation_writes_every_result_that_its_library_passes_on(program, tmp_path, name, fmi):
    fmu = build(name, tmp_path, fmi)
    assert unwritten(program, fmu, f"cs{fmi}", tmp_path / "unpacked") == (NOT_PASSED_ON if fmi == 3 else set())
