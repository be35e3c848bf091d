"""Controllers with gains: what formulas give is written, read back, guarded, recorded and drawn like any parameter."""

import json
import re
from importlib.resources import files

import numpy as np
import pytest

from cosim import ScenarioError, read_run, resume, run
from cosim.authoring.check import check
from cosim.campaigns.replay import replayed
from cosim.cli import main
from cosim.plots.parameters import draw_parameters
from cosim.retuning.guard import Guard
from cosim.runs.report import report
from cosim.scenarios.scenario import Scenario
from cosim.ssv.document import read_ssv

pytestmark = [pytest.mark.fmu, pytest.mark.usefixtures("leaves_nothing")]

PENDULUM = (files("cosim") / "scenarios" / "pendulum.toml").read_text(encoding="utf-8")
SHORT = {
    "scenario.stop_time": "0.5",
    "scenario.isolation": '"none"',
    'changes."plant.m"': "[[0.0, 1.75], [0.1, 4.271]]",
    'changes."plant.l"': "[[0.0, 0.75], [0.1, 0.981]]",
}


@pytest.fixture
def gains(tmp_path):
    """gains(formulas of m, more of m, formulas of l, **overrides): the pendulum's scenario with formulas."""

    def load(m='"controller.m" = "m"', of_l=None, code="", **overrides):
        text = PENDULUM.replace('writes = "controller.m"', f"start = 1.75\nwrites = {{ {m} }}")
        if of_l is not None:
            text = text.replace('writes = "controller.l"', f"start = 0.75\nwrites = {{ {of_l} }}")
        path = tmp_path / "gains.toml"
        path.write_text(text, encoding="utf-8")
        (tmp_path / "gain_functions.py").write_text(code, encoding="utf-8")
        return Scenario.load(path, SHORT | overrides)

    return load


@pytest.mark.full
def test_formulas_that_give_the_parameters_themselves_make_the_same_run(gains, tmp_path):
    plain = run(Scenario.load("pendulum", SHORT), seed=3, out=tmp_path / "plain")
    formulas = gains('"controller.m" = "1*m"', '"controller.l" = "l + 0*m"')
    given = run(formulas, seed=3, out=tmp_path / "given")
    assert np.array_equal(plain["plant.phi"], given["plant.phi"])
    assert np.array_equal(plain["controller.m"], given["controller.m"])
    assert np.array_equal(plain.estimates["l"], given.estimates["l"])
    assert given.guard == plain.guard  # the loop is simulated ahead with the gains
    assert given.guard["rolled_ahead"] > 0
    written = {p.name: p.value for p in read_ssv(tmp_path / "given" / "estimates.ssv").values}
    assert written == {"controller.m": plain["controller.m"][-1], "controller.l": plain["controller.l"][-1]}


PLACE = """
def place(m, l):
    return 10.0 * m / 1.75, 5.0 * l / 0.75
"""
KP_KD = '"controller.Kp" = "gain_functions:place", "controller.m" = "m", "controller.Kd" = "gain_functions:place"'


@pytest.mark.full
def test_a_function_is_written_recorded_drawn_resumed_and_replayed(gains, tmp_path):
    scenario = gains(KP_KD, code=PLACE, **{"scenario.checkpoint": "15"})
    whole = run(scenario, seed=1, out=tmp_path / "whole")
    m, l = (whole.estimates[name] for name in "ml")
    assert m[-1] == pytest.approx(4.271, rel=0.01)
    assert np.allclose(whole["controller.Kp"], 10.0 * m / 1.75, rtol=1e-12)
    assert np.allclose(whole["controller.Kd"], 5.0 * l / 0.75, rtol=1e-12)
    assert np.array_equal(whole["controller.m"], m)
    units = {p.name: p.unit for p in read_ssv(tmp_path / "whole" / "estimates.ssv").values}
    assert units == {"controller.Kp": "1/s2", "controller.m": "kg", "controller.Kd": "1/s", "controller.l": "m"}

    events = [json.loads(line) for line in (tmp_path / "whole" / "events.jsonl").read_text().splitlines()]
    labels = [axes.get_ylabel() for axes in draw_parameters(whole, events).axes]
    assert labels == ["$m$ [kg]", "$l$ [m]", "Kp", "m", "Kd"]

    class Stopped(Exception):
        pass

    def stop(t, _):
        if t > 0.3:
            raise Stopped

    (tmp_path / "cut").mkdir()
    with pytest.raises(Stopped):
        run(scenario, seed=1, out=tmp_path / "cut", progress=stop)
    assert np.array_equal(resume(tmp_path / "cut")["controller.Kp"], whole["controller.Kp"])
    assert read_run(tmp_path / "cut").gains.keys() == {"controller.Kp", "controller.m", "controller.Kd"}
    other = replayed(whole, "least-squares", 1)
    assert np.allclose(other["controller.Kp"], 10.0 * other.estimates["m"] / 1.75, rtol=1e-12)
    assert not np.array_equal(other["controller.Kp"], whole["controller.Kp"])


def test_a_gain_that_the_controller_does_not_declare_to_take_is_vetoed(gains, tmp_path):
    result = run(gains('"controller.Kp" = "20 - 5.714285714285714*m"'), seed=0, out=tmp_path / "run")  # < 0 from 3.5 kg
    assert result.guard["vetoed"] > 0
    assert result["controller.Kp"].min() >= 0.0
    assert "controller.Kp would be -" in (tmp_path / "run" / "events.jsonl").read_text()
    assert re.search(r"the last veto, at t = \S+ s: controller.Kp would be -", report(result, {}))


@pytest.mark.full
def test_without_a_guard_a_formula_without_a_value_ends_the_run_in_one_line(gains):
    scenario = gains('"controller.Kp" = "10*sqrt((3 - m)/1.25)"', **{"guard.enabled": "false"})
    result = run(scenario, seed=0)
    assert result.status == "faulted"
    assert re.match(r"estimation.parameters at t = 0\.\d+ s: '10\*sqrt.*no value at m = ", result.error or "")


@pytest.mark.full
def test_a_gain_that_is_not_read_back_stops_re_tuning(gains, monkeypatch, tmp_path):
    taken = Guard.not_taken

    def deaf(self, t, read, held, names):
        return taken(
            self, t, [v + 1.0 if n == "controller.Kp" and t > 0.2 else v for v, n in zip(read, names)], held, names
        )

    monkeypatch.setattr(Guard, "not_taken", deaf)
    result = run(gains('"controller.Kp" = "10*m/1.75"'), seed=0, out=tmp_path / "run")
    assert result.guard["stopped_at"] == pytest.approx(0.21)
    assert "controller.Kp reads back as" in (tmp_path / "run" / "events.jsonl").read_text()


def test_a_start_value_that_contradicts_the_formula_is_refused(gains, tmp_path):
    scenario = gains('"controller.Kp" = "10*m/1.75"', **{"components.controller.start.Kp": "12.0"})
    with pytest.raises(ScenarioError, match=r"'controller.Kp' is given the start value 12, but its formula gives 10"):
        run(scenario)
    found = [str(f) for f in check(tmp_path / "gains.toml", SHORT | {"components.controller.start.Kp": "12.0"})]
    assert any("is given the start value 12" in line and ": error: " in line for line in found)


@pytest.mark.full
def test_check_tells_what_the_formulas_give_within_the_bounds(gains, tmp_path):
    gains('"controller.Kp" = "20 - 4*m"', '"controller.Kd" = "5"')
    found = "\n".join(map(str, check(tmp_path / "gains.toml")))
    assert "'controller.Kp' starts as 10 in the FMU, and its formula gives 13" in found
    assert "nothing that is written depends on it" in found  # l
    assert "controller.Kp would be" not in found  # 20 - 4*5 is zero
    gains('"controller.Kp" = "10/(m - 1)"', '"controller.Kdd" = "5*l"')
    found = "\n".join(map(str, check(tmp_path / "gains.toml")))
    assert "'Kdd'" in found
    assert "did you mean 'Kd'" in found
    gains('"controller.Kp" = "10*m/1.75 - 1"', '"controller.Kd" = "gain_functions:nothing"')
    assert "gain_functions" in "\n".join(map(str, check(tmp_path / "gains.toml")))


@pytest.mark.parametrize(
    ("formula", "is_used"),
    [("5*min((m - 2.5)**2, 4)", True), ("10 if m == 1.75 else 20", True), ("10", False), ("10 + 0*m", False)],
    ids=["even", "at the start only", "constant", "times zero"],
)
def test_a_parameter_is_unused_where_no_value_of_it_changes_what_is_written(gains, tmp_path, formula, is_used):
    gains(f'"controller.Kp" = "{formula}"')
    found = "\n".join(map(str, check(tmp_path / "gains.toml")))
    assert ("nothing that is written depends on it" not in found) is is_used


def test_a_strangers_function_is_not_called_unasked(gains, tmp_path, capsys, monkeypatch):
    code = PLACE + "\nopen('called', 'w').close()\n"
    monkeypatch.chdir(tmp_path)
    gains(KP_KD, code=code)
    assert main(["export", "gains.toml", "--ssp", "gains.ssp"]) == 0
    (tmp_path / "gain_functions.py").unlink()
    assert main(["check", "gains.ssp"]) == 0
    assert "gain_functions:place of gains.ssp was not called" in capsys.readouterr().out
    assert main(["run", "gains.ssp", "--only", "--estimator", "none"]) == 2
    assert "would run Python code (module gain_functions), which only --trust allows" in capsys.readouterr().err
    assert not (tmp_path / "called").exists()
    assert main(["check", "gains.ssp", "--trust"]) == 0
    assert (tmp_path / "called").exists()
