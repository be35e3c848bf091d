"""The loop that is simulated ahead, in one process for all its FMUs: contained as an FMU alone is."""

import subprocess
import sys
from contextlib import closing

import pytest

from cosim.errors import ScenarioError, SlaveError, WiringError
from cosim.fmi.folder import PrivateFolder
from cosim.system.loop_plan import LoopPlan, fit_together, listed
from cosim.system.loop_process import LoopProcess
from cosim.system.master import Wiring
from cosim.system.shadow_loop import Course

COURSE = Course([0.01 * k for k in range(10)], 0.01, {}, {}, 1e9)


def plan_of(fmu, folder, start=(), outputs=("y", "limited"), timeout=20.0):
    wiring = {"reference": listed(Wiring({}, (), outputs, dict(start)))}
    tracked = [(f"reference.{outputs[0]}", f"reference.{outputs[-1]}")]
    return LoopPlan(
        "simulated ahead", folder, {"reference": str(fmu)}, {"reference": None}, wiring, [["reference"]], tracked,
        (0.0, 1.0), timeout, "fault", {},
    )  # fmt: skip


@pytest.mark.full_but("crash", "hang")
@pytest.mark.parametrize(
    ("how", "where", "timeout", "told"),
    [
        ("segfault", "do_step", 20.0, r"^simulated ahead: the FMU's process was ended by SIGSEGV"),
        ("exit 0", "do_step", 20.0, r"^simulated ahead: the FMU's process ended with exit code 0"),
        ("loop", "do_step", 1.0, r"^simulated ahead: peak did not return within 1 s"),
        ("error", "do_step", 20.0, r"^reference \(simulated ahead\): do_step at t = 0\.020 s returned error"),
        ("nan", "do_step", 20.0, r"^reference \(simulated ahead\): get at t = 0\.030 s: .*y"),
        ("out of range", "do_step", 20.0, r"^reference \(simulated ahead\): get at t = 0\.030 s: .*limited"),
    ],
    ids=["crash", "exit", "hang", "status", "output", "range"],
)
def test_a_fault_in_it_is_an_error_that_says_whose(native, how, where, timeout, told):
    with PrivateFolder() as folder:
        loop = LoopProcess(plan_of(native, folder, {"how": how, "where": where}, timeout=timeout))
        try:
            with pytest.raises(SlaveError, match=told):
                loop.peak(COURSE)
        finally:
            loop.close()


@pytest.mark.full
def test_what_cannot_be_opened_says_why(native, tmp_path):
    with PrivateFolder() as folder:
        missing, unwired = plan_of(tmp_path / "gone.fmu", folder), plan_of(native, folder, outputs=("y", "no_such"))
        told = r"the loop cannot be simulated ahead: .*gone\.fmu"
        with closing(LoopProcess(missing)) as loop, pytest.raises(ScenarioError, match=told):
            loop.prove()
        with closing(LoopProcess(unwired)) as loop, pytest.raises(WiringError, match="no_such"):
            loop.prove()


SLOW = """
import time
from pythonfmu import *
class Slow(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.y = 0.0
        self.register_variable(Real("y", causality=Fmi2Causality.output))
    def do_step(self, t, h):
        time.sleep(0.4)
        return True
"""


@pytest.mark.full
def test_the_time_limit_is_that_of_each_call_not_of_all_steps_together(tmp_path):
    script = tmp_path / "slow.py"
    script.write_text(SLOW)
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", script, "-d", tmp_path]
    subprocess.run(command, check=True, capture_output=True)
    with PrivateFolder() as folder:
        loop = LoopProcess(plan_of(tmp_path / "Slow.fmu", folder, outputs=("y",), timeout=2.0))
        try:
            assert loop.peak(COURSE) == 0.0
        finally:
            loop.close()


def test_fmus_that_ship_different_modules_of_one_name_do_not_share_a_process(tmp_path, archive):
    first = archive("first", {"resources/rule.py": "1", "binaries/linux64/first.so": "a"})
    second = archive("second", {"resources/rule.py": "2", "binaries/linux64/second.so": "b"})
    third = archive("third", {"resources/rule.py": "1", "binaries/linux64/third.so": "c", "resources/data.csv": "3"})
    fourth = archive("fourth", {"binaries/linux64/third.so": "d", "resources/data.csv": "4"})
    assert fit_together([first, third])
    assert not fit_together([first, second])
    assert fit_together([first, fourth])
    assert not fit_together([third, fourth])
    assert not fit_together([first, tmp_path / "gone.fmu"])


@pytest.fixture
def archive(tmp_path):
    """A function that writes a zip archive."""
    import zipfile

    def write(name, contents):
        path = tmp_path / f"{name}.fmu"
        with zipfile.ZipFile(path, "w") as file:
            for place, text in contents.items():
                file.writestr(place, text)
        return path

    return write
