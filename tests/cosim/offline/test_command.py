"""`retune estimate` from the command line."""

import json
import re
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from cosim.cli import main
from cosim.offline.estimate_file import with_file
from cosim.offline.estimate_options import request_of
from cosim.offline.logs import LogError
from cosim.offline.request import Request, Sought
from cosim.offline.understood import understand
from cosim.ssv.document import read_ssv
from cosim.terminal.options import make_parser

pytestmark = pytest.mark.fmu
SOUGHT = ["--parameter", "m=0.5:4", "--parameter", "c=0.05:5:log", "--parameter", "k=5:60:log"]
ROLES = ["--input", "F=force", "--measured", "x=x", "--measured", "v=v"]


@pytest.fixture
def log(tmp_path, oracles):
    return oracles.write_log(tmp_path / "log.csv", oracles.measure(0))


@pytest.fixture
def command(plant, log, monkeypatch, tmp_path):
    """command(*options): the exit code of `retune estimate` on the log, in an empty folder."""
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    return lambda *options, log=log: main(["estimate", str(plant), str(log), *options])


def test_what_it_prints_and_writes(command, oracles, capsys, tmp_path):
    ssv = tmp_path / "mine.ssv"
    assert command(*SOUGHT, *ROLES, "--evaluations", "40", "--ssv", str(ssv)) == 0
    printed = capsys.readouterr().out
    assert "fitted to 601 of 801 rows, 200 held out" in printed
    assert "Each parameter is identifiable." in printed
    assert "written to runs/Plant-estimate-1" in printed
    folder = tmp_path / "work" / "runs" / "Plant-estimate-1"
    assert {p.name for p in folder.iterdir()} == {
        "estimate.json", "estimates.ssv", "candidates.csv", "fit.csv", "fit.png"
    }  # fmt: skip
    content = json.loads((folder / "estimate.json").read_text())
    for parameter in read_ssv(ssv).values:
        told = content["parameters"][parameter.name]
        assert abs(parameter.value - getattr(oracles.TRUTH, parameter.name)) < 4.0 * told["std"]
        assert parameter.unit == told["unit"]
    assert ssv.read_text() == (folder / "estimates.ssv").read_text()
    series = np.genfromtxt(folder / "fit.csv", delimiter=",", names=True, deletechars="")
    assert np.sqrt(np.mean((series["x_after"] - series["x_measured"]) ** 2)) == pytest.approx(2e-3, rel=0.1)
    assert matplotlib.image.imread(folder / "fit.png").std() > 0.05


def test_the_fit_is_on_disk_before_the_report_is_made(command, monkeypatch, tmp_path):
    """Whatever the report stumbles over, hours of roll-outs are not lost."""

    def stumbles(*_):
        raise ValueError("not enough values to unpack")

    monkeypatch.setattr("cosim.offline.fit_report.findings", stumbles)
    assert command(*SOUGHT, *ROLES, "--evaluations", "10") == 1
    folder = tmp_path / "work" / "runs" / "Plant-estimate-1"
    numbers = json.loads((folder / "estimate.json").read_text())["parameters"]
    assert {p.name: p.value for p in read_ssv(folder / "estimates.ssv").values} == {
        name: p["value"] for name, p in numbers.items()
    }
    assert {"candidates.csv", "fit.csv"} <= {p.name for p in folder.iterdir()}


@pytest.mark.full
def test_profiles_decide_and_are_drawn(command, oracles, capsys, tmp_path):
    """Swinging freely, the plant shows k/m and c/m only."""
    log = oracles.write_log(tmp_path / "free.csv", oracles.measure(0, force=lambda t: 0.0 * t))
    sought = ["--parameter", "m=0.85:3.4:log", "--parameter", "c=0.3:3:log", "--parameter", "k=8:60:log"]
    assert command(*sought, *ROLES, "--evaluations", "20", "--holdout", "0", "--profile", log=log) == 0
    printed = capsys.readouterr().out
    assert "m is not identifiable: its profile is flat, the others make up for any value." in printed
    assert "Each parameter is identifiable" not in printed
    folder = tmp_path / "work" / "runs" / "Plant-estimate-1"
    assert re.search(r"k is not identifiable: 95 % by its profile, 1\d\.\d* to 4\d\.\d*, is set not by the", printed)
    parameters = json.loads((folder / "estimate.json").read_text())["parameters"]
    m = parameters["m"]
    assert m["is_identifiable"] is False
    assert parameters["k"]["profile"]["lower_set_by"] == parameters["k"]["profile"]["upper_set_by"] == ["m"]
    assert "its lower end by the bound of m and its upper end by the bound of m" in printed
    assert (m["profile"]["lower"], m["profile"]["upper"]) == (None, None)
    assert (m["profile"]["values"][0], m["profile"]["values"][-1]) == pytest.approx((0.85, 3.4))
    assert max(m["profile"]["rise"]) < 1.0
    assert matplotlib.image.imread(folder / "profiles.png").std() > 0.05
    assert command(*SOUGHT, *ROLES, "--evaluations", "20", "--profile", "--json") == 0
    for name, told in json.loads(capsys.readouterr().out)["parameters"].items():
        assert told["is_identifiable"]
        assert told["profile"]["lower"] < told["value"] < told["profile"]["upper"]
        half = 1.96 * told["std"]
        assert told["profile"]["upper"] - told["profile"]["lower"] == pytest.approx(2.0 * half, rel=0.05)
        assert abs(told["value"] - getattr(oracles.TRUTH, name)) < 4.0 * told["std"]


def test_json_is_one_object(command, capsys):
    assert command(*SOUGHT, *ROLES, "--evaluations", "20", "--json") == 0
    assert json.loads(capsys.readouterr().out)["parameters"].keys() == {"m", "c", "k"}


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--parameter", "mass=1:2", *ROLES], "no variable 'mass' in Plant.fmu"),
        (["--parameter", "m=1", *ROLES], "must be NAME=LOW:HIGH or NAME=LOW:HIGH:log, got 'm=1'"),
        (["--parameter", "m=1:x", *ROLES], "must be a number, got 'x'"),
        (["--parameter", "m=2:1", *ROLES], "lower < upper"),
        (ROLES, "the following arguments are required: --parameter"),
        ([*SOUGHT, "--input", "F=force"], "the following arguments are required: --measured"),
        ([*SOUGHT, *ROLES, "--measured", "x=v"], "--measured x is given twice"),
        ([*SOUGHT, *ROLES, "--input", "F=farce"], "--input F is given twice"),
        ([*SOUGHT, "--measured", "x=y"], "no column 'y'"),
        ([*SOUGHT, *ROLES, "--window", "1"], "must be FROM:TO, got '1'"),
        ([*SOUGHT, *ROLES, "--noise", "x=-1"], "--noise x must be positive"),
        ([*SOUGHT, *ROLES, "--holdout", "1"], "--holdout must be from 0 to below 1"),
        ([*SOUGHT, *ROLES, "--profile", "--online"], "--profile is of a fit to the whole log, not --online"),
        ([*SOUGHT, *ROLES, "--loss", "hubert"], "no loss 'hubert'; there are linear, huber, soft_l1, cauchy"),
        ([*SOUGHT, *ROLES, "--loss", "huber", "--f-scale", "0"], "--f-scale must be positive"),
        ([*SOUGHT, *ROLES, "--f-scale", "2"], "goes with a --loss that is not linear"),
        ([*SOUGHT, *ROLES, "--loss", "huber", "--online"], "--loss is of a fit to the whole log, not --online"),
        ([*SOUGHT, *ROLES, "--method", "magic"], "no method 'magic' for a log"),
        ([*SOUGHT, *ROLES, "--evaluations", "0"], "must be 1 or more"),
        ([*SOUGHT, *ROLES, "--jobs", "257"], "--jobs must be from 1 to 256, got 257"),
        ([*SOUGHT, *ROLES, "--measured", "F=force"], "--measured 'F' is an input of Plant.fmu"),
        ([*SOUGHT, *ROLES, "--online", "--samples", "100000"], "--samples must be less than the"),
        ([*SOUGHT, *ROLES, "--seed", "-1"], "must be a whole number from 0 on"),
        ([*SOUGHT, *ROLES, "--ssv", "/nowhere/at/all.ssv"], "is in no folder that there is"),
    ],
)
def test_a_bad_command_is_refused_in_one_line(command, capsys, tmp_path, options, told):
    try:
        code = command(*options)
    except SystemExit as refused:  # by the parser
        code = refused.code
    error = capsys.readouterr().err
    assert (code, error.count("\n")) == (2, 1)
    assert told in error
    assert not (tmp_path / "work" / "runs").exists()


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda rows: rows[:5] + rows[3:], "time must not go back, as it does from 0.03 to 0.02 s after row 4"),
        (lambda rows: rows[:2], "must have two rows or more, got 1"),
        (lambda rows: [rows[0], *(f"2,{row.partition(',')[2]}" for row in rows[1:])], "time is 2 s in all rows"),
        (lambda rows: rows[1:], "must begin with a header"),
        (lambda rows: [row.replace("x [m]", "x [kg]") for row in rows], "'kg' cannot be converted to 'm'"),
        (lambda rows: [row.replace("x [m]", "x [smoot]") for row in rows], "'smoot' is not defined"),
        (lambda rows: [*rows[:9], "0.5,oops,1,1\n", *rows[9:]], "column 'force' must hold numbers, got 'oops'"),
        (lambda rows: [rows[0], *(f"{row.split(',')[0]},,1,1\n" for row in rows[1:])], "no two rows"),
        (lambda rows: [rows[0], *(f"{row.split(',')[0]},1,,1\n" for row in rows[1:])], "'x', measured for x, has no"),
        (lambda rows: [rows[0], *(f"{row.split(',')[0]},1,2,1\n" for row in rows[1:])], "never changes in the log"),
        (
            lambda rows: [rows[0], *(f"{row.split(',')[0]},1,,1\n" for row in rows[1:-9]), *rows[-9:]],
            "measured x has no value in the rows to fit to",
        ),
    ],
    ids=["back", "short", "still", "headless", "dimension", "unit", "text", "no-input", "no-output", "constant", "end"],
)
def test_a_bad_log_is_refused_in_one_line(command, log, capsys, damage, told):
    rows = log.read_text().splitlines(keepends=True)
    log.write_text("".join(damage(rows)))
    assert command(*SOUGHT, *ROLES) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert told in error


def test_a_plant_that_never_runs_is_exit_code_1(command, capsys):
    assert command(*SOUGHT, *ROLES, "--start", "c_limit=0.01", "--evaluations", "6") == 1
    error = capsys.readouterr().err
    assert error.startswith("retune: every roll-out failed, the first so: plant: do_step at t = 0.000 s returned error")
    assert error.count("\n") == 1


def test_a_folder_in_use_and_an_ssv_that_exists_are_left_alone(command, capsys, tmp_path):
    (tmp_path / "mine").mkdir()
    kept = tmp_path / "mine" / "kept.ssv"
    kept.write_text("dear")
    assert command(*SOUGHT, *ROLES, "--out", str(tmp_path / "mine")) == 2
    assert command(*SOUGHT, *ROLES, "--ssv", str(kept)) == 2
    assert [p.name for p in (tmp_path / "mine").iterdir()] == ["kept.ssv"]
    assert kept.read_text() == "dear"


def test_an_fmu_that_is_none(command, log, capsys, tmp_path):
    (tmp_path / "no.fmu").write_text("no")
    assert main(["estimate", str(tmp_path / "no.fmu"), str(log), *SOUGHT, *ROLES]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.full
def test_ctrl_c_ends_all_processes(plant, tmp_path, oracles):
    log = oracles.write_log(tmp_path / "long.csv", oracles.measure(0, end=60.0, h=0.001))
    command = [sys.executable, "-m", "cosim.cli", "estimate", str(plant), str(log), *SOUGHT, *ROLES, "--out", "out"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as process:
        while not (children := _children(process.pid)):
            assert process.poll() is None
        process.send_signal(2)
        error = process.communicate(timeout=60)[1]
    assert process.returncode == 130, error
    assert error.startswith("retune: interrupted; there is no estimate yet")
    assert error.count("\n") == 1
    assert not any(_is_running(child) for child in children)
    assert not (tmp_path / "out").exists()


def _children(process_id):
    """Ids of the processes of FMUs that it has started."""
    tasks = Path(f"/proc/{process_id}/task").glob("*/children")
    try:
        children = [int(child) for task in tasks for child in task.read_text().split()]
    except FileNotFoundError:  # a thread has ended meanwhile
        return _children(process_id)
    return [child for child in children if b"cosim.slaves.child" in _command_of(child)]


def _command_of(process_id):
    try:
        return Path(f"/proc/{process_id}/cmdline").read_bytes()
    except OSError:  # it has ended
        return b""


def _is_running(process_id):
    return Path(f"/proc/{process_id}").exists()


EXPERIMENTS = {
    "step": '<DefaultExperiment startTime="0" stopTime="10" stepSize="0.01"/>',
    "span": '<DefaultExperiment startTime="0" stopTime="10"/>',
}


def with_experiment(plant, path, experiment):
    with zipfile.ZipFile(plant) as whole, zipfile.ZipFile(path, "w") as changed:
        for name in whole.namelist():
            content = whole.read(name)
            if name == "modelDescription.xml":
                content = content.replace(b"<ModelVariables>", EXPERIMENTS[experiment].encode() + b"<ModelVariables>")
            changed.writestr(name, content)
    return path


def rescaled(oracles, path, factor, column="time [s]"):
    """A log whose time stamps are in another unit and do not say so; of another column: its values multiplied."""
    columns = {name.replace("time [s]", "time"): factor * v if name == column else v
               for name, v in oracles.measure(0).items()}  # fmt: skip
    return oracles.write_log(path, columns)


APART = {
    "ms": (1e3, "rows are 10 s apart, and Timed.fmu's step is 0.01 s"),
    "us": (1e6, "rows are 10000 s apart, and Timed.fmu's step is 0.01 s"),
    "h": (1 / 3600.0, "rows are 2.77778e-06 s apart, and Timed.fmu's step is 0.01 s"),
}


@pytest.mark.parametrize("mode", [[], ["--online"]], ids=["offline", "online"])
@pytest.mark.parametrize("unit", APART)
def test_time_stamps_in_another_unit_are_told(plant, oracles, tmp_path, monkeypatch, capsys, unit, mode):
    """Before, an FMU that takes fixed steps inside was simulated for hours, or days."""
    monkeypatch.chdir(tmp_path)
    factor, text = APART[unit]
    fmu = with_experiment(plant, tmp_path / "Timed.fmu", "step")
    log = rescaled(oracles, tmp_path / "log.csv", factor)
    assert main(["estimate", str(fmu), str(log), *SOUGHT, *ROLES, *mode]) == 2
    question = f"is its time in {unit}? Give --time-unit {unit}, or --time-unit s where it is right."
    assert capsys.readouterr().err == f"retune: log.csv: {text}: {question}\n"


def test_a_wrong_unit_in_the_header_is_told_with_the_right_one(plant, oracles, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    fmu = with_experiment(plant, tmp_path / "Timed.fmu", "step")
    columns = {name.replace("[s]", "[ms]"): values for name, values in oracles.measure(0).items()}
    log = oracles.write_log(tmp_path / "log.csv", columns)
    assert main(["estimate", str(fmu), str(log), *SOUGHT, *ROLES]) == 2
    told = capsys.readouterr().err
    assert told.endswith("is its time in s? Give --time-unit s, or --time-unit ms where it is right.\n")


@pytest.mark.parametrize("mode", [[], ["--online"]], ids=["offline", "online"])
def test_a_log_in_place_of_the_fmu_is_told(plant, oracles, tmp_path, monkeypatch, capsys, mode):
    monkeypatch.chdir(tmp_path)
    log = oracles.write_log(Path("log.csv"), oracles.measure(0))
    assert main(["estimate", str(log), str(plant), *SOUGHT, *ROLES, *mode]) == 2
    assert capsys.readouterr().err == "retune: log.csv is a table, not an FMU: the FMU comes first, then its logs.\n"


@pytest.mark.full
def test_a_step_that_passes_over_inputs_is_warned_of(command, capsys):
    for step, told in (("0.02", True), ("0.01", False)):
        assert command(*SOUGHT, *ROLES, "--step", step, "--evaluations", "1") == 0
        warning = "a --step of 0.02 s passes over inputs, which are 0.01 s apart: estimates may be biased."
        assert (warning in "".join(capsys.readouterr())) == told


@pytest.mark.parametrize("value", [np.inf, -np.inf])
def test_an_infinite_value_is_none_that_is_missing(plant, oracles, tmp_path, monkeypatch, capsys, value):
    monkeypatch.chdir(tmp_path)
    columns = oracles.measure(0)
    columns["x [m]"] = columns["x [m]"].copy()
    columns["x [m]"][5] = value
    log = oracles.write_log(tmp_path / "log.csv", columns)
    assert main(["estimate", str(plant), str(log), *SOUGHT, *ROLES]) == 2
    assert capsys.readouterr().err == f"retune: {log}: column 'x' for x has values up to inf: too large.\n"


@pytest.mark.parametrize(("unit", "n_warnings"), [("ms", 1), ("s", 0), (None, 0)])
def test_a_unit_that_is_not_that_of_the_heading_is_told(plant, oracles, tmp_path, unit, n_warnings):
    log = oracles.write_log(tmp_path / "log.csv", oracles.measure(0))
    roles = {"x": "x"}, {"F": "force"}
    found = understand(Request(plant, (log,), (Sought("m", 0.5, 4.0),), *roles, time_unit=unit))
    assert found.warnings == [f"{log}: its heading says that time is in s; --time-unit ms is used."] * n_warnings


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_the_unit_that_is_given_is_taken(plant, oracles, tmp_path, monkeypatch, capsys, experiment):
    monkeypatch.chdir(tmp_path)
    fmu = with_experiment(plant, tmp_path / "Timed.fmu", experiment)
    log = rescaled(oracles, tmp_path / "log.csv", 1e3)
    arguments = ["estimate", str(fmu), str(log), *SOUGHT, *ROLES, "--evaluations", "20", "--json"]
    assert main(arguments) == 2
    assert ("it is 8000 s long, and Timed.fmu's experiment 10 s" in capsys.readouterr().err) == (experiment == "span")
    assert main([*arguments, "--time-unit", "ms"]) == 0
    found = json.loads(capsys.readouterr().out)["parameters"]
    assert found["k"]["value"] == pytest.approx(oracles.TRUTH.k, rel=0.01)
    assert main([*arguments, "--time-unit", "fortnight"]) == 2
    assert "'fortnight' cannot be converted to 's'" in capsys.readouterr().err


@pytest.mark.parametrize("mode", [[], ["--online"]], ids=["offline", "online"])
def test_more_steps_than_anybody_waits_for_are_refused(command, capsys, mode):
    assert command(*SOUGHT, *ROLES, "--step", "1e-9", "--time-unit", "s", *mode) == 2
    told = capsys.readouterr().err
    assert told == "retune: log.csv: its 8 s are 8e+09 steps of 1e-09 s; at most 1e+07 are simulated.\n"


@pytest.mark.full
def test_what_cannot_be_computed_with_is_told_and_no_warning_of_numpys(plant, oracles, tmp_path):
    log = rescaled(oracles, tmp_path / "log.csv", 1e300, "x [m]")
    command = [sys.executable, "-m", "cosim.cli", "estimate", str(plant), str(log), *SOUGHT, *ROLES]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2
    assert re.fullmatch(
        r"retune: .*log\.csv: column 'x' for x has values up to [\d.]+e\+29\d: too large\.\n", done.stderr
    )


def test_nanoseconds_since_1970_are_told_and_counted_exactly(plant, oracles, tmp_path, monkeypatch, capsys):
    """A float holds them to 256 ns only. This FMU declares no experiment to compare with."""
    monkeypatch.chdir(tmp_path)
    rows = np.column_stack(list(oracles.measure(0, end=3.0).values())[1:]).tolist()
    lines = [f"{1_700_000_000_000_000_001 + 10_000_000 * k},{f!r},{x!r},{v!r}\n" for k, (f, x, v) in enumerate(rows)]
    Path("log.csv").write_text("stamp,force,x,v\n" + "".join(lines))
    arguments = ["estimate", str(plant), "log.csv", *SOUGHT, *ROLES, "--time", "stamp"]
    assert main(arguments) == 2
    assert capsys.readouterr().err == (
        "retune: log.csv: time begins at 1.7e+18: is it in ns since 1970, its rows 0.01 s apart? "
        "Give --time-unit ns, or --time-unit s where it is in seconds.\n"
    )
    request = Request(
        plant, (Path("log.csv"),), (Sought("m", 0.5, 4.0),), {"x": "x"}, {"F": "force"}, time="stamp", time_unit="ns"
    )
    (window,) = understand(replace(request, holdout=0.0)).windows
    assert window.time == pytest.approx(0.01 * np.arange(301), abs=1e-12)


def test_dates_are_in_seconds_whatever_unit_is_given(plant, tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("time,force,x\n" + "".join(f"2026-01-01 12:00:{k / 4:05.2f},1,0.{k}\n" for k in range(9)))
    request = Request(plant, (log,), (Sought("m", 0.5, 4.0),), {"x": "x"}, {"F": "force"}, time_unit="ms")
    with pytest.raises(LogError, match=r"log\.csv: time consists of dates, .* leave out --time-unit ms\.$"):
        understand(request)
    for unit in (None, "s"):
        (window,) = understand(replace(request, time_unit=unit)).windows
        assert window.time.tolist() == [k / 4 for k in range(9)]


@pytest.mark.parametrize(
    ("sought", "changes", "told"),
    [
        (["m"], {"windows": ((0.0, 2.0),)}, []),
        (["m"], {}, ["log.csv, 3 to 5 s: it does not begin with the log, and starts in the FMU's own start state."]),
        (["m"], {"start": {"v": 0.1}}, ["start state but for v, given or estimated."]),
        (["m", "x"], {}, ["start state but for x, given or estimated."]),
        (["m", "x"], {"start": {"v": "v"}, "windows": ((0.0, 2.0), (3.0, 5.0))}, ["2 windows start with the same"]),
        (["x"], {"start": {"v": "v"}, "own": ("x",)}, []),
    ],
    ids=["from-the-start", "own-state", "number", "estimated", "shared", "one-for-each-log"],
)
def test_the_states_that_windows_start_with_are_told(plant, log, sought, changes, told):
    parameters = tuple(Sought(name, 0.05, 4.0) for name in sought)
    request = Request(plant, (log,), parameters, {"x": "x"}, {"F": "force"}, windows=((3.0, 5.0),))
    warnings = understand(replace(request, **changes)).warnings
    assert [text in warning for text, warning in zip(told, warnings, strict=True)] == [True] * len(told)


def test_an_input_without_a_column_is_told(plant, log):
    request = Request(plant, (log,), (Sought("m", 0.5, 4.0),), {"x": "x"})
    (told,) = understand(request).warnings
    assert told == (
        "input 'F' of Plant.fmu has no column and stays 0 N: give --input F=COLUMN, or --start F=VALUE "
        "(columns not used: 'force', 'v')."
    )
    for said in ({"inputs": {"F": "force"}}, {"start": {"F": 0.0}}):
        assert understand(replace(request, **said)).warnings == []


@pytest.mark.full
def test_sensors_that_are_swapped_are_told(plant, oracles, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    columns = {name.split(" ")[0]: values for name, values in oracles.measure(0, end=4.0).items()}
    log = oracles.write_log(tmp_path / "log.csv", columns)
    common = ["estimate", str(plant), str(log), *SOUGHT, "--input", "F=force", "--evaluations", "20", "--json"]
    assert main([*common, "--measured", "x=v", "--measured", "v=x"]) == 0
    (told,) = json.loads(capsys.readouterr().out)["warnings"]
    assert told == "x and v would fit better with their columns exchanged: is it --measured x=x --measured v=v?"
    assert main([*common, "--measured", "x=x", "--measured", "v=v"]) == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == []


TOML = """
fmu = "{plant}"
logs = "log.csv"
evaluations = 10
[parameters]
m = [0.5, 4]
k = [5, 60.0, "log"]
[measured]
x = "x"
v = "v"
[inputs]
F = "force"
[start]
c = 0.9
"""


def test_a_file_says_what_the_command_line_would(plant, log, monkeypatch, tmp_path):
    """The log is beside the file, not in the working directory."""
    (tmp_path / "estimate.toml").write_text(TOML.format(plant=plant))
    common = ["--parameter", "m=0.5:4", "--parameter", "k=5:60:log", *ROLES, "--start", "c=0.9", "--evaluations", "10"]
    requests = [
        request_of(make_parser().parse_args(with_file(["estimate", *words, "--seed", "2"])))
        for words in ([str(plant), str(log), *common], [str(tmp_path / "estimate.toml")])
    ]
    assert requests[0] == requests[1]


def test_a_file_says_it_for_the_online_mode_too(plant, log, tmp_path):
    online = "evaluations = 10\nonline = true\nsamples = 20\nevaluations_per_sample = 10"
    (tmp_path / "estimate.toml").write_text(TOML.format(plant=plant).replace("evaluations = 10", online))
    options = make_parser().parse_args(with_file(["estimate", str(tmp_path / "estimate.toml")]))
    assert (options.online, options.samples, options.per_sample, options.evaluations) == (True, 20, 10, 10)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("logs =", "log =", "must have fmu ="),
        ("evaluations", "evaluation", "'evaluation' is no key; did you mean 'evaluations'"),
        ("= 10", "= true", "'evaluations' is of the wrong type"),
        ("= 10", "= ", "not a readable TOML file"),
        ("[0.5, 4]", "true", 'parameters.m must be [LOW, HIGH] or [LOW, HIGH, "log"], got True'),
        ("[0.5, 4]", "4", 'estimate.toml: parameters.m must be [LOW, HIGH] or [LOW, HIGH, "log"], got 4'),
        ('"x"', "true", "measured.x must be a number, a name or a list of them, got True"),
        ("= 10", "= -3", "estimate.toml: evaluations: must be a whole number from 0 on, got '-3'"),
        ("= 10", "= 10\nwindows = [5]", "estimate.toml: windows must be [FROM, TO], got 5"),
        ('[measured]\nx = "x"\nv = "v"', "", "estimate.toml: the following keys are required: measured"),
    ],
)
def test_a_bad_file_is_refused_in_one_line(plant, log, capsys, tmp_path, old, new, told):
    (tmp_path / "estimate.toml").write_text(TOML.format(plant=plant).replace(old, new))
    with pytest.raises(SystemExit, match="2"):
        main(["estimate", str(tmp_path / "estimate.toml")])
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert told in error


@pytest.mark.parametrize(
    ("line", "options", "told"),
    [
        ("step = -1.0", [], "estimate.toml: step must be positive"),
        ("windows = [[2, 1]]", [], "estimate.toml: windows must be FROM:TO"),
        ("samples = 5", [], "estimate.toml: samples must be 1 or more, and goes with --online"),
        ("samples = 0\nonline = true", [], "estimate.toml: samples must be 1 or more, and goes with online"),
        ("seed = 1", ["--step", "-1"], "retune: --step must be positive"),
        ("step = 0.1", ["--step", "-1"], "retune: --step must be positive"),
    ],
)
def test_the_files_part_is_told_by_its_key_and_the_command_lines_by_its_option(
    plant, log, capsys, tmp_path, line, options, told
):
    (tmp_path / "estimate.toml").write_text(f"{line}\n{TOML.format(plant=plant)}")
    assert main(["estimate", str(tmp_path / "estimate.toml"), *options]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert told in error


def test_a_wrong_option_beside_a_file_is_one_of_the_command_line(plant, log, capsys, tmp_path):
    (tmp_path / "estimate.toml").write_text(TOML.format(plant=plant))
    with pytest.raises(SystemExit, match="2"):
        main(["estimate", str(tmp_path / "estimate.toml"), "--seed", "x"])
    assert "argument --seed: must be a whole number" in capsys.readouterr().err
