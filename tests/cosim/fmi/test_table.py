"""Tables as components: what is read, what is played, what is refused."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.errors import ScenarioError, SspError, WiringError
from cosim.fmi.component import read_component
from cosim.fmi.table import TableSlave, read_table
from cosim.runs.result import read_run
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario
from cosim.ssp.write import to_ssp

HOLD = "time [s], phi_ref [rad], phi_dot_ref [rad/s]\n0, {0!r}, 0\n10, {0!r}, 0\n".format(math.pi / 3)


def written(folder, text, name="table.csv"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_names_units_and_rows_are_read_in_the_files_order(tmp_path):
    table = read_table(written(tmp_path, '# logged\ntime [s], "phi_ref [rad]", n\n\n0, 1, 2\n# later\n2.5, -1e-3, 4\n'))
    assert (table.times, table.rows) == ((0.0, 2.5), ((1.0, 2.0), (-1e-3, 4.0)))
    assert list(table.units.items()) == [("phi_ref", "rad"), ("n", None)]


@pytest.mark.parametrize("separator", [",", ";", "\t"], ids=["comma", "semicolon", "tab"])
def test_what_separates_is_found(tmp_path, separator):
    text = "\n".join(separator.join(row) for row in (("\ufefft", "a [m]", "b"), ("0", "1", "2"), ("1", "3", "4")))
    assert read_table(written(tmp_path, text)).rows == ((1.0, 2.0), (3.0, 4.0))


@given(t=st.floats(-5.0, 15.0))
def test_values_between_rows_are_those_of_numpy(t, tmp_path_factory):
    times, values = [0.0, 0.5, 2.0, 9.0], [1.0, -1.0, 4.0, 0.25]
    text = "t,x\n" + "".join(f"{a!r},{b!r}\n" for a, b in zip(times, values, strict=True))
    table = read_table(written(tmp_path_factory.mktemp("t"), text))
    assert table.at(t)[0] == pytest.approx(np.interp(t, times, values), rel=1e-12, abs=1e-12)  # holds at both ends


def test_a_time_that_comes_twice_is_a_jump_at_its_communication_point(tmp_path):
    slave = TableSlave(written(tmp_path, "t,x\n0,0\n0.3,0\n0.3,1\n1,1\n"), "reference")
    slave.bind(outputs=["x"])
    slave.initialize({})
    seen = [slave.get()]
    for k in range(5):
        slave.begin_step([], k * 0.1, 0.1)  # 0.2 + 0.1 is past 0.3, 0.1 + 0.2 might be short of it elsewhere
        seen.append(slave.end_step())
    assert [x for (x,) in seen] == [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    slave.begin_step([], 0.25, 0.05 - 1e-13)
    assert slave.end_step() == (1.0,)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must have a header and at least one row"),
        ("time [s], x\n", "must have a header and at least one row"),
        ("time [ms], x\n0, 1\n", r"the first column must be 'time \[s\]', got 'time \[ms\]'"),
        ("phi, x\n0, 1\n", "the first column must be"),
        ("t, x, x\n0, 1, 2\n", "must have a name of its own, got x, x"),
        ("t\n0\n", "there is no column beside the time"),
        ("t, x\n0, 1\n1\n", "line 3: must have 2 numbers, got 1"),
        ("t, x\n0, 1\n1, one\n", "line 3, column 'x': must be a number, got 'one'."),
        ("t, x\n0, 1\n1, 1_0\n", "line 3, column 'x': must be a number, got '1_0'."),
        ("t; x\n0,5; 1\n", "line 2, column 't': must be a number, got '0,5'; numbers have a decimal point."),
        ("t, x\n# a gap\n0, nan\n", "line 3, column 'x': every number must be finite, got nan"),
        ("t, x\n0, 1\n2, 1\n1, 1\n", "line 4: time must not go back, got 1 s"),
        ('t, "x\n0, 1\n', None),
    ],
)
def test_a_bad_file_is_refused_with_its_line(tmp_path, text, message):
    path = written(tmp_path, text)
    if message is None:  # a quote that stays open takes no rows with it
        assert list(read_table(path).units) == ["x"]
        return
    with pytest.raises(ScenarioError, match=message) as caught:
        read_table(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_no_text_is_refused(tmp_path):
    (tmp_path / "table.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match="it is not UTF-8"):
        read_table(tmp_path / "table.csv")
    with pytest.raises(ScenarioError, match="No such file"):
        read_table(tmp_path / "none.csv")


def test_a_table_is_a_component_with_outputs_only(tmp_path):
    path = written(tmp_path, HOLD)
    component = read_component(path)
    assert [(v.name, v.causality, float(v.start)) for v in component.variables.values()] == [
        ("phi_ref", "output", math.pi / 3),
        ("phi_dot_ref", "output", 0.0),
    ]
    assert component.unit("phi_dot_ref").name == "rad/s"
    slave = TableSlave(path, "reference")
    with pytest.raises(WiringError, match=r"'phi_ref' of table\.csv is an output, not an input"):
        slave.bind(inputs=["phi_ref"])
    with pytest.raises(WiringError, match="takes no start values"):
        slave.initialize({"phi_ref": 1.0})


@pytest.fixture
def with_table(tmp_path, pendulum):
    """The named pendulum with its reference played from a table that says the same."""
    written(tmp_path, HOLD)
    scenario = pendulum({"components.reference": '{ table = "table.csv" }'})
    return scenario.model_copy(update={"folder": tmp_path})


@pytest.mark.full
@pytest.mark.fmu
def test_a_run_on_a_table_is_that_on_the_fmu_which_says_the_same(with_table, pendulum, tmp_path):
    out = tmp_path / "run"
    out.mkdir()
    ours, theirs = run(with_table, out=out), run(pendulum())
    for name in ("plant.phi", "controller.u", "controller.m", "reference.phi_ref"):
        np.testing.assert_array_equal(ours[name], theirs[name])
    assert read_run(out).scenario == ours.scenario


@pytest.mark.fmu
def test_a_system_with_a_table_is_no_ssp_package(with_table):
    with pytest.raises(SspError, match="component 'reference' is a table"):
        to_ssp(with_table)


@pytest.mark.parametrize(
    ("component", "message"),
    [
        ('{ fmu = "A.fmu", table = "a.csv" }', "either 'fmu' or 'table'"),
        ("{ }", "either 'fmu' or 'table'"),
        ('{ table = "a.csv", start = { x = 1.0 } }', "a table takes no start values"),
        ('{ table = "a.csv", tolerance = 1e-6 }', "a table takes no start values, and no tolerance"),
        ('{ table = "a.xlsx" }', "components.reference.table: string should match"),
    ],
)
def test_a_component_is_an_fmu_or_a_table(component, message):
    with pytest.raises(ScenarioError, match=message):
        Scenario.load("pendulum", {"components.reference": component})


def test_a_missing_table_is_named(with_table, tmp_path):
    (tmp_path / "table.csv").unlink()
    with pytest.raises(ScenarioError, match=r"no table 'table.csv': .* is not a file"):
        run(with_table)
