"""Files of strangers that are large, deep or many: they are read in seconds, or refused in one line."""

import os
import shutil
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import fmpy
import pytest

from cosim.system import package_cache
from cosim.system.package_cache import unpacked_package

pytestmark = [pytest.mark.fmu, pytest.mark.skipif(sys.platform != "linux", reason="libraries and locks of Linux")]
N = 20_000
"""Variables: what compares each with each takes longer than any test may."""
KINDS = (
    'causality="output" initial="exact"><Real start="0"/>',
    'causality="local"><Real derivative="{}"/>',
    'causality="parameter" variability="tunable"><Real start="1" min="0" max="2"/>',
    'causality="input"><Real start="0"/>',
)
SCENARIO = """
[scenario]
name = "large"
stop_time = 0.02
macro_step = 0.01
[components]
plant = { fmu = "Native.fmu" }
controller = { fmu = "Native.fmu" }
[connections]
"controller.v3" = "plant.v0"
"plant.v3" = "controller.v0"
[tracking]
"plant.v0" = "controller.v4"
[sampling.derivatives]
"plant.v1" = { noise = 1e-3 }
[sampling.states]
"plant.v0" = { noise = 1e-3 }
[estimation]
model = "fmu_models.pendulum:derivative"
trigger = { kind = "innovation" }
budget = 10
window = 10
[[estimation.parameters]]
name = "v2"
lower = 0.1
upper = 1.9
unit = "1"
writes = "controller.v2"
"""


@pytest.fixture(scope="module")
def large(compiled, tmp_path_factory) -> Path:
    """An FMU of N variables: outputs that are states, their derivatives, parameters and inputs in turn."""
    path = tmp_path_factory.mktemp("large") / "Native.fmu"
    texts = [KINDS[i % 4].format(i) for i in range(N)]
    variables = "".join(
        f'<ScalarVariable name="v{i}" valueReference="{i}" {text}</ScalarVariable>' for i, text in enumerate(texts)
    )
    outputs = "".join(f'<Unknown index="{i + 1}"/>' for i in range(0, N, 4))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as fmu:
        fmu.writestr(
            "modelDescription.xml",
            '<fmiModelDescription fmiVersion="2.0" modelName="Large" guid="1"><CoSimulation modelIdentifier="Native"/>'
            f"<ModelVariables>{variables}</ModelVariables>"
            f"<ModelStructure><Outputs>{outputs}</Outputs></ModelStructure></fmiModelDescription>",
        )
        fmu.writestr(f"binaries/{fmpy.platform}/Native{fmpy.sharedLibraryExtension}", compiled())
    return path


@pytest.mark.full
@pytest.mark.parametrize(
    "arguments", [["info"], ["check"], ["doctor"], ["new", "-o", "large.toml", "--plant"]], ids=lambda a: a[0]
)
def test_many_variables_are_read(large, command, arguments):
    code, out, err = command(*arguments, large)
    assert (code, err) == (0, "")
    assert str(N // 4) in out or arguments[0] != "info"
    Path("large.toml").unlink(missing_ok=True)


@pytest.mark.full
def test_a_scenario_of_many_variables_is_checked(large, tmp_path, command):
    (tmp_path / "large.toml").write_text(SCENARIO)
    shutil.copy(large, tmp_path)
    code, out, err = command("check", tmp_path / "large.toml")
    assert (code, err) == (2, "")
    assert "the model takes every state" not in out
    assert "algebraic loop" in out


@pytest.mark.full
def test_too_many_names_to_compare_are_refused(large, tmp_path, command):
    arguments = ("new", "--plant", large, "--controller", large, "-o", tmp_path / "new.toml")
    message = "retune: there are too many inputs and outputs to guess which belong together: 50000000 pairs.\n"
    assert command(*arguments) == (2, "", message)


# Packages.


def package(path: Path, system: str, fmu: Path | None = None) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(
            "SystemStructure.ssd",
            '<SystemStructureDescription xmlns="http://ssp-standard.org/SSP1/SystemStructureDescription" version="1.0" '
            f'name="s"><System name="top">{system}</System><DefaultExperiment stopTime="0.1"/>'
            "</SystemStructureDescription>",
        )
        if fmu is not None:
            archive.write(fmu, "resources/Native.fmu")
    return path


def components(n: int) -> str:
    one = '<Component name="c{}" source="resources/Native.fmu"/>'
    return f"<Elements>{''.join(one.format(i) for i in range(n))}</Elements>"


def nested(n: int) -> str:
    return '<Elements><System name="s">' * n + components(1) + "</System></Elements>" * n


STEP = ("--set", "scenario.macro_step=0.05")


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (nested(5000), "{}: SystemStructure.ssd: systems are nested more than 100 deep."),
        (components(1001), "{}: SystemStructure.ssd: it has more than 1000 systems and components."),
        (components(65), "s: it has 65 FMUs, each in a process of its own, and scenario.most_components is 64: "
                         "give --set scenario.most_components=65."),
    ],
    ids=["nested", "elements", "components"],
)  # fmt: skip
def test_a_package_of_too_much_is_refused(tmp_path, native, command, system, message):
    path = package(tmp_path / "much.ssp", system, native)
    assert command("run", path, *STEP) == (2, "", f"retune: {message.format(path)}\n")


def test_as_many_components_run_as_are_asked_for(tmp_path, native, command):
    path = package(tmp_path / "three.ssp", components(3), native)
    fewer, more = ("--set", "scenario.most_components=2"), ("--set", "scenario.most_components=3")
    code, _, err = command("run", path, *STEP, *fewer)
    assert (code, "it has 3 FMUs" in err) == (2, True)
    assert command("run", path, *STEP, *more, "--out", tmp_path / "run")[0] == 0


def test_a_scenario_has_the_same_limit(tmp_path, command):
    others = "".join(f'[components.c{i}]\nfmu = "Pendulum"\n' for i in range(64))
    (tmp_path / "many.toml").write_text(f"{SCENARIO}{others}")
    code, out, err = command("check", tmp_path / "many.toml")
    assert (code, err) == (2, "")
    assert "scenario: error: it has 66 FMUs" in out


# The cache of unpacked packages.


@pytest.fixture
def cached(tmp_path, monkeypatch):
    """A cache of this test's own, and the names of the packages in it."""
    monkeypatch.setenv("FMU_RETUNE_CACHE", str(tmp_path / "cache"))
    return lambda: sorted(path.name for path in (tmp_path / "cache" / "ssp").glob("*"))


@pytest.mark.parametrize(
    "system", [nested(101), "<Elements/>", components(1)], ids=["too deep", "no components", "no FMU"]
)
def test_a_refused_package_is_not_kept(tmp_path, cached, command, system):
    path = package(tmp_path / "refused.ssp", system)
    assert command("run", path)[0] == 2
    assert command("check", path)[0] == 2
    assert cached() == []


HOLDING = """
import sys
from pathlib import Path
from cosim.system.package_cache import unpacked_package
print(unpacked_package(Path(sys.argv[1])).name, flush=True)
sys.stdin.read()
"""


def aged(folder: Path, days: float) -> Path:
    when = time.time() - 86400.0 * days
    os.utime(folder, (when, when))
    return folder


@pytest.mark.full
def test_those_used_longest_ago_go_and_none_that_is_in_use(tmp_path, cached, monkeypatch):
    """Two of five packages may stay, and the oldest, which another process has read."""
    monkeypatch.setattr(package_cache, "MOST_PACKAGES", 2)
    paths = [package(tmp_path / f"{i}.ssp", components(i)) for i in range(5)]
    with subprocess.Popen(
        [sys.executable, "-c", HOLDING, paths[0]], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        cache = tmp_path / "cache" / "ssp"
        used = cache / other.stdout.readline().strip()
        aged(used, 9.0)
        left = cache / ".unpacking-left"
        left.mkdir()
        names = []
        for i, path in enumerate(paths[1:4], start=1):
            done = subprocess.run([sys.executable, "-c", HOLDING, path], input="", capture_output=True, text=True)
            names.append(aged(cache / done.stdout.strip(), 9.0 - i).name)
        assert not left.exists()
        newest = unpacked_package(paths[4]).name
        assert set(cached()) == {used.name, names[2], newest}
        other.stdin.close()
    monkeypatch.setattr(package_cache, "MOST_BYTES", 0)
    unpacked_package(package(tmp_path / "6.ssp", components(6)))
    assert newest in cached()  # this process's own
    assert used.name not in cached()
