import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from fmu_models import quadrotor
from fmu_models.kernel import ode

J = (0.7, 1.1, 1.6)
PAPER = (1.25, (1.1, 1.1, 2.2), 9.81)


def state(r=(0, 0, 0), v=(0, 0, 0), rotvec=(0, 0, 0), Omega=(0, 0, 0)):
    return tuple(map(float, [*r, *v, *Rotation.from_rotvec(rotvec).as_matrix().ravel(), *Omega]))


def test_derivative_is_that_of_a_free_body_in_mujoco(oracles):
    oracles.check_quadrotor_derivative_against_mujoco(quadrotor)


def test_disturbances_and_drag_are_those_of_a_free_body_in_mujoco(oracles):
    oracles.check_quadrotor_disturbance_and_drag_against_mujoco(quadrotor)


def test_with_drag_it_falls_at_the_terminal_velocity(oracles):
    oracles.check_quadrotor_terminal_velocity(quadrotor)


def test_derivative_is_that_of_rotorpys_multirotor(oracles):
    oracles.check_quadrotor_derivative_against_rotorpy(quadrotor)


def test_momentum_and_energy_change_by_moment_and_power(oracles):
    oracles.check_quadrotor_momentum_and_energy_balance(quadrotor)


def test_angular_momentum_and_energy_are_conserved_without_torque(oracles):
    x = state(rotvec=(0.3, -0.7, 1.2), Omega=(0.2, 3.0, 0.1))  # about the middle axis: it tumbles

    def momentum_and_energy(x):
        _, _, R, Omega = oracles.split(x)
        return np.append(R @ (J * Omega), Omega @ (J * Omega) / 2)

    start = momentum_and_energy(x)
    for _ in range(5):
        x = ode.integrate(lambda x: quadrotor.derivative(x, (0.0, 0.0, 0.0, 0.0), 1.0, *J), x, 1.0, 0.005)
        # RK4: (3 rad/s * 5 ms)^4 / 120 per radian, 4e-10, over 15 rad and a momentum of 3 N m s.
        assert_allclose(momentum_and_energy(x), start, atol=5e-8)
        R = oracles.split(x)[2]
        assert_allclose(R.T @ R, np.eye(3), atol=5e-8)
    assert oracles.split(x)[3][1] < 2.5  # it has tumbled


def test_a_body_without_thrust_falls_along_a_parabola():
    x = ode.integrate(
        lambda x: quadrotor.derivative(x, (0.0, 0.0, 0.0, 0.0)), state(v=(1, 2, -3), rotvec=(1, 0, 0)), 2.0, 0.01
    )
    # RK4 is exact on a parabola: 200 steps of rounding.
    assert_allclose(x[:6], [2, 4, -6 + 9.81 * 2, 1, 2, -3 + 9.81 * 2], atol=1e-12)


def test_default_parameters_are_the_papers():
    x, u = state(rotvec=(0.1, 0.2, 0.3), Omega=(1, 2, 3)), (10.0, 1.0, 2.0, 3.0)
    assert quadrotor.derivative(x, u) == quadrotor.derivative(x, u, 1.25, 1.1, 1.1, 2.2, 9.81, 0.0)
    assert quadrotor.Gains() == ((5, 5, 5), (0.5, 0.5, 2), (30, 30, 30), (5, 10, 20))


def test_desired_attitude_and_its_rates_are_those_of_the_curve(oracles):
    oracles.check_desired_attitude_against_spectral_differences(quadrotor)


def test_attitude_error_is_linear_under_the_law_with_true_parameters(oracles):
    oracles.check_control_gives_linear_attitude_error_dynamics(quadrotor)


def test_control_is_rotorpys_where_the_desired_attitude_stands_still(oracles):
    oracles.check_control_against_rotorpy(quadrotor)


def test_position_error_is_linear_where_the_attitude_is_the_desired_one(oracles):
    oracles.check_closed_loop_position_error_is_linear(quadrotor)


def test_hover_takes_the_weight_and_no_moment():
    m, inertia, g = PAPER
    zero = (0.0, 0.0, 0.0)
    hover = quadrotor.Trajectory((1.0, 2.0, 3.0), zero, zero, zero, zero, 0.4, 0.0, 0.0)
    x = state(r=(1, 2, 3), rotvec=(0, 0, 0.4))
    assert_allclose(quadrotor.control(x, hover, m, inertia, g), [m * g, 0, 0, 0], atol=1e-14)


def test_attitude_is_undefined_without_a_force_or_with_the_force_along_the_heading():
    zero = (0.0, 0.0, 0.0)
    with pytest.raises(ZeroDivisionError):
        quadrotor.desired_attitude(zero, zero, zero, 0.0, 0.0, 0.0)
    with pytest.raises(ZeroDivisionError):
        quadrotor.desired_attitude((2.0, 0.0, 0.0), zero, zero, 0.0, 0.0, 0.0)


def _papers_reference(t):
    return quadrotor.sinusoid_trajectory(t, (4.0, 5.0, 2.0), 0.4, "smooth")


def test_a_start_on_the_papers_trajectory_stays_on_it(oracles):
    """The desired attitude comes from the curve alone: on it, A = m (r_ddot_d - g e3)."""

    def attitude(t):
        d = _papers_reference(t)
        return oracles.gram_schmidt_attitude(np.subtract(d.a, (0, 0, 9.81)), d.psi)

    d = _papers_reference(0.0)
    R, R_dot = oracles.taylor(attitude, 0.2, 1)
    x0 = np.concatenate([d.r, d.v, R.ravel(), oracles.vee(R.T @ R_dot)])
    t = np.linspace(0, 2, 11)
    for t_k, x in zip(t, oracles.closed_loop(quadrotor, _papers_reference, x0, t, 1e-11), strict=True):
        d = _papers_reference(t_k)
        # The integrator's local 1e-11 over some hundred steps.
        assert_allclose(x[:6], [*d.r, *d.v], atol=1e-9)
        assert_allclose(x[6:15].reshape(3, 3), attitude(t_k), atol=1e-9)


def test_tracking_error_dies_out_as_the_linear_system_does(oracles):
    """The start is level and 1 m off; once the attitude has settled, the position's error is linear."""
    d = _papers_reference(0.0)
    t = np.array([0.0, 10.0, 30.0])
    x = oracles.closed_loop(quadrotor, _papers_reference, state(np.add(d.r, (1, -1, 1)), d.v), t, 1e-10)
    _, early, late = (
        x_k[:6] - np.concatenate([reference.r, reference.v]) for x_k, reference in zip(x, map(_papers_reference, t))
    )
    system = oracles.position_error_system(quadrotor.Gains(), PAPER[0])
    assert np.linalg.norm(early) > 0.1
    # The attitude's error, whose slowest pole is -1.9/s, is exp(-19) of its start after 10 s.
    assert_allclose(late, expm(20 * system) @ early, atol=1e-6)
    assert np.linalg.norm(late) < 0.05 * np.linalg.norm(early)


def test_arrays_of_points_give_the_same_bits_with_disturbances_at_some_of_them_only():
    rng = np.random.default_rng(3)
    x, u, m = rng.normal(size=(18, 40)), rng.normal(size=(10, 40)), rng.uniform(1.0, 2.0, 40)
    u[4:, ::2] = 0.0
    together = np.array([np.broadcast_to(row, 40) for row in quadrotor.derivative(x, u, m=m, J_x=0.9)])
    alone = [quadrotor.derivative(tuple(x[:, k]), tuple(u[:, k]), m=m[k], J_x=0.9) for k in range(40)]
    assert_array_equal(together.T, alone)
    at_some = quadrotor.derivative(x[:, ::2], u[:4, ::2], m=m[::2], J_x=0.9)
    quiet = np.array([np.broadcast_to(row, 20) for row in at_some])
    assert_array_equal(quiet, together[:, ::2])
