"""The tuning rule: what formulas and functions give, and what they say where they give nothing."""

import numpy as np
import pytest

from cosim.scenarios.scenario import Scenario, ScenarioError
from cosim.scenarios.tuning_rule import TuningRule


def rule(formulas, estimated=("J", "d"), **functions):
    return TuningRule(estimated, formulas, lambda reference: functions[reference.partition(":")[2]])


def test_an_estimate_is_written_as_it_is_to_the_last_bit():
    theta = np.array([0.1 + 0.2, 1e-300])
    made = rule({"c.d": "d", "c.J": "J"})
    assert made(theta) == [theta[1], theta[0]]
    assert made.is_plain


def test_one_parameter_gives_many_and_one_depends_on_many():
    made = rule({"c.k": "32*J - d", "c.J": "J", "c.Ti": "(32*J - d) / (400*J)"})
    assert made([0.02, 0.05]) == pytest.approx([0.59, 0.02, 0.59 / 8.0])
    assert not made.is_plain


def test_a_function_gives_as_many_as_it_is_named_for_and_is_called_once():
    calls = []

    def place(J, d):
        calls.append((J, d))
        return np.array([[2.0 * J, 3.0 * d]])  # a row of gains

    made = rule({"c.k1": "m:place", "c.k": "J + d", "c.k2": "m:place"}, place=place)
    assert made([1.0, 2.0]) == [2.0, 3.0, 6.0]
    assert calls == [(1.0, 2.0)]


def fail(J, d):
    raise np.linalg.LinAlgError("singular")


def leave(J, d):
    raise SystemExit(3)


@pytest.mark.parametrize(
    ("formula", "reason"),
    [
        ("1/(J - 1)", "'1/.J - 1.' has no value at J = 1, d = 2: ZeroDivisionError"),
        ("sqrt(-d)", "has no value at J = 1, d = 2: ValueError: math domain error"),
        ("(-d)**0.5", "is complex"),
        ("1e308*d*d", "is inf at J = 1"),
        ("m:fail", "'m:fail' has no value at J = 1, d = 2: LinAlgError: singular"),
        ("m:leave", "SystemExit"),
        ("m:nothing", "c.k = m:nothing is nan"),
        ("m:text", "has no value"),
        ("m:two", "gives 2 values for c.k"),
        ("m:nan", "c.k = m:nan is nan"),
    ],
)
def test_no_value_is_a_reason_in_one_line(formula, reason):
    functions = {
        "fail": fail, "leave": leave, "nothing": lambda J, d: None, "text": lambda J, d: "x",
        "two": lambda J, d: (1.0, 2.0), "nan": lambda J, d: float("nan"),
    }  # fmt: skip
    with pytest.raises(ValueError, match=reason) as caught:
        rule({"c.k": formula}, **functions)([1.0, 2.0])
    assert "\n" not in str(caught.value)


# -- in a scenario ------------------------------------------------------------------------------------------------

HEAD = """
scenario = { name = "s", stop_time = 1.0, macro_step = 0.1 }
components = { plant = { fmu = "Pendulum" }, controller = { fmu = "PendulumController" } }
tracking = { "plant.phi" = "plant.phi_dot" }
sampling.derivatives = { "plant.der(phi_dot)" = { noise = 1e-3 } }
"""
PARAMETER = """
[[estimation.parameters]]
name = "{name}"
lower = 0.1
upper = 5.0
"""


def load(tmp_path, *parameters):
    tables = [PARAMETER.format(name=name) + more for name, more in parameters]
    path = tmp_path / "s.toml"
    path.write_text(HEAD + '[estimation]\ntrigger = { kind = "always" }\n' + "".join(tables))
    return Scenario.load(path)


def test_both_forms_of_writes_are_read(tmp_path):
    table = 'start = 1.0\nwrites = { "controller.Kp" = "10*m*l", "controller.Kd" = "m:gains" }\n'
    scenario = load(tmp_path, ("m", table), ("l", 'writes = "controller.l"\n'))
    assert scenario.written == {"controller.Kp": "10*m*l", "controller.Kd": "m:gains", "controller.l": "l"}
    assert scenario.formulas == {"controller.Kp": "10*m*l", "controller.Kd": "m:gains"}
    again = Scenario.model_validate(scenario.model_dump(mode="json") | {"folder": tmp_path})
    assert again == scenario


WRITES = 'start = 1.0\nwrites = {{ "controller.Kp" = "{}" }}\n'
REFUSED = {
    "an unknown name": ([("m", WRITES.format("10*M"))], r'writes "controller.Kp": .*\'M\'; did you mean \'m\''),
    "the time": ([("m", WRITES.format("10*t"))], "an unknown name, 't'"),
    "Python": ([("m", WRITES.format("__import__(1)"))], "calls __import__"),
    "no start": ([("m", 'writes = { "controller.Kp" = "m" }\n')], "'m', written by formulas, needs start"),
    "neither": ([("m", "")], "'m' needs writes, a parameter of the controller"),
    "a start twice": ([("m", 'start = 1.0\nwrites = "controller.m"\n')], "leave out start"),
    "a start outside": ([("m", WRITES.format("m").replace("1.0", "9.0"))], r"'m' starts at 9, outside \[0.1, 5\]"),
    "twice": ([("m", WRITES.format("m")), ("l", 'writes = "controller.Kp"\n')], "'controller.Kp' is written twice"),
    "nothing": ([("m", "start = 1.0\nwrites = {}\n")], "nothing is written"),
    "nothing at all": ([("m", "start = 1.0\n")], "nothing is written"),
    "a number": ([("m", 'start = 1.0\nwrites = { "controller.Kp" = 3 }\n')], "writes.controller.Kp: .*string.* got 3"),
    "no variable": ([("m", 'start = 1.0\nwrites = { Kp = "m" }\n')], "'Kp' must be COMPONENT.VARIABLE"),
    "another component": ([("m", 'start = 1.0\nwrites = { "contoller.Kp" = "m" }\n')], "did you mean 'controller'"),
    "a list": ([("m", 'writes = ["controller.m"]\n')], "writes: .*string"),
}


@pytest.mark.parametrize(("parameters", "reason"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_written_is_refused_in_one_line_with_its_place(tmp_path, parameters, reason):
    with pytest.raises(ScenarioError, match=reason) as caught:
        load(tmp_path, *parameters)
    assert "estimation.parameters" in str(caught.value)
    assert "\n" not in str(caught.value)
