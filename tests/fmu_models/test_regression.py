"""The equations of motion as rows times coefficients, for recursive least squares.

The truth is Newton's and Euler's laws with vectors, written here; each comparison is also shown wrong signs.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from fmu_models import pendulum, quadrotor
from tests.mutation import mutation_tests

RATE = st.floats(-5.0, 5.0)
POSITIVE = st.floats(0.1, 10.0)
ACCELERATIONS = (3, 4, 5, 15, 16, 17)
"""Places in the quadrotor's derivative of v_dot and Omega_dot."""


def pendulum_acceleration(phi, phi_dot, u, m, l, b, g):
    """Torques of weight, friction and input about the hinge over m l^2, with vectors in the plane, y up."""
    place = l * np.array([np.sin(phi), -np.cos(phi)])
    tangent = np.array([np.cos(phi), np.sin(phi)])
    force = np.array([0.0, -m * g]) + (u - b * l * phi_dot) * tangent
    return (place[0] * force[1] - place[1] * force[0]) / (m * l * l)


def quadrotor_accelerations(R, Omega, F, M, m, J, g):
    """Newton in the inertial frame, Euler in the body's: (v_dot, Omega_dot) (6,)."""
    J = np.diag(J)
    weight_and_thrust = np.array([0.0, 0.0, m * g]) - F * R @ [0.0, 0.0, 1.0]
    return np.concatenate([weight_and_thrust / m, np.linalg.solve(J, M - np.cross(Omega, J @ Omega))])


def residual(module, x, u, xdot, theta, **known):
    rows, targets = module.regression(x, u, xdot, **known)
    rows, targets, psi = np.array(rows), np.array(targets), np.array(module.coefficients(**theta))
    assert rows.shape == (len(targets), len(psi))
    scale = np.abs(rows) @ np.abs(psi) + np.abs(targets) + 1.0
    return (rows @ psi - targets) / scale


def check_pendulum_against_newton(module):
    rng = np.random.default_rng(0)
    for phi, phi_dot, u in rng.uniform(-3.0, 3.0, (40, 3)):
        m, l, b, g = rng.uniform(0.3, 4.0, 4)
        xdot = (pendulum_acceleration(phi, phi_dot, u, m, l, b, g),)
        off = residual(module, (phi, phi_dot), (u,), xdot, {"m": m, "l": l}, b=b, g=g)
        assert_allclose(off, 0.0, atol=1e-14)  # rounding, relative to the terms


def check_pendulum_with_a_disturbance(module):
    rng = np.random.default_rng(1)
    for phi, phi_dot, u, F_d in rng.uniform(-3.0, 3.0, (40, 4)):
        m, l, b, g = rng.uniform(0.3, 4.0, 4)
        xdot = (pendulum_acceleration(phi, phi_dot, u + F_d, m, l, b, g),)
        off = residual(module, (phi, phi_dot), (u, F_d), xdot, {"m": m, "l": l}, b=b, g=g)
        assert_allclose(off, 0.0, atol=1e-14)


def check_quadrotor_with_disturbances(module):
    rng = np.random.default_rng(1)
    for _ in range(40):
        R, Omega, M = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-3, 3, 3), rng.uniform(-3, 3, 3)
        F_d, M_d, (F, m, g, *J) = rng.normal(0, 3, 3), rng.normal(0, 3, 3), rng.uniform(0.5, 12.0, 6)
        accelerations = quadrotor_accelerations(R, Omega, F, M + M_d, m, J, g)
        accelerations[:3] += F_d / m
        x, theta = (*np.zeros(6), *R.ravel(), *Omega), dict(zip(("m", "J_x", "J_y", "J_z"), (m, *J), strict=True))
        off = residual(module, x, (F, *M, *F_d, *M_d), tuple(accelerations), theta, g=g)
        assert_allclose(off, 0.0, atol=1e-14)


def check_quadrotor_against_newton_and_euler(module):
    rng = np.random.default_rng(0)
    for _ in range(40):
        R, Omega, M = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-3, 3, 3), rng.uniform(-3, 3, 3)
        F, m, g, *J = rng.uniform(0.5, 12.0, 6)
        xdot = tuple(quadrotor_accelerations(R, Omega, F, M, m, J, g))
        x = (*rng.normal(size=6), *R.ravel(), *Omega)
        theta = dict(zip(("m", "J_x", "J_y", "J_z"), (m, *J), strict=True))
        assert_allclose(residual(module, x, (F, *M), xdot, theta, g=g), 0.0, atol=1e-14)


CHECKS = {pendulum: check_pendulum_against_newton, quadrotor: check_quadrotor_against_newton_and_euler}


DISTURBED = {pendulum: check_pendulum_with_a_disturbance, quadrotor: check_quadrotor_with_disturbances}


@pytest.mark.parametrize("module", DISTURBED, ids=["pendulum", "quadrotor"])
def test_known_disturbances_are_in_the_linear_form(module):
    DISTURBED[module](module)


@given(x=st.tuples(RATE, RATE), u=RATE, m=POSITIVE, l=POSITIVE, b=POSITIVE, g=POSITIVE)
@settings(max_examples=60, deadline=None)
def test_the_pendulums_derivative_satisfies_its_linear_form(x, u, m, l, b, g):
    xdot = pendulum.derivative(x, (u,), m, l, b, g)[1:]
    assert_allclose(residual(pendulum, x, (u,), xdot, {"m": m, "l": l}, b=b, g=g), 0.0, atol=1e-14)


@given(
    turn=st.tuples(RATE, RATE, RATE), rates=st.tuples(RATE, RATE, RATE), F=RATE, M=st.tuples(RATE, RATE, RATE),
    m=POSITIVE, J=st.tuples(POSITIVE, POSITIVE, POSITIVE), g=POSITIVE,
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_the_quadrotors_derivative_satisfies_its_linear_form(turn, rates, F, M, m, J, g):
    x = (*np.zeros(6), *Rotation.from_rotvec(turn).as_matrix().ravel().tolist(), *rates)
    xdot = quadrotor.derivative(x, (F, *M), m, *J, g)
    sampled = tuple(xdot[i] for i in ACCELERATIONS)
    theta = dict(zip(("m", "J_x", "J_y", "J_z"), (m, *J), strict=True))
    assert_allclose(residual(quadrotor, x, (F, *M), sampled, theta, g=g), 0.0, atol=1e-14)


@pytest.mark.parametrize("module", CHECKS, ids=["pendulum", "quadrotor"])
def test_newtons_laws_satisfy_the_linear_form(module):
    CHECKS[module](module)


@pytest.mark.parametrize("module", CHECKS, ids=["pendulum", "quadrotor"])
def test_what_is_known_defaults_to_the_models_own(module):
    """Friction and gravity, which are not estimated."""
    x = (0.3, 0.7) if module is pendulum else (*np.zeros(6), *np.eye(3).ravel().tolist(), 0.1, 0.2, 0.3)
    u = (1.0,) if module is pendulum else (10.0, 1.0, 2.0, 3.0)
    theta = {"m": 2.0, "l": 0.5} if module is pendulum else {"m": 2.0, "J_x": 1.0, "J_y": 2.0, "J_z": 3.0}
    xdot = module.derivative(x, u, **theta)
    sampled = xdot[1:] if module is pendulum else tuple(xdot[i] for i in ACCELERATIONS)
    assert_allclose(residual(module, x, u, sampled, theta), 0.0, atol=1e-14)


def test_the_rows_of_exciting_samples_fix_every_coefficient():
    """Least squares of six samples tells them."""
    rng = np.random.default_rng(0)
    for module, theta in (
        (pendulum, {"m": 2.0, "l": 0.6}),
        (quadrotor, {"m": 1.4, "J_x": 3.0, "J_y": 2.0, "J_z": 6.0}),
    ):
        rows, targets = [], []
        for _ in range(6):
            if module is pendulum:
                x, u = tuple(rng.normal(size=2)), (rng.normal(),)
                sampled = module.derivative(x, u, **theta)[1:]
            else:
                x = (*np.zeros(6), *Rotation.random(random_state=rng).as_matrix().ravel(), *rng.normal(size=3))
                u = (10.0, *rng.normal(size=3))
                sampled = tuple(module.derivative(x, u, **theta)[i] for i in ACCELERATIONS)
            more, wanted = module.regression(x, u, sampled)
            rows.extend(more)
            targets.extend(wanted)
        psi, *_ = np.linalg.lstsq(np.array(rows), np.array(targets))
        assert_allclose(psi, module.coefficients(**theta), rtol=1e-9)  # the conditioning of six samples


PENDULUM, QUADROTOR = "fmu_models.pendulum.equations", "fmu_models.quadrotor.equations"
NEWTON, EULER = (check.__name__ for check in CHECKS.values())
PUSHED, GUST = (check.__name__ for check in DISTURBED.values())

MUTANTS = [
    ("weight", PENDULUM, "((-g * sin(phi), -b", "((g * sin(phi), -b", (NEWTON,)),
    ("friction", PENDULUM, "sin(phi), -b * phi_dot, _total", "sin(phi), b * phi_dot, _total", (NEWTON,)),
    ("input", PENDULUM, "-b * phi_dot, _total(u)),)", "-b * phi_dot, -_total(u)),)", (NEWTON,)),
    ("target", PENDULUM, ", (xdot[0],))", ", (-xdot[0],))", (NEWTON,)),
    ("order-of-coefficients", PENDULUM, "return (1.0 / l, 1.0 / m, 1", "return (1.0 / m, 1.0 / l, 1", (NEWTON,)),
    ("product", PENDULUM, "1.0 / (m * l))\n", "1.0 / (m + l))\n", (NEWTON,)),
    ("thrust-x", QUADROTOR, "= -F * r13, -F", "= F * r13, -F", (EULER,)),
    ("thrust-y", QUADROTOR, "r13, -F * r23,", "r13, F * r23,", (EULER,)),
    ("thrust-z", QUADROTOR, "r23, -F * r33\n", "r23, F * r33\n", (EULER,)),
    ("row-for-column", QUADROTOR, "_, _, r13, _, _, r23, _, _, r33, p", "_, _, _, _, _, _, r13, r23, r33, p", (EULER,)),
    ("gravity", QUADROTOR, "(a_x, a_y, a_z - g, M_x", "(a_x, a_y, a_z + g, M_x", (EULER,)),
    ("moment", QUADROTOR, "a_z - g, M_x, M_y, M_z)", "a_z - g, M_x, M_y, -M_z)", (EULER,)),
    ("gyroscopic-x-y", QUADROTOR, "p_dot, -q * r, q * r)", "p_dot, q * r, q * r)", (EULER,)),
    ("gyroscopic-x-z", QUADROTOR, "p_dot, -q * r, q * r)", "p_dot, -q * r, -q * r)", (EULER,)),
    ("gyroscopic-y-x", QUADROTOR, "(0.0, p * r, q_dot, -p * r)", "(0.0, -p * r, q_dot, -p * r)", (EULER,)),
    ("gyroscopic-y-z", QUADROTOR, "(0.0, p * r, q_dot, -p * r)", "(0.0, p * r, q_dot, p * r)", (EULER,)),
    ("gyroscopic-z-x", QUADROTOR, "-p * q, p * q, r_dot)", "p * q, p * q, r_dot)", (EULER,)),
    ("gyroscopic-z-y", QUADROTOR, "-p * q, p * q, r_dot)", "-p * q, -p * q, r_dot)", (EULER,)),
    ("angular-acceleration", QUADROTOR, "p * q, r_dot)", "p * q, -r_dot)", (EULER,)),
    ("push", PENDULUM, "u[0] + u[1] if", "u[0] if", (PUSHED,)),
    ("gust", QUADROTOR, "F_y + u[5]", "F_y - u[5]", (GUST,)),
    (
        "gust-of-moment",
        QUADROTOR,
        "F_z + u[6]\n        M_x, M_y, M_z = M_x + u[7]",
        "F_z + u[6]\n        M_x, M_y, M_z = M_x",
        (GUST,),
    ),
    ("mass-for-its-inverse", QUADROTOR, "return (1.0 / m, J_x", "return (m, J_x", (EULER,)),
]

TestMutants = mutation_tests(
    MUTANTS, {check.__name__: check for checks in (CHECKS, DISTURBED) for check in checks.values()}
)
