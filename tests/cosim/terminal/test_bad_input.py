"""What is wrong with a user's files: one line from each command that it concerns, or a warning that says what is done.

And nothing that the user has is altered.
"""

import hashlib
import re
import shutil
from pathlib import Path

import pytest

from benchmarks.native_fmus import FOREIGN

pytestmark = [pytest.mark.fmu, pytest.mark.usefixtures("workplace")]
STEPS = "time [s], s_ref [m], v_ref [m/s]\n0, 0, 0\n0.1, 1, 0.5\n0.1, 1, 0\n0.2, 1, 0\n"
FMUS = ["--plant", "Axis.fmu", "--controller", "AxisController.fmu", "--reference", "steps.csv"]


@pytest.fixture
def files(foreign, workplace, called):
    """The files of a sound scenario, which `retune new` wrote, and a sound log; files(name, (pattern, text))
    damages one."""
    for fmu in ("Axis.fmu", "AxisController.fmu", "Axis-ME.fmu"):
        (workplace / fmu).write_bytes((foreign / fmu).read_bytes())
    (workplace / "steps.csv").write_text(STEPS)
    shutil.copy(FOREIGN / "axis_model.py", workplace / "plant_model.py")
    assert called("new", *FMUS, "-o", "axis.toml")[0] == 0
    text = (workplace / "axis.toml").read_text()
    text = text[: text.rindex("[[estimation.parameters]]")]  # the stiffness
    (workplace / "axis.toml").write_text(text.replace('# "plant.mass.m" = ', '"plant.mass.m" = '))
    rows = [f"{k / 100},{1 if k % 40 < 20 else -1},{(k % 7) / 100}" for k in range(100)]
    (workplace / "log.csv").write_text("\n".join(["time [s],force [N],s [m]", *rows, ""]))

    def damage(name, *replacements):
        path = workplace / name
        text = path.read_text()
        for pattern, new in replacements:
            text, n = re.subn(pattern, new, text, count=1, flags=re.M)
            assert n, pattern
        path.write_text(text)

    return damage


RUN, CHECK, NEW = ["run", "axis.toml", "--only"], ["check", "axis.toml"], ["new", *FMUS, "-o", "new.toml"]
ESTIMATE = [
    "estimate", "Axis.fmu", "log.csv", "--parameter", "mass.m=0.5:20", "--input", "f=force", "--measured", "mass.s=s",
    "--evaluations", "6", "--jobs", "1",
]  # fmt: skip


def hashes():
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in Path().glob("*.*")}


def with_parameter(text):
    return [*ESTIMATE[:4], text, *ESTIMATE[5:]]


SOUND = {"new": NEW, "check": CHECK, "run": RUN, "estimate": ESTIMATE}
CASES = {
    # damage to a file, commands and what each tells
    "a unit of another dimension": [
        ("steps.csv", [(r"s_ref \[m\]", "s_ref [kg]")], {
            "check": (CHECK, 2, r"connections.\"controller.sRef\": error: .*'kg' cannot be converted to 'm'"),
            "run": (RUN, 2, r"'kg' cannot be converted to 'm'")}),
        ("log.csv", [(r"s \[m\]", "s [kg]")], {"estimate": (ESTIMATE, 2, "'kg' cannot be converted to 'm'")}),
    ],
    "a unit of another scale": [
        ("steps.csv", [(r"s_ref \[m\]", "s_ref [mm]")], {
            "check": (CHECK, 2, "mm"), "run": (RUN, 2, "mm")}),
    ],
    "a unit that nobody knows": [
        ("steps.csv", [(r"s_ref \[m\]", "s_ref [smoot]")], {
            "check": (CHECK, 2, "'smoot'"), "run": (RUN, 2, "'smoot'")}),
        ("log.csv", [(r"s \[m\]", "s [smoot]")], {"estimate": (ESTIMATE, 2, "'smoot' is not defined")}),
    ],
    "a column that is missing": [
        ("steps.csv", [("s_ref", "other")], {
            "check": (CHECK, 2, "no variable 's_ref' in steps.csv"),
            "run": (RUN, 2, "'reference.s_ref' is no output of reference; did you mean 'v_ref'")}),
        ("log.csv", [("force", "forse")], {"estimate": (ESTIMATE, 2, "no column 'force'; did you mean 'forse'")}),
    ],
    "no time": [
        ("steps.csv", [(r"^time \[s\], ", "when [kg], ")], dict.fromkeys(("new", "check", "run"), (None, 2, "time"))),
        ("log.csv", [("time", "when")], {"estimate": (ESTIMATE, 2, "no column 'time' or 't'; give --time COLUMN")}),
    ],
    "a gap": [
        ("steps.csv", [("^0.1, 1, 0.5", "0.1, , 0.5")], dict.fromkeys(("new", "check", "run"), (None, 2, "steps.csv"))),
        ("log.csv", [("^0.5,.*", "0.5,,")], {
            "estimate": (ESTIMATE, 0, "warning: log.csv: gaps split it into 2 windows")}),
        ("log.csv", [("^0.5,(.*),.*", r"0.5,\1,")], {"estimate": (ESTIMATE, 0, "fitted to 75 of 100 rows")}),
    ],
    "not a number": [
        ("steps.csv", [("^0.1, 1, 0.5", "0.1, nan, 0.5")],
            dict.fromkeys(("new", "check", "run"), (None, 2, "steps.csv"))),
        ("log.csv", [("^0.5,.*,", "0.5,oops,")], {"estimate": (ESTIMATE, 2, "'force' must hold numbers, got 'oops'")}),
    ],
    "time goes back": [
        ("steps.csv", [("^0.2, ", "0.05, ")], dict.fromkeys(("new", "check", "run"), (None, 2, "steps.csv"))),
        ("log.csv", [("^0.5,", "0.3,")], {"estimate": (ESTIMATE, 2, "time must not go back")}),
    ],
    "a time stamp again": [  # a jump, as the table has one already
        ("steps.csv", [("^0.2, ", "0.1, ")], {"check": (CHECK, 0, "warning: its rows cover 0 to 0.1 s")}),
        ("log.csv", [("^0.5,", "0.49,")], {"estimate": (ESTIMATE, 0, "warning: log.csv: 1 repeated time stamps")}),
    ],
    "a parameter that there is not": [
        ("axis.toml", [('writes = "controller.m"', 'writes = "controller.mm"')], {
            "check": (CHECK, 2, "no variable 'mm' in AxisController.fmu; did you mean 'm'"),
            "run": (RUN, 2, "no variable 'mm' in controller; did you mean 'm'")}),
        (None, [], {
            "estimate": (with_parameter("mass.n=1:2"), 2, "no variable 'mass.n' in Axis.fmu; did you mean 'mass")}),
    ],
    "a parameter that is fixed": [
        ("axis.toml", [('unit = "kg"', 'unit = "N.s/m"'),
                       ('writes = "controller.m"', 'writes = "controller.d"'),
                       ('true = "plant.mass.m"', 'true = "plant.damper.d"')], {
            "check": (CHECK, 2, "'d' of AxisController.fmu is a fixed parameter, not a tunable parameter"),
            "run": (RUN, 2, "'d' of AxisController.fmu is a fixed parameter, not a tunable parameter")}),
        ("axis.toml", [('"plant.mass.m" = ', '"plant.damper.d" = ')], {
            "check": (CHECK, 2, "'damper.d' of Axis.fmu is a fixed parameter, not a tunable parameter"),
            "run": (RUN, 2, "'damper.d' of Axis.fmu is a fixed parameter, not a tunable parameter")}),
    ],
    "a capability that is missing": [
        ("axis.toml", [("plant_model:derivative", "AxisController.fmu")], {
            "check": (CHECK, 2, "not FMI 2.0 or 3.0 model-exchange"),
            "run": (RUN, 2, "not FMI 2.0 or 3.0 model-exchange")}),
        ("axis.toml", [(r"plant.der\(mass.v\)", "plant.mass.v")], {
            "check": (CHECK, 2, "'mass.v' is not declared as a state's derivative"),
            "run": (RUN, 2, "mass.v")}),
    ],
}  # fmt: skip
ROWS = {
    f"{what}: {file or 'options'}, {command}" + (f" {i}" if i else ""): (
        file,
        damage,
        told[0] or SOUND[command],
        *told[1:],
    )
    for what, group in CASES.items()
    for i, (file, damage, commands) in enumerate(group)
    for command, told in commands.items()
}


def test_the_undamaged_files_are_well(files, called):
    for command in SOUND.values():
        code, out, err = called(*command)
        assert code == 0, out + err


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("file", "damage", "command", "code", "told"), ROWS.values(), ids=ROWS)
def test_it_is_told_in_one_line(files, called, file, damage, command, code, told):
    if file:
        files(file, *damage)
    before = hashes()
    found, out, err = called(*command)
    assert found == code, (out, err)
    if code == 0:
        assert re.search(told, out)
    elif command[0] == "check" and not err:
        assert sum(bool(re.search(told, line)) for line in out.splitlines()) >= 1, out
    else:
        assert (out, err.count("\n"), err[:8]) == ("", 1, "retune: "), (out, err)
        assert re.search(told, err), err
    after = hashes()
    assert {name: after[name] for name in before} == before
    assert not Path("new.toml").exists()
