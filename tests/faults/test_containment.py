"""Calls after a fault, values out of range, and the command's words for a run that faulted."""

import inspect
import json
import os
import re
import sys
import time
import zipfile
from importlib.resources import files
from pathlib import Path

import pytest

from cosim.commands import doctor
from cosim.errors import NotResumableError, SlaveError, StateTooLargeError
from cosim.fmi.archive import fmu_to_load, unpacked
from cosim.fmi.binding import LARGEST_STATE
from cosim.fmi.value_buffers import ScalarVariable
from cosim.runs.series import read_series
from cosim.scenarios.schema.simulation import ComponentSettings, SimulationSettings
from cosim.slaves.channel import CALL, LARGEST_MESSAGE, RESULT, encode
from cosim.slaves.host import InProcessFmu
from cosim.slaves.slave import open_slave
from cosim.slaves.supervision import supervised_process

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(sys.platform != "linux", reason="a library of Linux, and its /proc"),
]
H = 0.01  # s


def steps(slave, how, where, n=4, u=0.0):
    slave.bind(inputs=["u"], outputs=["y", "limited"])
    slave.initialize({"how": how, "where": where})
    return [slave.step([u], k * H, H) for k in range(n)]


@pytest.mark.parametrize("isolation", ["process", "none"])
def test_what_has_failed_is_not_called_again(faulty, tmp_path, monkeypatch, isolation):
    """Neither to terminate nor to be freed: it would note any call."""
    marker = tmp_path / "called"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHON_FAULT_MARKER", str(marker))
        slave = open_slave(faulty, "plant", isolation=isolation)
        slave.bind(inputs=["u"], outputs=["y"])
        slave.initialize({"how": "return False", "where": "do_step"})
        for k in range(2):
            slave.step([0.0], k * H, H)
        with pytest.raises(SlaveError, match="returned discard"):
            slave.step([0.0], 2 * H, H)
        slave.close()
        assert not marker.exists()


def test_an_fmu_that_is_called_after_its_fault_notes_it(faulty, tmp_path, monkeypatch):
    """So that the test before this one can fail."""
    marker = tmp_path / "called"
    monkeypatch.setenv("PYTHON_FAULT_MARKER", str(marker))
    description, folder = unpacked(faulty)
    fmu = InProcessFmu(fmu_to_load(description, folder.path, "plant"))
    numbers = {v.name: v.valueReference for v in description.modelVariables}
    start = [(name, "String", numbers[name], text) for name, text in (("how", "return False"), ("where", "exit_init"))]
    fmu.bind([], [], [ScalarVariable("y", "Real", numbers["y"])])
    fmu.call("initialize", 0.0, start, 0.0, None)
    fmu.call("get", 0.0)
    fmu.close(0.0, is_polite=True)
    folder.remove()
    assert marker.read_text() == "getterminate"


@pytest.mark.parametrize("isolation", ["process", "none"])
def test_what_strays_is_a_warning_where_that_is_wanted(native, caplog, isolation):
    with open_slave(native, "plant", isolation=isolation, out_of_range="warning") as slave:
        found = steps(slave, "out of range", "do_step", u=101.0)
    assert found == [(101.0, 0.0), (101.0, 0.0), (101.0, 11.0), (101.0, 11.0)]
    assert [r.getMessage() for r in caplog.records] == [
        "plant at t = 0.000 s: input 'u' must be within [-100, 100], got 101",
        "plant at t = 0.030 s: output 'limited' must be within [0, 10], got 11",
    ]


@pytest.mark.parametrize("how", ["nan", "inf"])
def test_what_is_not_finite_is_a_fault_even_so(native, how):
    message = f"^plant: get at t = 0.030 s: output 'y' is {how}$"
    with (
        open_slave(native, "plant", out_of_range="warning") as slave,
        pytest.raises(SlaveError, match=message),
    ):
        steps(slave, how, "do_step")


def test_a_scenario_can_set_what_a_slave_can_be_told():
    options = SimulationSettings(name="x", stop_time=1.0, macro_step=0.1).slave_options
    options["tolerance"] = ComponentSettings(fmu="x").tolerance
    parameters = dict(inspect.signature(open_slave).parameters)
    for name in ("after_call", "is_checked", "unpacked_in"):  # a function, and facts: no scenario gives them
        del parameters[name]
    assert options == {name: p.default for name, p in parameters.items() if p.kind is p.KEYWORD_ONLY}


KEPT = ("AWS_SECRET_ACCESS_KEY", "GITHUB_TOKEN", "SSH_AUTH_SOCK", "HTTPS_PROXY", "MY_LICENSE_KEY", "LC")
GIVEN = ("LC_ALL", "PYTHONPATH", "LD_LIBRARY_PATH", "TZ", "OMP_NUM_THREADS", "MLM_LICENSE_FILE")


@pytest.mark.parametrize(
    ("more", "expected"), [((), set()), (("GITHUB_TOKEN", "HTTP*"), {"GITHUB_TOKEN", "HTTPS_PROXY"})], ids=["", "more"]
)
def test_an_fmu_is_given_what_fmus_need_of_the_environment(faulty, monkeypatch, capfd, more, expected):
    for name in (*KEPT, *GIVEN):
        monkeypatch.setenv(name, os.environ.get(name, "1" if name == "OMP_NUM_THREADS" else ""))
    with open_slave(faulty, "plant", environment=more) as slave:
        slave.bind(inputs=["u"])
        slave.initialize({"how": "print environment", "where": "exit_init"})
    names = {line.removeprefix("plant: ") for line in capfd.readouterr().err.splitlines()}
    assert names >= {*GIVEN, "PATH"}
    assert names & {*KEPT} == expected


def environment_of(pid):
    """Lines NAME=value of a process's environment, which the kernel shows a moment after the process has begun."""
    for _ in range(1000):
        if text := Path(f"/proc/{pid}/environ").read_text(encoding="utf-8"):
            return text.split("\0")
        time.sleep(0.001)
    raise AssertionError(f"no environment of process {pid}")


@pytest.mark.parametrize(
    "settings",
    [
        {"estimation.model": "Pendulum", "guard.horizon": "3"},
        {"estimation.objective": "rollout", "sampling.outputs": '{"plant.phi" = {noise = 0.01}}'},
    ],
    ids=["model and lookahead", "rollout"],
)
@pytest.mark.full
def test_every_process_of_a_run_is_given_as_much(tmp_path, monkeypatch, command, settings):
    """The FMUs, a model-exchange FMU as the model, shadows that are simulated ahead, shadows for roll-outs."""
    given = []

    def started(*arguments):
        process = start(*arguments)
        given.append(environment_of(process.pid))
        return process

    start = supervised_process._start
    monkeypatch.setattr(supervised_process, "_start", started)
    monkeypatch.setenv("NEEDED", "1")
    monkeypatch.setenv("SECRET", "2")
    short = {
        "scenario.stop_time": "0.3",
        "scenario.environment": '["NEEDED"]',
        'changes."plant.m"': "[[0.0, 1.75], [0.05, 3.0]]",
    }
    overrides = [part for key, value in (short | settings).items() for part in ("--set", f"{key}={value}")]
    assert command("run", "pendulum", *overrides, "--only", "--out", tmp_path / "run")[0] == 0
    assert len(given) > 3
    assert all("NEEDED=1" in lines and "SECRET=2" not in lines for lines in given)


# The command.


@pytest.fixture
def scenario(native, tmp_path):
    """The pendulum, its reference played by the faulty FMU."""

    def write(how: str, where: str) -> Path:
        text = (files("cosim") / "scenarios" / "pendulum.toml").read_text(encoding="utf-8")
        old = next(line for line in text.splitlines() if line.startswith("reference = "))
        start = f"start = {{ how = {how!r}, where = {where!r} }}"
        text = text.replace(old, f"reference = {{ fmu = {str(native)!r}, {start} }}")
        text = text.replace("reference.phi_dot_ref", "reference.limited").replace("reference.phi_ref", "reference.y")
        path = tmp_path / "faulty.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.mark.full_but("crash", "exit", "initialization", "status")
@pytest.mark.parametrize(
    ("how", "where", "settings", "message"),
    [
        ("segfault", "do_step", (), r"reference: the FMU's process was ended by SIGSEGV in do_step at t = 0\.020 s"),
        ("exit 0", "do_step", (), r"reference: the FMU's process ended with exit code 0 in do_step at t = 0\.020 s"),
        ("loop", "do_step", ("timeout=4",), r"reference: do_step at t = 0\.020 s did not return within 4 s"),
        ("allocate", "do_step", ("memory_limit=400",), r"reference: the FMU's process took \d+ MB of memory, .*"),
        ("error", "exit_init", (), r"reference: exit_initialization_mode at t = 0\.000 s returned error"),
        (
            "log and fail",
            "do_step",
            (),
            r"reference: do_step at t = 0\.020 s returned error: step of 0\.01 s .*",
        ),
    ],
    ids=["crash", "exit", "hang", "memory", "initialization", "status"],
)
def test_a_run_that_faults_says_so_and_keeps_its_rows(scenario, command, tmp_path, how, where, settings, message):
    out = tmp_path / "out"
    more = [option for s in settings for option in ("--set", f"scenario.{s}")]
    code, printed, err = command("run", scenario(how, where), "--only", "--estimator", "none", "--out", out, *more)
    assert code == 1
    assert err.count("\n") == 1
    assert re.match(f"retune: .*{message}", err), err
    assert "Traceback" not in printed + err
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["status"] == "faulted"
    if where == "do_step":
        assert read_series(out)["time"].tolist() == [0.0, 0.01, 0.02]


def test_a_traceback_is_for_those_who_ask(tmp_path, command):
    path = tmp_path / "no.fmu"
    code, out, err = command("check", path)
    assert (code, out, err) == (2, "", f"retune: {path} cannot be read: No such file or directory\n")
    code, out, err = command("check", path, "--debug")
    assert (code, out) == (2, "")
    assert err.startswith("Traceback")
    assert err.endswith(f"retune: {path} cannot be read: No such file or directory\n")


def test_what_nobody_has_thought_of_is_one_line_and_no_success(command, monkeypatch):
    def fail(_):
        raise ZeroDivisionError("of\nours")

    monkeypatch.setattr(doctor, "command", fail)
    assert command("doctor", "x") == (1, "", "retune: ZeroDivisionError: of ours; --debug shows where\n")


def test_what_an_fmu_logs_is_shown_to_those_who_ask(native, caplog):
    with caplog.at_level("INFO"), open_slave(native, "plant") as slave, pytest.raises(SlaveError):
        steps(slave, "log and fail", "do_step")
    (record,) = (r for r in caplog.records if "too long" in r.getMessage())
    assert (record.levelname, record.getMessage()) == ("INFO", "plant: step of 0.01 s is too long")


# A state that is too large.


@pytest.fixture
def saving(native, tmp_path):
    """The native FMU, declared to save its state, which has 300 MB."""
    path = tmp_path / "Saving.fmu"
    with zipfile.ZipFile(native) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            declared = b'canGetAndSetFMUstate="true" canSerializeFMUstate="true" canHandleVariable'
            new.writestr(name, old.read(name).replace(b"canHandleVariable", declared))
    return path


@pytest.mark.parametrize("isolation", ["process", "none"])
def test_a_state_that_is_too_large_is_not_saved_and_the_fmu_goes_on(saving, isolation):
    with open_slave(saving, "plant", isolation=isolation) as slave:
        slave.bind(inputs=["u"], outputs=["y"])
        slave.initialize({})
        with pytest.raises(
            StateTooLargeError,
            match=r"^plant: get_state at t = 0.000 s: the state has 300000000 bytes; at most 268431360 can be saved$",
        ):
            slave.get_state()
        with pytest.raises(NotResumableError, match=r"^Saving.fmu: the state has 300000000 bytes"):
            slave.to_checkpoint()
        assert slave.step([3.0], 0.0, 0.01) == (3.0,)


def test_the_largest_state_fits_into_a_message():
    empty = bytes(0)
    assert LARGEST_STATE + len(encode(RESULT, None, empty)) < LARGEST_MESSAGE
    assert LARGEST_STATE + len(encode(CALL, ["set_state", ()], empty)) < LARGEST_MESSAGE
