import tomllib
from importlib.resources import files
from math import isfinite

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from fmu_models import rigid_body
from fmu_models.kernel import ode
from fmu_models.rigid_body.reference import RigidBodyReference

SCENARIO = tomllib.loads(files("cosim").joinpath("scenarios/rigid-body.toml").read_text(encoding="utf-8"))
NAMES = ("m", "c_x", "c_y", "c_z", "J_xx", "J_yy", "J_zz", "J_xy", "J_xz", "J_yz")
BEFORE, AFTER = (tuple(SCENARIO["changes"][f"plant.{name}"][k][1] for name in NAMES) for k in (0, 1))
BOUNDS = np.array([(p["lower"], p["upper"]) for p in SCENARIO["estimation"]["parameters"]])
IS_LOG = np.array([p.get("scale") == "log" for p in SCENARIO["estimation"]["parameters"]])
NOISE = 1.3e-3


def reference(t):
    """The reference of the scenario: the FMU's starts."""
    starts = {v.name: v.start for v in RigidBodyReference.variables if v.causality == "parameter"}
    *sizes, omega = starts.values()
    return rigid_body.motion(t, tuple(sizes[:3]), tuple(sizes[3:]), omega)


def test_derivative_is_that_of_a_free_body_in_mujoco(oracles):
    oracles.check_rigid_body_derivative_against_mujoco(rigid_body)


def test_disturbances_and_drag_are_those_of_a_free_body_in_mujoco(oracles):
    oracles.check_rigid_body_disturbance_and_drag_against_mujoco(rigid_body)


def test_with_drag_it_falls_at_the_terminal_velocity(oracles):
    oracles.check_rigid_body_terminal_velocity(rigid_body)


def test_momentum_and_energy_change_by_wrench_and_power(oracles):
    oracles.check_rigid_body_momentum_and_energy_balance(rigid_body)


def test_momentum_about_the_centre_of_mass_and_energy_are_conserved_in_free_flight(oracles):
    oracles.check_rigid_body_free_flight(rigid_body)


def test_errors_are_linear_under_the_law_with_true_parameters(oracles):
    oracles.check_rigid_body_control_gives_linear_errors(rigid_body)


def test_closed_loop_errors_die_out_as_the_gains_say(oracles):
    oracles.check_rigid_body_closed_loop_errors(rigid_body)


def test_motion_comes_with_its_rates(oracles):
    oracles.check_rigid_body_motion_against_spectral_differences(rigid_body)


def test_motion_starts_at_rest_at_the_origin():
    d = reference(0.0)
    assert (d.r, d.v, d.R, d.Omega) == ((0, 0, 0), (0, 0, 0), (1, 0, 0, 0, 1, 0, 0, 0, 1), (0, 0, 0))
    assert_allclose([*d.a, *d.Omega_dot], 0, atol=1e-15)


def test_the_plants_integrator_agrees_with_dop853(oracles):
    rng = np.random.default_rng(30)
    x, u = oracles.floats(oracles.random_state(rng)), oracles.floats(rng.normal(0, 5, 6))

    def f(x):
        return rigid_body.derivative(x, u, *AFTER)

    exact = solve_ivp(lambda _, x: f(tuple(x)), (0, 0.5), x, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    # RK4: (4 rad/s * 5 ms)^4 / 120 per radian is 1.3e-9; 5 rad, and velocities of 10 m/s.
    assert_allclose(ode.integrate(f, x, 0.5, 0.005), exact, atol=1e-7)


def test_hover_takes_the_weight_and_its_moment_about_the_origin():
    """The weight pulls at c: the body is held by -m g e3 at the origin and by the moment -c x m g e3."""
    x = (*reference(0.0).r, *(0.0,) * 3, *reference(0.0).R, *(0.0,) * 3)
    hover = reference(0.0)._replace(a=(0.0, 0.0, 0.0), Omega_dot=(0.0, 0.0, 0.0))
    wrench = rigid_body.control(x, hover, 4.0, (0.09, 0.075, 0.06), AFTER[4:], 9.81)
    weight = np.array([0, 0, 4.0 * 9.81])
    assert_allclose(wrench, [*-weight, *-np.cross((0.09, 0.075, 0.06), weight)], atol=1e-14)


# Candidates.


@pytest.mark.parametrize(
    "J",
    [(0.0,) * 6, (1.0, 1.0, 1.0, 1.0, 1.0, 1.0), (2.0, 1.0, 3.0, 2**0.5, 0.0, 0.0), (0.1, 0.1, 12.0, 0.1, 2.0, 2.0)],
    ids=["nothing", "rank-one", "rank-two-to-rounding", "rank-two"],
)
def test_a_singular_inertia_is_refused(J):
    with pytest.raises(ValueError, match="inertia must be regular"):
        rigid_body.solve(J, (1.0, 2.0, 3.0))


def test_solve_takes_definite_and_indefinite_inertias(oracles):
    rng = np.random.default_rng(31)
    signs = set()
    for _ in range(500):
        J, b = oracles.floats(rng.uniform(BOUNDS[4:, 0], BOUNDS[4:, 1])), oracles.floats(rng.normal(0, 5, 3))
        matrix = oracles.inertia_matrix(J)
        signs.add(bool(np.linalg.eigvalsh(matrix)[0] > 0))
        # Rounding, times the condition of the inertia.
        tolerance = 1e-14 * np.linalg.cond(matrix) ** 2
        assert_allclose(rigid_body.solve(J, b), np.linalg.solve(matrix, b), atol=tolerance)
    assert signs == {True, False}


def test_every_candidate_gives_finite_numbers_or_a_refusal(oracles):
    """Also the corners of the box, where an inertia may be singular."""
    rng = np.random.default_rng(32)
    for k in range(2000):
        where = rng.uniform(size=10) if k % 2 else rng.integers(0, 2, 10)
        candidate = oracles.floats(BOUNDS[:, 0] + where * (BOUNDS[:, 1] - BOUNDS[:, 0]))
        x, u = oracles.floats(oracles.random_state(rng)), oracles.floats(rng.normal(0, 20, 6))
        try:
            derivative = rigid_body.derivative(x, u, *candidate)
        except (ArithmeticError, ValueError):
            continue
        assert all(map(isfinite, derivative))


# The scenario.


def test_nominal_parameters_are_those_of_all():
    assert rigid_body.derivative.__defaults__ == (*BEFORE, 9.81, 0.0)
    assert tuple(p["name"] for p in SCENARIO["estimation"]["parameters"]) == NAMES


def test_payload_is_that_of_a_rod_fixed_to_the_body_in_mujoco():
    """The mass matrix of the two at rest is [[m, -m hat(c)], [m hat(c), J - m hat(c)^2]]."""
    n = np.array([0.6, 0.64, 0.48])
    a, b = np.array([0.24, 0.2, 0.16]) - 0.9 * n, np.array([0.24, 0.2, 0.16]) + 0.9 * n
    # Points of 1/6, 2/3 and 1/6 of its mass at the rod's ends and middle have its moments.
    points = "".join(
        f'<body pos="{p[0]} {p[1]} {p[2]}"><inertial pos="0 0 0" mass="{m}" diaginertia="1e-12 1e-12 1e-12"/></body>'
        for p, m in ((a, 0.25), ((a + b) / 2, 1.0), (b, 0.25))
    )
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco><worldbody><body><freejoint/>
        <inertial pos="0 0 0" mass="2.5" diaginertia="0.3 0.4 0.5"/>{points}</body></worldbody></mujoco>""")
    data, mass = mujoco.MjData(model), np.empty((6, 6))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    m = mass[0, 0]
    c = np.array([mass[5, 1], mass[3, 2], mass[4, 0]]) / m
    J = mass[3:, 3:] - m * (c @ c * np.eye(3) - np.outer(c, c))
    # The scenario has eight decimals.
    assert_allclose(AFTER, [m, *c, *np.diag(J), J[0, 1], J[0, 2], J[1, 2]], atol=1e-8)


@pytest.mark.parametrize("body", [BEFORE, AFTER], ids=["before", "after"])
def test_bodies_are_possible(oracles, body):
    """Principal moments are positive and each is at most the sum of the others."""
    principal = np.linalg.eigvalsh(oracles.inertia_matrix(body[4:]))
    assert principal[0] > 0
    assert principal[2] < principal[0] + principal[1]
    assert np.all((np.array(body) > BOUNDS[:, 0]) & (np.array(body) < BOUNDS[:, 1]))


def whitened_jacobian(times):
    """Residuals in noise's standard deviations against the parameters in the unit cube of the bounds.

    The samples are on the reference, under the wrench of the nominal controller: those right after the change.
    """
    theta, (lower, upper) = np.array(AFTER), BOUNDS.T
    slope = np.where(IS_LOG, theta * np.log(np.abs(upper / lower)), upper - lower)  # d theta / d its place in [0, 1]

    def accelerations(theta):
        rows = []
        for t in times:
            d = reference(float(t))
            x = (*d.r, *d.v, *d.R, *d.Omega)
            u = rigid_body.control(x, d, BEFORE[0], BEFORE[1:4], BEFORE[4:], 9.81)
            x_dot = rigid_body.derivative(x, u, *map(float, theta))
            rows.append([*x_dot[3:6], *x_dot[15:]])
        return np.ravel(rows)

    h = 1e-6
    columns = [(accelerations(theta + h * e) - accelerations(theta - h * e)) / (2 * h) for e in np.eye(10)]
    return np.column_stack(columns) * slope / NOISE


@pytest.mark.parametrize(("spacing", "least"), [(0.01, 50.0), (0.05, 500.0)], ids=["10-ms", "50-ms"])
def test_ten_samples_show_all_ten_parameters(spacing, least):
    """The least singular value is one over the worst direction's standard deviation, in the width of the bounds."""
    for start in np.arange(2.0, 9.5, 0.25):
        values = np.linalg.svd(whitened_jacobian(start + spacing * np.arange(10)), compute_uv=False)
        assert values[-1] > least


def test_one_sample_shows_six():
    """Six accelerations cannot show more; and they are six directions apart."""
    values = np.linalg.svd(whitened_jacobian([2.01]), compute_uv=False)
    assert len(values) == 6
    assert values[-1] > 500.0
