"""Models that are wrong are found: by `check` and `run` where they cannot be used, by `check --dry-run` in numbers."""

import numpy as np
import pytest

from cosim.authoring.check import check
from cosim.cli import main
from cosim.errors import ScenarioError
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario

pytestmark = pytest.mark.fmu

BROKEN = {
    "always NaN": ("return float('nan'), v", r"has no value at the start, nor at any of 20 points .* \[nan, "),
    "three derivatives for two states": ("return v, v, v", "returns 3 derivatives for 2 states, mass.v, mass.s"),
    "one derivative": ("return (v,)", "returns 1 derivative for 2 states"),
    "a matrix": ("return [[v], [s]]", r"returns an array of shape \(2, 1\) for 2 states"),
    "other states": ("a, b, c = x", r"ValueError: not enough .*; x is \(mass\.v, mass\.s\), u is \(f\)\.$"),
    "a division by zero": ("return 1 / 0, v", "has no value .* ZeroDivisionError"),
    "nothing": ("pass", "failed: TypeError|has no value|returns an array of shape"),
}


@pytest.fixture
def broken(axis, tmp_path):
    """broken(line): the axis with a model that ends in this line."""

    def write(line, *replacements):
        path = axis(*replacements)
        (tmp_path / "axis_model.py").unlink()
        (tmp_path / "axis_model.py").write_text(
            f"def derivative(x, u, m, c=8.0):\n    v, s = x\n    f, = u\n    {line}\n"
        )
        return path

    return write


@pytest.mark.parametrize(("line", "reason"), BROKEN.values(), ids=BROKEN)
def test_a_model_that_cannot_be_used_is_refused_by_check_and_run(broken, line, reason):
    path = broken(line)
    found = [f for f in check(path) if f.is_error]
    assert [f.where for f in found] == ["estimation.model"]
    with pytest.raises(ScenarioError, match=reason) as caught:
        run(Scenario.load(path))
    assert found[0].what in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_not_connected_is_named_where_a_model_takes_another_number_of_inputs(broken):
    """It is part of u until it changes, which a model that does not know of it has no place for."""
    path = broken("() = u", ('"plant.f" = "controller.f_cmd"\n', ""))
    (found,) = (f for f in check(path) if f.is_error)
    told = "u is (f); not connected, and in u until [changes] names it: f"
    assert found.what.endswith(f"ValueError: too many values to unpack (expected 0); x is (mass.v, mass.s), {told}")
    with pytest.raises(ScenarioError) as caught:
        run(Scenario.load(path))
    assert found.what in str(caught.value)


def test_a_model_without_a_value_at_the_start_only_is_used(broken):
    path = broken("return (f - c * s - v) / m + 0.0 / v, v")  # at rest
    assert not [f for f in check(path) if f.is_error]
    assert run(Scenario.load(path, {"scenario.stop_time": "0.1"})).status == "done"


RIGHT = "return (f - c * s - v) / m, v"


NOT_VECTORISED = {
    "a choice": (
        "return (f - c * s - v) / m if v < 9.0 else 0.0, v",
        "does not take arrays: ValueError: The truth val",
    ),
    "other values": (
        "return (f - c * s - v) / (m if isinstance(m, float) else m.mean()), v",
        r"gives der\(mass.v\) = -?[\d.e+-]+ at 22 points at once, -?[\d.e+-]+ at that one alone",
    ),
    "one derivative": ("return ((f - c * s - v) / m, v)[: 2 if isinstance(m, float) else 1]", "returns 1 derivative"),
}


@pytest.mark.parametrize(("line", "reason"), NOT_VECTORISED.values(), ids=NOT_VECTORISED)
def test_a_model_that_does_not_take_arrays_is_refused_where_it_says_so(broken, line, reason):
    path = broken(line, ("[estimation]", "[estimation]\nvectorised = true"))
    found = [f for f in check(path) if f.is_error]
    assert [f.where for f in found] == ["estimation.vectorised"]
    with pytest.raises(ScenarioError, match=reason) as caught:
        run(Scenario.load(path))
    assert found[0].what in str(caught.value)


def test_a_model_that_takes_arrays_gives_the_same_run(broken):
    """To 1e-6 of the parameter: sums are rounded in another order where NumPy takes several at a time."""
    path = broken(RIGHT)
    alone, together = (run(Scenario.load(path, {"estimation.vectorised": flag})) for flag in ("false", "true"))
    np.testing.assert_allclose(together.estimates["m"], alone.estimates["m"], rtol=1e-6)
    assert len(set(alone.estimates["m"])) > 1


def test_a_model_that_takes_arrays_is_tried_at_inputs_that_the_plant_has_only():
    """The built-in quadrotor's fails where a disturbance acts and those that `changes` names are missing."""
    settings = {'changes."plant.F_d_x"': "[[0.0, 0.0], [0.02, 1.0]]", "scenario.stop_time": "0.05"}
    assert run(Scenario.load("quadrotor", settings)).status == "done"


@pytest.mark.full
def test_an_fmu_in_place_of_a_vectorised_function_is_none():
    model = {"estimation.model": "Quadrotor", "scenario.stop_time": "0.05"}
    alone, named = (run(Scenario.load("quadrotor", model | own)) for own in ({"estimation.vectorised": "false"}, {}))
    np.testing.assert_array_equal(named.estimates["m"], alone.estimates["m"])


def dry(path):
    return [str(f) for f in check(path, is_run=True)]


def test_a_dry_run_says_that_it_runs_the_fmus_and_finds_nothing_in_a_sound_model(broken, capsys):
    path = broken(RIGHT)
    found = dry(path)
    assert "scenario: note: the FMUs were run for 100 macro steps, up to t = 1.000 s" in found
    assert not any("der(" in line for line in found)
    assert not any("were run" in str(f) for f in check(path))  # unasked
    assert main(["check", str(path), "--dry-run"]) == 0
    assert "the FMUs were run" in capsys.readouterr().out


def test_another_sign_is_told_in_numbers_of_model_and_fmu(broken):
    """At rest the spring pulls nothing: the force of the first step, 2 (25 + 10 * 0) N on 2 kg, tells the sign."""
    (line,) = [line for line in dry(broken("return -(f - c * s - v) / m, v")) if "der(mass.v)" in line]
    numbers = [float(line.partition(f"{of} ")[2].split()[0].rstrip(",")) for of in ("model", "FMU")]
    assert ": error: der(mass.v): model -" in line
    assert "m/s2, at t = 0.0" in line
    assert numbers[0] == pytest.approx(-numbers[1])
    assert 20.0 < numbers[1] < 26.0


def test_a_simplification_is_a_warning(broken):
    (line,) = [line for line in dry(broken("return (f - c * s - 3.0 * v) / m, v")) if "der(mass.v)" in line]
    assert ": warning: der(mass.v): model " in line
    assert main(["check", str(broken("return (f - c * s - 3.0 * v) / m, v")), "--dry-run"]) == 0


def test_friction_left_out_on_purpose_is_a_warning_where_the_plant_starts_without_acceleration(broken):
    """From v = 1 m/s, as the reference begins: the model has no acceleration at all there, the FMU -0.5 m/s2."""
    moving = ('plant = { fmu = "Axis.fmu" }', 'plant = { fmu = "Axis.fmu", start = { "mass.v" = 1.0 } }')
    path = broken("return (f - c * s) / m, v", moving)
    (line,) = [line for line in dry(path) if "der(mass.v)" in line]
    assert ": warning: der(mass.v): model " in line
    assert "otherwise add it" in line
    assert main(["check", str(path), "--dry-run"]) == 0


def test_an_fmu_that_fails_later_in_a_dry_run_is_a_warning_and_what_was_before_is_compared(faulty_toml):
    found = [str(f) for f in check(faulty_toml, is_run=True)]
    assert not any(": error: " in line for line in found)
    assert any(line.startswith("scenario: warning: in a dry run: reference: do_step at t = 0.050 s") for line in found)
    assert any("the FMUs were run for 5 macro steps" in line for line in found)


def test_without_declared_derivatives_the_mean_slopes_are_compared(broken, bare_axis):
    sampled = (
        '[sampling.derivatives]\n"plant.der(mass.v)" = { noise = 1e-3 }',
        '[sampling]\nfilter = { kind = "savitzky-golay" }\n'
        'derivatives = { "plant.der(mass.v)" = { of = "plant.mass.v" } }\n'
        'states = { "plant.mass.v" = { noise = 1e-6 }, "plant.mass.s" = { noise = 1e-6 } }',
    )
    bare = ('"Axis.fmu"', f'"{bare_axis.name}"')
    assert not any("mean slope" in line for line in dry(broken(RIGHT, sampled, bare)))


def test_without_declared_derivatives_a_wrong_model_is_found(broken, bare_axis):
    sampled = (
        '[sampling.derivatives]\n"plant.der(mass.v)" = { noise = 1e-3 }',
        '[sampling]\nfilter = { kind = "savitzky-golay" }\n'
        'derivatives = { "plant.der(mass.v)" = { of = "plant.mass.v" } }\n'
        'states = { "plant.mass.v" = { noise = 1e-6 }, "plant.mass.s" = { noise = 1e-6 } }',
    )
    path = broken("return (f - c * s - v) / (3 * m), v", sampled, ('"Axis.fmu"', f'"{bare_axis.name}"'))
    assert any("error: mean slope of mass.v: model " in line for line in dry(path))


def test_an_fmu_that_fails_is_found(faulty_toml):
    early = {"scenario.start_time": "0.04"}  # its second step is the one that it raises in
    assert not [f for f in check(faulty_toml, early) if f.is_error]
    (error,) = [str(f) for f in check(faulty_toml, early, is_run=True) if f.is_error]
    assert error.startswith("scenario: error: in a dry run: reference: do_step at t = 0.050 s")


def test_a_package_is_run_only_where_it_is_trusted(tmp_path, capsys):
    package = tmp_path / "pendulum.ssp"
    assert main(["export", "pendulum", "--ssp", str(package)]) == 0
    capsys.readouterr()
    assert main(["check", str(package), "--dry-run"]) == 2
    assert "--dry-run would run its FMUs, which only --trust allows" in capsys.readouterr().err
    assert main(["check", str(package), "--dry-run", "--trust"]) == 0
    assert "the FMUs were run" in capsys.readouterr().out


def test_an_fmu_takes_no_dry_run(foreign, capsys):
    assert main(["check", str(foreign / "Axis.fmu"), "--dry-run"]) == 2
    assert "--dry-run is for a scenario, not for an FMU" in capsys.readouterr().err


def test_other_start_values_in_plant_and_controller_are_told(axis):
    changes = ('"plant.mass.m" = [[0.0, 2.0], [0.3, 3.0]]', '"plant.spring.c" = 8.0')
    assert not any("starts at" in str(f) for f in check(axis(changes)))
    plant = ('fmu = "AxisController.fmu"', 'fmu = "AxisController.fmu", start = { m = 2.5 }')
    (found,) = [f for f in check(axis(changes, plant)) if "starts at" in f.what]
    assert str(found) == ("estimation.parameters.0 (m): warning: 'plant.mass.m' starts at 2, and 'controller.m' at 2.5")
