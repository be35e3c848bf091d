"""The ball below the magnet, its loop, and the scenario."""

import inspect
import tomllib
from importlib.resources import files
from math import cos, sin

import numpy as np
import pytest

from fmu_models import magnetic_levitation
from fmu_models.kernel.ode import integrate
from fmu_models.magnetic_levitation.controller import MagneticLevitationController
from fmu_models.magnetic_levitation.plant import MagneticLevitation
from fmu_models.magnetic_levitation.reference import MagneticLevitationReference

SCENARIO = tomllib.loads(files("cosim").joinpath("scenarios/magnetic-levitation.toml").read_text(encoding="utf-8"))
BEFORE, AFTER = (tuple(SCENARIO["changes"][f"plant.{name}"][k][1] for name in ("m", "z_0")) for k in (0, 1))
STARTS = {v.name: v.start for v in MagneticLevitationController.variables if v.causality == "parameter"}
STEP = SCENARIO["scenario"]["macro_step"]


def test_the_force_is_the_slope_of_the_co_energy(oracles):
    oracles.check_magnet_derivative_is_that_of_the_co_energy(magnetic_levitation)


def test_energy_is_conserved_at_constant_current(oracles):
    oracles.check_magnet_keeps_its_energy_at_constant_current(magnetic_levitation)


def test_with_drag_it_falls_at_the_terminal_velocity(oracles):
    oracles.check_magnet_terminal_velocity(magnetic_levitation)


def test_errors_are_linear_under_the_law_with_true_parameters(oracles):
    oracles.check_magnet_closed_loop_error(magnetic_levitation)


def test_the_current_stays_between_its_limits(oracles):
    oracles.check_magnet_current_is_limited(magnetic_levitation)


def test_the_model_s_defaults_are_the_fmus_starts():
    defaults = {k: p.default for k, p in inspect.signature(magnetic_levitation.derivative).parameters.items()}
    starts = {v.name: v.start for v in MagneticLevitation.variables if v.causality == "parameter"}
    assert list(defaults)[2:] == [name for name in starts if name not in ("tau_u", "max_step")]
    assert {name: defaults[name] for name in list(defaults)[2:]} == {k: starts[k] for k in list(defaults)[2:]}
    assert {k: STARTS[k] for k in ("m", "z_0", "k", "g")} == {k: starts[k] for k in ("m", "z_0", "k", "g")}
    assert (starts["m"], starts["z_0"]) == BEFORE


def test_open_loop_it_runs_off_at_the_rate_of_its_unstable_pole():
    """About rest z_ddot = 2 g/(z + z_0) dz: a difference of the gap grows as cosh(37/s t)."""
    rest = 0.014 * np.sqrt(0.1 * 9.81 / 2e-4)
    for off in (-1e-7, 1e-7):
        x = integrate(lambda x: magnetic_levitation.derivative(x, (rest,)), (0.01 + off, 0.0), 0.1, 1e-3)
        assert x[0] - 0.01 == pytest.approx(off * np.cosh(np.sqrt(2 * 9.81 / 0.014) * 0.1), rel=1e-3)


def wanted(t):
    """The reference of the scenario: the FMU's starts."""
    mean, amplitude, omega = (v.start for v in MagneticLevitationReference.variables if v.causality == "parameter")
    wave = amplitude * sin(omega * t)
    return mean + wave, amplitude * omega * cos(omega * t), -(omega**2) * wave


def loop(believed, push=0.0, begin=0.0, duration=0.0):
    """Tracking errors [m] of the scenario, with a push [N/weight] from `begin` for `duration` [s]."""
    p = STARTS | dict(zip(("m", "z_0"), BEFORE, strict=True))
    x, errors = (wanted(0.0)[0], SCENARIO["components"]["plant"]["start"]["v"]), []
    for k in range(round(SCENARIO["scenario"]["stop_time"] / STEP)):
        t = k * STEP
        body = BEFORE if t < 1.0 else AFTER
        p |= dict(zip(("m", "z_0"), body if believed == "true" else BEFORE, strict=True))
        i = magnetic_levitation.control(x, wanted(t), **p)
        F_d = push * body[0] * 9.81 if begin <= t < begin + duration else 0.0
        x = integrate(lambda x, u=(i, F_d), body=body: magnetic_levitation.derivative(x, u, *body), x, STEP, STEP)
        errors.append(x[0] - wanted(t + STEP)[0])
    return np.array(errors)


def test_it_starts_on_the_reference():
    assert wanted(0.0)[:2] == (0.01, SCENARIO["components"]["plant"]["start"]["v"])


def test_the_nominal_controller_holds_the_payload_and_sags():
    errors = loop("nominal")
    assert np.abs(errors[:1000]).max() < 1e-4
    assert 1e-3 < errors[1200:].min() <= errors.max() < 4e-3


def test_with_true_parameters_the_error_is_that_of_the_held_input():
    """While the current is held, 0.5 ms in the mean, the gap moves by up to 0.025 mm of 14 mm: the force is off by
    twice that part of g, which moves the ball by 1/1600 s2 of it, 0.022 mm."""
    assert 1e-5 < np.abs(loop("true")).max() < 3e-5


@pytest.mark.sampled(3)
@pytest.mark.parametrize("begin", [0.5, 1.5], ids=["before", "after"])
@pytest.mark.parametrize("duration", [0.05, 0.1])
@pytest.mark.parametrize("push", [-0.5, -0.3, 0.3, 0.5])
def test_the_nominal_controller_survives_a_push(push, duration, begin):
    """The push is up to half the weight; static it would move the ball by half of g over 1600/s2, 3 mm."""
    off = loop("nominal", push, begin, duration) - loop("nominal")
    assert np.abs(loop("nominal", push, begin, duration)).max() < 0.75 * SCENARIO["limits"]["divergence"]
    assert np.abs(off).max() > 5e-4
    assert np.abs(off[-500:]).max() < 1e-4
