"""Independent truths for the physics. Each `check_` takes the module under test and raises AssertionError.

They take the module so that the tests can also hand them a wrong one (test_mutations.py).
Frames: ours are z down; RotorPy's are z up. T = diag(1, -1, -1), a half turn about x, takes one to the other, for
world and body alike: v_up = T v, R_up = T R T, Omega_up = T Omega, M_up = T M; a diagonal inertia stays as it is.
"""

from functools import cache
from itertools import count
from types import SimpleNamespace

import mujoco
import numpy as np
from numpy.polynomial import chebyshev
from numpy.testing import assert_allclose
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.vehicles.crazyflie_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipk

N_STATES = 200
ROUNDING = 1e-12
"""Both sides are a few dozen operations on numbers below 1e3: they differ by rounding alone."""
MUJOCO_POINT_MASS = 1e-8
"""MuJoCo wants an inertia of each body: 1e-12 kg m^2 here, at most 1e-9 of m l^2 >= 1e-3 kg m^2."""
SPECTRAL = 1e-9
"""Second derivatives of a Chebyshev interpolant: rounding times (points / half width)^2, about 1e-16 * 1e5 * 10."""
E3 = np.array([0.0, 0.0, 1.0])
T = np.diag([1.0, -1.0, -1.0])


# Tools.


def hat(a):
    """The matrix with hat(a) b = a x b."""
    return np.cross(a, np.eye(3), axisb=0, axisc=0)


def vee(m):
    """The vector of the skew part of M."""
    skew = (m - m.T) / 2
    return np.array([skew[2, 1], skew[0, 2], skew[1, 0]])


def taylor(f, half_width, n_derivatives=2, n_points=25):
    """f(0) and its derivatives at 0, from the Chebyshev interpolant of an analytic f on [-half_width, half_width].

    Spectrally exact where the nearest singularity of f is well outside the interval.
    """
    s = chebyshev.chebpts1(n_points)
    values = np.array([f(half_width * s_k) for s_k in s])
    c = chebyshev.chebfit(s, values.reshape(n_points, -1), n_points - 1)
    at_zero = [chebyshev.chebval(0.0, chebyshev.chebder(c, k)) / half_width**k for k in range(n_derivatives + 1)]
    return [a.reshape(values.shape[1:]) for a in at_zero]


def cauchy(p, q, multiply=np.multiply):
    """The product of two power series in time, truncated; p, q: (n_terms, ...)."""
    return np.array([sum(multiply(p[i], q[k - i]) for i in range(k + 1)) for k in range(len(p))])


def random_state(rng):
    """A state (18,) of the quadrotor at any attitude."""
    rotation = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    return np.concatenate([rng.normal(0, 3, 3), rng.normal(0, 3, 3), rotation.ravel(), rng.normal(0, 2, 3)])


def split(x):
    """Position, velocity, rotation matrix and body rates of a state (18,)."""
    x = np.asarray(x, dtype=float)
    return x[:3], x[3:6], x[6:15].reshape(3, 3), x[15:]


def floats(a):
    """A tuple of Python floats, what the modules take."""
    return tuple(float(a_k) for a_k in np.ravel(a))


def random_body(rng):
    """Mass, principal inertia (of three lengths, so that no body is impossible) and gravity."""
    lengths = rng.uniform(0.3, 2, 3)
    inertia = lengths.sum() - lengths
    return float(rng.uniform(0.5, 4)), floats(inertia), float(rng.uniform(5, 15))


# Pendulum.


@cache
def _mujoco_pendulum():
    model = mujoco.MjModel.from_xml_string("""
        <mujoco><worldbody><body><joint type="hinge" axis="0 1 0"/>
        <inertial pos="0 0 -1" mass="1" diaginertia="1e-12 1e-12 1e-12"/></body></worldbody></mujoco>""")
    return model, mujoco.MjData(model)


def _pendulum_in_mujoco(x, m, l, b, g):
    """The model and its data: force b/m phi_dot per mass at the radius l is the joint damping b l^2."""
    model, data = _mujoco_pendulum()
    model.body_mass[1], model.body_ipos[1] = m, (0, 0, -l)
    model.dof_damping[0] = b * l**2
    model.opt.gravity = (0, 0, -g)
    mujoco.mj_setConst(model, data)
    data.qpos[0], data.qvel[0] = x
    return model, data


def _pendulum_cases():
    rng = np.random.default_rng(1)
    for _ in range(N_STATES):
        x = floats([rng.uniform(-np.pi, np.pi), rng.normal(0, 3)])
        m, l, b, g = floats(rng.uniform([0.1, 0.1, 0, 5], [5, 3, 2, 15]))
        yield rng, x, m, l, b, g


def check_pendulum_derivative_against_mujoco(pendulum):
    for rng, x, m, l, b, g in _pendulum_cases():
        u = float(rng.normal(0, 5))
        model, data = _pendulum_in_mujoco(x, m, l, b, g)
        data.qfrc_applied[0] = u * l
        mujoco.mj_forward(model, data)
        expected = data.qvel[0], data.qacc[0]
        assert_allclose(pendulum.derivative(x, (u,), m, l, b, g), expected, MUJOCO_POINT_MASS, MUJOCO_POINT_MASS)


def check_pendulum_disturbance_and_dry_friction_against_mujoco(pendulum):
    """Tangential forces are torques with the arm l; dry friction is F_c (e^s - e^-s)/(e^s + e^-s), s the speed
    over 10 mm/s."""
    for rng, x, m, l, b, g in _pendulum_cases():
        u, F_d = floats(rng.normal(0, 5, 2))
        F_c, x = float(rng.uniform(0, 3)), (x[0], x[1] * 10.0 ** float(rng.uniform(-4, 0)))
        s = float(np.clip(l * x[1] / 0.01, -300, 300))
        model, data = _pendulum_in_mujoco(x, m, l, b, g)
        data.qfrc_applied[0] = l * (u + F_d - F_c * (np.exp(s) - np.exp(-s)) / (np.exp(s) + np.exp(-s)))
        mujoco.mj_forward(model, data)
        expected = data.qvel[0], data.qacc[0]
        assert_allclose(pendulum.derivative(x, (u, F_d), m, l, b, g, F_c), expected, MUJOCO_POINT_MASS, 1e-7)


def check_pendulum_dry_friction_stops_it(pendulum):
    """Without weight the speed falls by F_c/m a second, to rest after m v0/F_c."""
    m, l, F_c, v0 = 1.5, 0.8, 0.9, 2.0
    t = np.array([0.0, 1.0, 2.0, 3.0, 4.0])  # rest after 3.33 s
    x = solve_ivp(
        lambda _, x: pendulum.derivative(floats(x), (0.0,), m, l, 0.0, 0.0, F_c),
        (0, 4), (0.0, v0 / l), "Radau", t, rtol=1e-9, atol=1e-10,
    ).y  # fmt: skip
    # The last 10 mm/s decay smoothly instead, with m 10 mm/s / F_c = 17 ms.
    assert_allclose(l * x[1], np.maximum(v0 - F_c / m * t, 0.0), atol=1e-6)


def check_pendulum_control_against_mujoco_inverse_dynamics(pendulum):
    """The force that gives the acceleration Kp e1 + Kd e2, by MuJoCo's inverse dynamics."""
    for rng, x, m, l, b, g in _pendulum_cases():
        x_ref = floats(rng.normal(0, 1, 2))
        Kp, Kd = floats(rng.uniform(1, 20, 2))
        model, data = _pendulum_in_mujoco(x, m, l, b, g)
        data.qacc[0] = Kp * (x_ref[0] - x[0]) + Kd * (x_ref[1] - x[1])
        mujoco.mj_inverse(model, data)
        expected = data.qfrc_inverse[0] / l
        assert_allclose(pendulum.control(x, x_ref, m, l, b, g, Kp, Kd), expected, MUJOCO_POINT_MASS, MUJOCO_POINT_MASS)


def check_pendulum_energy_balance(pendulum):
    """d/dt (m l^2 w^2/2 - m g l cos phi) is the power u l w of the input less b l^2 w^2 of friction."""
    for rng, x, m, l, b, g in _pendulum_cases():
        u = float(rng.normal(0, 5))
        phi_dot, phi_ddot = pendulum.derivative(x, (u,), m, l, b, g)
        power = m * l**2 * x[1] * phi_ddot + m * g * l * np.sin(x[0]) * phi_dot
        assert_allclose(power, u * l * x[1] - b * l**2 * x[1] ** 2, ROUNDING, ROUNDING)


def check_pendulum_swing_against_elliptic_functions(pendulum):
    """Released at rest: sin(phi/2) = k cd(sqrt(g/l) t | k^2), k = sin(phi0/2); period 4 K(k^2) sqrt(l/g)."""
    phi0, l, g = 2.5, 0.75, 9.81
    k, rate = np.sin(phi0 / 2), np.sqrt(g / l)
    t = np.linspace(0, 4 * ellipk(k**2) / rate, 50)
    _, cn, dn, _ = ellipj(rate * t, k**2)
    x = solve_ivp(
        lambda _, x: pendulum.derivative(floats(x), (0.0,), l=l, b=0.0, g=g),
        (0, t[-1]),
        (phi0, 0.0),
        "DOP853",
        rtol=1e-12,
        atol=1e-12,
        t_eval=t,
    ).y
    # The integrator's local 1e-12 over about a hundred steps, and its interpolant of order 7 between them.
    assert_allclose(x[0], 2 * np.arcsin(k * cn / dn), atol=1e-8)
    energy = x[1] ** 2 / 2 - rate**2 * np.cos(x[0])
    assert_allclose(energy, energy[0], atol=1e-8)


def check_pendulum_closed_loop_error(pendulum):
    """Where the parameters are true, (e1, e2) is expm(t [[0, 1], [-Kp, -Kd]]) times its start."""
    Kp, Kd, x_ref, x0 = 10.0, 5.0, (1.0, 0.0), (-0.5, 2.0)
    p = {"m": 4.271, "l": 0.981, "b": 0.3, "g": 9.81}

    def f(_, x):
        x = floats(x)
        return pendulum.derivative(x, (pendulum.control(x, x_ref, Kp=Kp, Kd=Kd, **p),), **p)

    t = np.linspace(0, 3, 20)
    x = solve_ivp(f, (0, 3), x0, "DOP853", rtol=1e-12, atol=1e-12, t_eval=t).y.T
    e0 = np.subtract(x_ref, x0)
    expected = [x_ref - expm(t_k * np.array([[0, 1], [-Kp, -Kd]])) @ e0 for t_k in t]
    # As for the swing: the interpolant between the integrator's steps.
    assert_allclose(x, expected, atol=1e-8)


# Quadrotor: the plant.


@cache
def _mujoco_quadrotor():
    model = mujoco.MjModel.from_xml_string("""
        <mujoco><worldbody><body><freejoint/>
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>""")
    return model, mujoco.MjData(model)


def _quadratic(q, to_matrix):
    """|q|^2 R(q), a quadratic form in q: its central difference of any width is its exact derivative."""
    return (q @ q) * to_matrix(q / np.linalg.norm(q))


def _rotation_rate(q, q_dot, to_matrix):
    return (_quadratic(q + q_dot, to_matrix) - _quadratic(q - q_dot, to_matrix)) / 2


def _mujoco_matrix(q):
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, q)
    return matrix.reshape(3, 3)


def _quadrotor_cases(seed=2, n=N_STATES):
    rng = np.random.default_rng(seed)
    for _ in range(n):
        m, J, g = random_body(rng)
        yield random_state(rng), floats([rng.normal(10, 5), *rng.normal(0, 3, 3)]), m, J, g


def check_quadrotor_derivative_against_mujoco(quadrotor):
    """A free body under a wrench; its linear velocity is in the world's frame, its rates in the body's."""
    for x, u, m, J, g in _quadrotor_cases():
        r, v, R, Omega = split(x)
        model, data = _mujoco_quadrotor()
        model.body_mass[1], model.body_inertia[1] = m, J
        model.opt.gravity = (0, 0, g)
        mujoco.mj_setConst(model, data)
        q, q_dot = np.empty(4), np.empty(4)
        mujoco.mju_mat2Quat(q, R.ravel())
        data.qpos, data.qvel = np.concatenate([r, q]), np.concatenate([v, Omega])
        data.xfrc_applied[1] = np.concatenate([-u[0] * R @ E3, R @ u[1:]])
        mujoco.mj_forward(model, data)
        mujoco.mju_derivQuat(q_dot, q, data.cvel[1, :3])  # the angular velocity in the world's frame
        expected = [data.qvel[:3], data.qacc[:3], _rotation_rate(q, q_dot, _mujoco_matrix).ravel(), data.qacc[3:]]
        derivative = quadrotor.derivative(floats(x), u, m, *J, g)
        assert_allclose(derivative, np.concatenate(expected), ROUNDING, 10 * ROUNDING)


def check_quadrotor_disturbance_and_drag_against_mujoco(quadrotor):
    """Forces in the world's frame, the moment turned into it."""
    rng = np.random.default_rng(40)
    for x, u, m, J, g in _quadrotor_cases(41):
        r, v, R, Omega = split(x)
        F_d, M_d, k_d = rng.normal(0, 4, 3), rng.normal(0, 2, 3), float(rng.uniform(0, 2))
        model, data = _mujoco_quadrotor()
        model.body_mass[1], model.body_inertia[1] = m, J
        model.opt.gravity = (0, 0, g)
        mujoco.mj_setConst(model, data)
        q = np.empty(4)
        mujoco.mju_mat2Quat(q, R.ravel())
        data.qpos, data.qvel = np.concatenate([r, q]), np.concatenate([v, Omega])
        data.xfrc_applied[1] = np.concatenate([F_d - k_d * v - u[0] * R @ E3, R @ (M_d + u[1:])])
        mujoco.mj_forward(model, data)
        _, v_dot, _, Omega_dot = split(quadrotor.derivative(floats(x), (*u, *floats(F_d), *floats(M_d)), m, *J, g, k_d))
        assert_allclose([*v_dot, *Omega_dot], data.qacc, ROUNDING, 10 * ROUNDING)


def check_quadrotor_terminal_velocity(quadrotor):
    """A fall from rest: v = (m g/k_d) (1 - exp(-k_d t/m)) downwards, and with the wind's force for m g along it."""
    m, g, k_d, F = 1.3, 9.81, 0.7, (1.5, -2.0, 0.0)
    x0 = (*np.zeros(6), *np.eye(3).ravel(), *np.zeros(3))
    t = np.array([0.0, 0.5, 2.0, 40.0])
    v = solve_ivp(
        lambda _, x: quadrotor.derivative(floats(x), (0.0,) * 4 + F + (0.0,) * 3, m, g=g, k_d=k_d),
        (0, 40), x0, "DOP853", t, rtol=1e-11, atol=1e-11,
    ).y[3:6]  # fmt: skip
    expected = np.outer(np.add(F, (0.0, 0.0, m * g)) / k_d, 1 - np.exp(-k_d * t / m))
    assert_allclose(v, expected, atol=1e-8)
    assert_allclose(v[2, -1], m * g / k_d, atol=1e-7)


class _Wrenched(Multirotor):
    """RotorPy's rigid body under a wrench of our choice, without rotors and drag."""

    wrench = np.zeros(3), np.zeros(3)

    def compute_body_wrench(self, *_):
        return self.wrench


def _rotorpy_params(m, J):
    return quad_params | dict(zip(("mass", "Ixx", "Iyy", "Izz"), (m, *J), strict=True))


def check_quadrotor_derivative_against_rotorpy(quadrotor):
    for x, u, m, J, g in _quadrotor_cases(3):
        r, v, R, Omega = split(x)
        body = _Wrenched(_rotorpy_params(m, J))
        body.weight = np.array([0, 0, -m * g])
        body.wrench = u[0] * E3, T @ u[1:]
        q = Rotation.from_matrix(T @ R @ T).as_quat()
        state = {"x": T @ r, "v": T @ v, "q": q, "w": T @ Omega, "wind": np.zeros(3), "rotor_speeds": np.zeros(4)}
        s_dot = body._s_dot_fn(0.0, Multirotor._pack_state(state), np.zeros(4))
        R_dot = _rotation_rate(q, s_dot[6:10], lambda q: Rotation.from_quat(q).as_matrix())
        expected = [T @ s_dot[:3], T @ s_dot[3:6], (T @ R_dot @ T).ravel(), T @ s_dot[10:13]]
        derivative = quadrotor.derivative(floats(x), u, m, *J, g)
        assert_allclose(derivative, np.concatenate(expected), ROUNDING, 10 * ROUNDING)


def check_quadrotor_momentum_and_energy_balance(quadrotor):
    """The rate of R J Omega is R M; that of the energy is the power of thrust and moment."""
    for x, u, m, J, g in _quadrotor_cases(4):
        _, v, R, Omega = split(x)
        r_dot, v_dot, R_dot, Omega_dot = split(quadrotor.derivative(floats(x), u, m, *J, g))
        M = np.array(u[1:])
        J = np.diag(J)
        assert_allclose(R_dot @ J @ Omega + R @ J @ Omega_dot, R @ M, ROUNDING, 10 * ROUNDING)
        power = m * v @ v_dot - m * g * r_dot[2] + Omega @ J @ Omega_dot
        assert_allclose(power, -u[0] * v @ R @ E3 + M @ Omega, ROUNDING, 100 * ROUNDING)


# Quadrotor: the controller.


def gram_schmidt_attitude(A, psi):
    """[b1 b2 b3] with b3 = -A/|A| and b1 the part of the heading that is normal to it."""
    b3 = -A / np.linalg.norm(A)
    heading = np.array([np.cos(psi), np.sin(psi), 0])
    b1 = heading - (heading @ b3) * b3
    b1 = b1 / np.linalg.norm(b1)
    return np.column_stack([b1, np.cross(b3, b1), b3])


def _attitude_derivatives(A, psi):
    """R_d, R_d_dot, R_d_ddot along A(t) = A[0] + A[1] t + A[2] t^2 and the same for psi; a tenth of the time in which
    the direction can turn keeps the interval far from the singularities."""
    margin = np.linalg.norm(np.cross(A[0], [np.cos(psi[0]), np.sin(psi[0]), 0]))
    rates = np.linalg.norm(A[1]) / margin, np.sqrt(np.linalg.norm(A[2]) / margin), abs(psi[1]), abs(psi[2]) ** 0.5
    powers = np.arange(3)
    return taylor(lambda t: gram_schmidt_attitude(t**powers @ A, t**powers @ psi), 0.1 / (1 + max(rates)))


def check_desired_attitude_against_spectral_differences(quadrotor):
    rng = np.random.default_rng(5)
    for _ in range(100):
        A = np.array([[0, 0, -12], [0, 0, 0], [0, 0, 0]]) + rng.normal(0, 3, (3, 3))
        psi = rng.uniform(-3, 3, 3)
        R, R_dot, R_ddot = _attitude_derivatives(A, psi)
        attitude = quadrotor.desired_attitude(
            floats(A[0]), floats(A[1]), floats(2 * A[2]), *floats(psi * np.array([1, 1, 2]))
        )
        assert_allclose(np.reshape(attitude.R, (3, 3)), R, atol=ROUNDING)
        assert_allclose(attitude.Omega, vee(R.T @ R_dot), SPECTRAL, SPECTRAL)
        # R^T R_ddot is hat(Omega)^2 + hat(Omega_dot): its skew part is the second.
        assert_allclose(attitude.Omega_dot, vee(R.T @ R_ddot), SPECTRAL, SPECTRAL)


def _random_gains(quadrotor, rng):
    return quadrotor.Gains(*(floats(rng.uniform(low, high, 3)) for low, high in ((1, 6), (0.5, 3), (10, 40), (5, 20))))


def _random_trajectory(rng, x, scale=1.0):
    """Desired derivatives near the state's own, so that the force stays away from zero."""
    r, v, _, _ = split(x)
    return SimpleNamespace(
        r=r + rng.normal(0, 0.5, 3),
        v=v + rng.normal(0, 0.5, 3),
        **{name: rng.normal(0, scale, 3) for name in "ajs"},
        **{name: float(rng.normal(0, 1)) for name in ("psi", "psi_dot", "psi_ddot")},
    )


def _as_trajectory(quadrotor, d):
    return quadrotor.Trajectory(*map(floats, (d.r, d.v, d.a, d.j, d.s)), d.psi, d.psi_dot, d.psi_ddot)


def force_series(x, d, m, g, gains):
    """A(t) to the second power of t, along the motion that the law's own thrust gives: Picard's iteration on power
    series, from  m v_dot = m g e3 - F R e3,  F = -A . R e3,  R = R(0) exp(hat(Omega) t).

    To this power Omega_dot does not enter.
    """
    r0, v0, R, Omega = split(x)
    K_r, K_v = np.array(gains.K_r), np.array(gains.K_v)
    b3 = np.array([R @ E3, R @ np.cross(Omega, E3), R @ np.cross(Omega, np.cross(Omega, E3)) / 2])
    zero = np.zeros(3)
    gravity = np.array([g * E3, zero, zero])
    r, v = np.array([r0, v0, zero]), np.array([v0, zero, zero])
    for _ in range(3):
        e_r, e_v = r - [d.r, d.v, d.a / 2], v - [d.v, d.a, d.j / 2]
        A = -K_r * e_r - K_v * e_v + m * (np.array([d.a, d.j, d.s / 2]) - gravity)
        a = gravity + cauchy(cauchy(A, b3, np.dot), b3) / m
        r, v = np.array([r0, v0, a[0] / 2]), np.array([v0, a[0], a[1] / 2])
    return A


def check_control_gives_linear_attitude_error_dynamics(quadrotor):
    """Euler's equation under the law's moment makes J e_Omega_dot = -K_R e_R - K_Omega e_Omega.

    The errors come from the curve Q(t) = R_d^T R: e_R is the vector of its skew part, e_Omega its body rate.
    """
    rng = np.random.default_rng(6)
    for x, _, m, J, g in _quadrotor_cases(7, 100):
        d, gains = _random_trajectory(rng, x), _random_gains(quadrotor, rng)
        R, Omega = split(x)[2:]
        F, *M = quadrotor.control(floats(x), _as_trajectory(quadrotor, d), m, J, g, gains)
        A = force_series(x, d, m, g, gains)
        assert_allclose(F, -A[0] @ R @ E3, ROUNDING, 10 * ROUNDING)
        J = np.array(J)
        Omega_dot = (M - np.cross(Omega, J * Omega)) / J
        R_t = R, R @ hat(Omega), R @ (hat(Omega) @ hat(Omega) + hat(Omega_dot))
        D_t = _attitude_derivatives(A, np.array([d.psi, d.psi_dot, d.psi_ddot / 2]))
        Q = D_t[0].T @ R_t[0]
        Q_dot = D_t[1].T @ R_t[0] + D_t[0].T @ R_t[1]
        Q_ddot = D_t[2].T @ R_t[0] + 2 * D_t[1].T @ R_t[1] + D_t[0].T @ R_t[2]
        e_R, e_Omega, e_Omega_dot = vee(Q), vee(Q.T @ Q_dot), vee(Q.T @ Q_ddot)
        scale = 1 + np.abs(M).max() + np.abs(D_t[2]).max()
        # Relative to the desired angular acceleration, which a force near zero makes large.
        assert_allclose(
            J * e_Omega_dot / scale,
            -(np.multiply(gains.K_R, e_R) + np.multiply(gains.K_Omega, e_Omega)) / scale,
            atol=SPECTRAL,
        )


def check_control_against_rotorpy(quadrotor):
    """RotorPy's controller has no Omega_d: the two coincide where A and psi stand still. Its gains are per mass and
    per inertia; its yaw turns the other way."""
    rng = np.random.default_rng(8)
    for x, _, m, J, g in _quadrotor_cases(9):
        d, gains = _random_trajectory(rng, x), _random_gains(quadrotor, rng)
        d.j, d.s, d.psi_dot, d.psi_ddot = np.zeros(3), np.zeros(3), 0.0, 0.0
        d.j = -force_series(x, d, m, g, gains)[1] / m
        d.s = -2 * force_series(x, d, m, g, gains)[2] / m
        r, v, R, Omega = split(x)
        controller = SE3Control(_rotorpy_params(m, J))
        controller.g = g
        controller.kp_pos, controller.kd_pos = np.array(gains.K_r) / m, np.array(gains.K_v) / m
        controller.kp_att, controller.kd_att = np.array(gains.K_R) / J, np.array(gains.K_Omega) / J
        state = {"x": T @ r, "v": T @ v, "q": Rotation.from_matrix(T @ R @ T).as_quat(), "w": T @ Omega}
        flat = {"x": T @ d.r, "x_dot": T @ d.v, "x_ddot": T @ d.a, "yaw": -d.psi, "yaw_dot": 0.0}
        command = controller.update(0.0, state, flat)
        expected = [command["cmd_thrust"], *(T @ command["cmd_moment"])]
        # The A_dot and A_ddot that cancel leave rounding; a small A magnifies it.
        tolerance = 1e-11 * (1 + 1 / np.linalg.norm(force_series(x, d, m, g, gains)[0]))
        assert_allclose(
            quadrotor.control(floats(x), _as_trajectory(quadrotor, d), m, J, g, gains), expected, 1e-11, tolerance
        )


def closed_loop(quadrotor, reference, x0, t, rtol, m=1.25, J=(1.1, 1.1, 2.2), g=9.81):
    """States at the times t of the quadrotor under the law with the true parameters, recomputed at each instant."""

    calls = count()

    def f(t, x):
        assert next(calls) < 50_000, f"the closed loop must not stall the integrator, at t = {t} s"
        x = floats(x)
        return quadrotor.derivative(x, quadrotor.control(x, reference(t), m, J, g, quadrotor.Gains()), m, *J, g)

    return solve_ivp(f, (0, t[-1]), x0, "DOP853", rtol=rtol, atol=rtol, t_eval=t).y.T


def position_error_system(gains, m):
    """The matrix of  m e_ddot + K_v e_dot + K_r e = 0  in each axis, for (e, e_dot)."""
    return np.block([[np.zeros((3, 3)), np.eye(3)], [-np.diag(gains.K_r) / m, -np.diag(gains.K_v) / m]])


def check_closed_loop_position_error_is_linear(quadrotor):
    """Started with R = R_d and Omega = Omega_d they stay equal, -F R e3 is A, and the error of the position follows
    m e_ddot + K_v e_dot + K_r e = 0 in each axis, whatever it was at the start."""
    m, g, omega, gains = 1.25, 9.81, 0.9, quadrotor.Gains()
    amplitude, phase = np.array([2.0, 1.5, 1.0]), np.array([0.3, 1.1, 2.0])

    def r_d(t, k):
        return amplitude * omega**k * np.sin(omega * t + phase + k * np.pi / 2)

    def psi_d(t):
        return 0.5 * np.sin(0.7 * t)

    def reference(t):
        rates = 0.35 * np.cos(0.7 * t), -0.245 * np.sin(0.7 * t)
        return quadrotor.Trajectory(*(floats(r_d(t, k)) for k in range(5)), *floats([psi_d(t), *rates]))

    system = position_error_system(gains, m)
    start = np.array([0.8, -0.6, 0.5, 0.3, -0.4, 0.7])

    def error(t):
        return expm(system * t) @ start

    def attitude(t):
        force = m * (r_d(t, 2) + (system @ error(t))[3:] - g * E3)
        return gram_schmidt_attitude(force, psi_d(t))

    R, R_dot = taylor(attitude, 0.2, 1)
    x0 = np.concatenate([r_d(0, 0) + start[:3], r_d(0, 1) + start[3:], R.ravel(), vee(R.T @ R_dot)])
    t = np.linspace(0, 2, 11)
    for t_k, x in zip(t, closed_loop(quadrotor, reference, x0, t, 1e-11), strict=True):
        # The integrator's local 1e-11 over some hundred steps.
        assert_allclose(x[:6], np.concatenate([r_d(t_k, 0), r_d(t_k, 1)]) + error(t_k), atol=1e-9)
        assert_allclose(x[6:15].reshape(3, 3), attitude(t_k), atol=1e-9)


# Rigid body.


def random_rigid_body(rng):
    """Mass, centre of mass, inertia (J_xx, J_yy, J_zz, J_xy, J_xz, J_yz) of a possible body, and gravity."""
    m, principal, g = random_body(rng)
    axes = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    J = axes @ np.diag(principal) @ axes.T
    return m, floats(rng.uniform(-0.3, 0.3, 3)), floats([*np.diag(J), J[0, 1], J[0, 2], J[1, 2]]), g


def inertia_matrix(J):
    """The matrix of (J_xx, J_yy, J_zz, J_xy, J_xz, J_yz)."""
    upper = np.array([[0, J[3], J[4]], [0, 0, J[5]], [0, 0, 0]])
    return np.diag(J[:3]) + upper + upper.T


def _rigid_body_cases(seed, n=N_STATES):
    rng = np.random.default_rng(seed)
    for _ in range(n):
        yield rng, random_state(rng), floats(rng.normal(0, 8, 6)), *random_rigid_body(rng)


@cache
def _mujoco_rigid_body():
    """Compiled off its centre and axes, or MuJoCo would take the body for a simple one."""
    model = mujoco.MjModel.from_xml_string("""
        <mujoco><worldbody><body><freejoint/>
        <inertial pos="0.1 0.2 0.3" quat="0.1 0.3 0.5 0.7" mass="1" diaginertia="1 1.1 1.2"/>
        </body></worldbody></mujoco>""")
    return model, mujoco.MjData(model)


def _rigid_body_in_mujoco(x, m, c, J, g):
    """The free body with its inertia along its principal axes; velocities: of the origin in the world, body rates."""
    r, v, R, Omega = split(x)
    model, data = _mujoco_rigid_body()
    principal, axes = np.linalg.eigh(inertia_matrix(J))
    axes[:, 2] *= np.linalg.det(axes)
    model.body_mass[1], model.body_inertia[1], model.body_ipos[1] = m, principal, c
    mujoco.mju_mat2Quat(model.body_iquat[1], axes.ravel())
    model.opt.gravity = (0, 0, g)
    mujoco.mj_setConst(model, data)
    q = np.empty(4)
    mujoco.mju_mat2Quat(q, R.ravel())
    data.qpos, data.qvel = np.concatenate([r, q]), np.concatenate([v, Omega])
    return model, data


def _rigid_body_accelerations(x, u, m, c, J, g):
    """v_dot and Omega_dot in MuJoCo: the wrench at the origin is dual to the velocities, R F and M."""
    model, data = _rigid_body_in_mujoco(x, m, c, J, g)
    data.qfrc_applied = np.concatenate([split(x)[2] @ u[:3], u[3:]])
    mujoco.mj_forward(model, data)
    return data.qacc[:3].copy(), data.qacc[3:].copy()


def check_rigid_body_derivative_against_mujoco(rigid_body):
    for _, x, u, m, c, J, g in _rigid_body_cases(20):
        _, v, R, Omega = split(x)
        v_dot, Omega_dot = _rigid_body_accelerations(x, np.array(u), m, c, J, g)
        expected = np.concatenate([v, v_dot, (R @ hat(Omega)).ravel(), Omega_dot])
        derivative = rigid_body.derivative(floats(x), u, m, *c, *J, g)
        # Rounding, times the condition of the inertia, below 100.
        assert_allclose(derivative, expected, 100 * ROUNDING, 100 * ROUNDING)


def check_rigid_body_disturbance_and_drag_against_mujoco(rigid_body):
    """MuJoCo's forces on a free body's origin are in the world's frame, its moments in the body's."""
    for rng, x, u, m, c, J, g in _rigid_body_cases(42):
        _, v, R, _ = split(x)
        F_d, M_d, k_d = rng.normal(0, 4, 3), rng.normal(0, 2, 3), float(rng.uniform(0, 2))
        model, data = _rigid_body_in_mujoco(x, m, c, J, g)
        data.qfrc_applied = np.concatenate([R @ u[:3] + F_d - k_d * v, M_d + u[3:]])
        mujoco.mj_forward(model, data)
        derivative = rigid_body.derivative(floats(x), (*u, *floats(F_d), *floats(M_d)), m, *c, *J, g, k_d)
        _, v_dot, _, Omega_dot = split(derivative)
        # Rounding, times the condition of the inertia, below 100.
        assert_allclose([*v_dot, *Omega_dot], data.qacc, 100 * ROUNDING, 100 * ROUNDING)


def check_rigid_body_terminal_velocity(rigid_body):
    """With its centre of mass at the origin, it comes to fall at m g/k_d."""
    m, g, k_d = 2.0, 9.81, 1.1
    x0 = (*np.zeros(6), *Rotation.from_rotvec((0.3, 0.5, -1.0)).as_matrix().ravel(), 0.5, -0.2, 0.3)
    t = np.array([0.0, 0.5, 2.0, 10.0])  # to 10 s, as a wrong sign blows up, which takes minutes in 40 s
    v = solve_ivp(
        lambda _, x: rigid_body.derivative(floats(x), (0.0,) * 6, m, g=g, k_d=k_d),
        (0, 10), x0, "DOP853", t, rtol=1e-11, atol=1e-11,
    ).y[3:6]  # fmt: skip
    assert_allclose(v, np.outer(E3, m * g / k_d * (1 - np.exp(-k_d * t / m))), atol=1e-8)


def _rigid_body_invariants(x, m, c, J):
    """Centre of mass, momentum, angular momentum about the inertial origin and kinetic energy; x may be complex."""
    r, v, R, Omega = x[:3], x[3:6], x[6:15].reshape(3, 3), x[15:]
    r_c, p, spin = r + R @ c, m * (v + R @ np.cross(Omega, c)), inertia_matrix(J) @ Omega
    return r_c, p, np.cross(r_c, p) + R @ spin, p @ p / (2 * m) + Omega @ spin / 2


def check_rigid_body_momentum_and_energy_balance(rigid_body):
    """p_dot = R F + m g e3;  L_dot = r x R F + R M + r_c x m g e3;  the power is F . R^T v + M . Omega + m g e3 . v_c.

    The rates come from a complex step along the derivative, which is exact to rounding.
    """
    for _, x, u, m, c, J, g in _rigid_body_cases(21):
        r, v, R, Omega = split(x)
        F, M, h = np.array(u[:3]), np.array(u[3:]), 1e-30
        x_dot = np.array(rigid_body.derivative(floats(x), u, m, *c, *J, g))
        r_c, p, L, energy = _rigid_body_invariants(x + 1j * h * x_dot, m, np.array(c), J)
        assert_allclose(p.imag / h, R @ F + m * g * E3, 100 * ROUNDING, 1000 * ROUNDING)
        moment = np.cross(r, R @ F) + R @ M + np.cross(r_c.real, m * g * E3)
        assert_allclose(L.imag / h, moment, 100 * ROUNDING, 1000 * ROUNDING)
        power = F @ R.T @ v + M @ Omega + g * p.real[2]
        assert_allclose(energy.imag / h, power, 100 * ROUNDING, 1000 * ROUNDING)


def check_rigid_body_free_flight(rigid_body):
    """Without a wrench the centre of mass flies a parabola, and angular momentum about it and energy stay."""
    for _, x, _, m, c, J, g in _rigid_body_cases(22, 5):
        calls = count()

        def f(_, x, p=(m, *c, *J, g), calls=calls):
            assert next(calls) < 50_000, f"free flight must not stall the integrator, at x = {x}"
            return rigid_body.derivative(floats(x), (0.0,) * 6, *p)

        t = np.linspace(0, 2, 5)
        states = solve_ivp(f, (0, 2), x, "DOP853", t, rtol=1e-12, atol=1e-12).y.T
        r_0, p_0, L_0, energy = _rigid_body_invariants(x, m, np.array(c), J)
        spin = L_0 - np.cross(r_0, p_0)
        for t_k, x_k in zip(t, states, strict=True):
            r_c, p, L, energy_k = _rigid_body_invariants(x_k, m, np.array(c), J)
            fall = g * t_k**2 / 2 * E3
            # The integrator's local 1e-12 over some hundred steps, and its interpolant between them.
            assert_allclose(r_c, r_0 + p_0 / m * t_k + fall, 1e-8, 1e-8)
            assert_allclose(L - np.cross(r_c, p), spin, 1e-8, 1e-8)
            assert_allclose(energy_k - m * g * (r_c - r_0)[2], energy, 1e-8, 1e-8)


def check_rigid_body_control_gives_linear_errors(rigid_body):
    """Under the law's wrench MuJoCo's body has e_r_ddot = -K_r e_r - K_v e_v, and e_Omega_dot = -K_R e_R - K_Omega
    e_Omega along the curve Q(t) = R_d^T R: e_R is the vector of its skew part, e_Omega its body rate."""
    for rng, x, _, m, c, J, g in _rigid_body_cases(23, 100):
        gains = rigid_body.Gains(*floats(rng.uniform(1, 20, 4)))
        r_d, v_d, a_d, W, W_dot = rng.normal(0, 2, (5, 3))
        R_d = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
        d = rigid_body.Motion(*map(floats, (r_d, v_d, a_d, R_d, W, W_dot)))
        r, v, R, Omega = split(x)
        u = np.array(rigid_body.control(floats(x), d, m, c, J, g, gains))
        v_dot, Omega_dot = _rigid_body_accelerations(x, u, m, c, J, g)
        assert_allclose(v_dot - a_d, -gains.K_r * (r - r_d) - gains.K_v * (v - v_d), SPECTRAL, SPECTRAL)
        R_t = R, R @ hat(Omega), R @ (hat(Omega) @ hat(Omega) + hat(Omega_dot))
        D_t = R_d, R_d @ hat(W), R_d @ (hat(W) @ hat(W) + hat(W_dot))
        Q = D_t[0].T @ R_t[0]
        Q_dot = D_t[1].T @ R_t[0] + D_t[0].T @ R_t[1]
        Q_ddot = D_t[2].T @ R_t[0] + 2 * D_t[1].T @ R_t[1] + D_t[0].T @ R_t[2]
        errors = -gains.K_R * vee(Q) - gains.K_Omega * vee(Q.T @ Q_dot)
        # Rounding of accelerations up to 1e3, times the condition of the inertia.
        assert_allclose(vee(Q.T @ Q_ddot), errors, SPECTRAL, SPECTRAL)


def check_rigid_body_closed_loop_errors(rigid_body):
    """The position's error is expm of its linear system, at any attitude; turned off about one axis n the body comes
    back about n as theta_ddot = -K_R sin theta - K_Omega theta_dot."""
    rng = np.random.default_rng(24)
    m, c, J, g = random_rigid_body(rng)
    gains, n = rigid_body.Gains(), np.array([0.48, -0.6, 0.64])
    shape = (0.5, 0.4, 0.3), (0.3, 0.4, 0.5), 1.2
    start, (theta, theta_dot) = rng.normal(0, 0.5, 6), (1.2, -0.8)

    def f(t, x):
        x = floats(x)
        u = rigid_body.control(x, rigid_body.motion(t, *shape), m, c, J, g)
        return np.clip(rigid_body.derivative(x, u, m, *c, *J, g), -1e4, 1e4)  # a wrong law may run away

    def desired(t):
        d = rigid_body.motion(float(t), *shape)
        return np.array([*d.r, *d.v]), np.reshape(d.R, (3, 3)), np.array(d.Omega)

    x_d, R_d, Omega_d = desired(0.0)
    turn = Rotation.from_rotvec(theta * n).as_matrix()
    x0 = np.concatenate([x_d + start, (R_d @ turn).ravel(), turn.T @ Omega_d + theta_dot * n])
    t = np.linspace(0, 1.5, 7)
    states = solve_ivp(f, (0, t[-1]), x0, "DOP853", t, rtol=1e-10, atol=1e-10).y.T
    angle = solve_ivp(
        lambda _, y: (y[1], -gains.K_R * np.sin(y[0]) - gains.K_Omega * y[1]),
        (0, t[-1]), (theta, theta_dot), "DOP853", t, rtol=1e-11, atol=1e-11,
    ).y  # fmt: skip
    system = np.kron([[0, 1], [-gains.K_r, -gains.K_v]], np.eye(3))
    for k, x in enumerate(states):
        x_d, R_d, _ = desired(t[k])
        # The integrator's local 1e-10 over some hundred steps.
        assert_allclose(x[:6] - x_d, expm(t[k] * system) @ start, atol=1e-7)
        expected = R_d @ Rotation.from_rotvec(angle[0, k] * n).as_matrix()
        assert_allclose(x[6:15].reshape(3, 3), expected, atol=1e-7)


def check_rigid_body_motion_against_spectral_differences(rigid_body):
    """The curve from its definition, two tones a coordinate and SciPy's Euler angles, differentiated."""
    rng = np.random.default_rng(25)
    tones = np.array(rigid_body.TONES)
    for _ in range(50):
        t, omega = floats(rng.uniform([0, 0.5], [10, 2]))
        sizes = rng.uniform(0.1, 0.8, 6)

        def coordinates(h, t=t, omega=omega, sizes=sizes):
            a, b = omega * tones.T
            return sizes * (np.sin(a * (t + h)) - a / b * np.sin(b * (t + h)))

        def attitude(h, f=coordinates):
            return Rotation.from_euler("ZYX", f(h)[:2:-1]).as_matrix()

        d = rigid_body.motion(t, floats(sizes[:3]), floats(sizes[3:]), omega)
        for got, expected in zip((d.r, d.v, d.a), taylor(lambda h, f=coordinates: f(h)[:3], 0.2 / omega), strict=True):
            assert_allclose(got, expected, atol=10 * SPECTRAL)
        R, R_dot, R_ddot = taylor(attitude, 0.2 / omega)
        assert_allclose(np.reshape(d.R, (3, 3)), R, atol=ROUNDING)
        assert_allclose(d.Omega, vee(R.T @ R_dot), atol=10 * SPECTRAL)
        # R^T R_ddot is hat(Omega)^2 + hat(Omega_dot): its skew part is the second.
        assert_allclose(d.Omega_dot, vee(R.T @ R_ddot), atol=10 * SPECTRAL)


# Magnetic levitation.


def _magnet_cases(seed=50):
    rng = np.random.default_rng(seed)
    for _ in range(N_STATES):
        x = floats([rng.uniform(0.002, 0.02), rng.normal(0, 0.2)])
        m, z_0, k, g = floats(rng.uniform([0.03, 0.002, 1e-4, 5], [0.4, 0.02, 4e-4, 15]))
        yield rng, x, m, z_0, k, g


def check_magnet_derivative_is_that_of_the_co_energy(magnetic_levitation):
    """The coil's inductance is 2 k/(z + z_0), its co-energy L i^2/2, and the force the slope of that at constant i.

    The slope comes from a complex step, which is exact to rounding.
    """
    for rng, x, m, z_0, k, g in _magnet_cases():
        (z, v), h = x, 1e-30
        i, F_d, k_d = floats(rng.uniform([0, -1, 0], [3, 1, 2]))
        pull = (2 * k / (z + 1j * h + z_0) * i**2 / 2).imag / h
        expected = v, (m * g + pull + F_d - k_d * v) / m
        got = magnetic_levitation.derivative(x, (i, F_d), m, z_0, k, g, k_d)
        assert_allclose(got, expected, ROUNDING, ROUNDING)


def check_magnet_keeps_its_energy_at_constant_current(magnetic_levitation):
    """m v^2/2 - m g z - k i^2/(z + z_0) is constant, for the ball that falls and for the one that is pulled up."""
    m, z_0, k, g = 0.12, 0.005, 2e-4, 9.81
    for i, duration in ((0.9, 0.2), (1.2, 0.06)):
        x = solve_ivp(
            lambda _, x, i=i: magnetic_levitation.derivative(floats(x), (i,), m, z_0, k, g),
            (0, duration), (0.01, 0.0), "DOP853", rtol=1e-11, atol=1e-13, max_step=1e-3,
        ).y  # fmt: skip
        energy = m * x[1] ** 2 / 2 - m * g * x[0] - k * i**2 / (x[0] + z_0)
        assert_allclose(energy, energy[0], 1e-8)


def check_magnet_terminal_velocity(magnetic_levitation):
    """Without current it falls at (m g + F_d)/k_d in the end."""
    m, g, k_d, F_d = 0.1, 9.81, 0.5, -0.2
    t = np.array([0.0, 0.1, 0.5, 10.0])
    v = solve_ivp(
        lambda _, x: magnetic_levitation.derivative(floats(x), (0.0, F_d), m, g=g, k_d=k_d),
        (0, 10), (0.01, 0.0), "DOP853", t, rtol=1e-11, atol=1e-12,
    ).y[1]  # fmt: skip
    assert_allclose(v, (m * g + F_d) / k_d * (1 - np.exp(-k_d * t / m)), atol=1e-8)


def check_magnet_closed_loop_error(magnetic_levitation):
    """With true parameters (e, e_dot) is expm of its linear system, along a reference that moves."""
    K_p, K_d, p = 1600.0, 80.0, {"m": 0.13, "z_0": 0.005, "k": 2e-4, "g": 9.81}
    e0 = np.array([1.5e-3, -0.02])

    def reference(t):
        return 0.012 + 0.002 * np.sin(20 * t), 0.04 * np.cos(20 * t), -0.8 * np.sin(20 * t)

    def f(t, x):
        x = floats(x)
        i = magnetic_levitation.control(x, floats(reference(t)), K_p=K_p, K_d=K_d, i_max=3.0, **p)
        return np.clip(magnetic_levitation.derivative(x, (i,), **p), -100, 100)  # a wrong law may run away

    t = np.linspace(0, 0.2, 11)
    x = solve_ivp(f, (0, 0.2), reference(0.0)[:2] - e0, "DOP853", t, rtol=1e-10, atol=1e-12).y.T
    expected = [reference(t_k)[:2] - expm(t_k * np.array([[0, 1], [-K_p, -K_d]])) @ e0 for t_k in t]
    assert_allclose(x, expected, atol=1e-8)


def check_magnet_current_is_limited(magnetic_levitation):
    """The magnet cannot push, and a ball out of reach gets the largest current, not more."""
    gains = {"m": 0.1, "z_0": 0.004, "k": 2e-4, "g": 9.81, "K_p": 1600.0, "K_d": 80.0, "i_max": 3.0}
    for z, expected in ((0.001, 0.0), (0.1, 3.0), (-0.02, 0.0), (0.01, 0.014 * np.sqrt(0.1 * 9.81 / 2e-4))):
        assert_allclose(magnetic_levitation.control((z, 0.0), (0.01, 0.0, 0.0), **gains), expected, ROUNDING)


# References.


def check_sinusoid_against_spectral_differences(references):
    rng = np.random.default_rng(10)
    for _ in range(50):
        t, amplitude, omega = floats(rng.uniform([0, 0.5, 0.2], [20, 5, 2]))
        unit = amplitude * omega ** np.arange(5)

        def curve(h, t=t, amplitude=amplitude, omega=omega):
            return amplitude * np.sin(omega * (t + h))

        # The fourth derivative from 25 points: about 1e-16 * 25^4 in these units.
        expected = taylor(curve, 1 / omega, 4)
        assert_allclose(references.sinusoid(t, amplitude, omega) / unit, expected / unit, atol=1e-9)


def _trajectory_cases():
    rng = np.random.default_rng(11)
    for _ in range(50):
        yield (
            floats(rng.uniform(0.1, 20, 1))[0],
            floats(rng.uniform([1, 2, 0.5], [4, 6, 3])),
            float(rng.uniform(0.2, 1)),
        )


def check_trajectory_derivatives_against_spectral_differences(references):
    """The curve from its definition; the heading as the direction of (x_d, y_d), which turns smoothly mod pi."""
    for t, a, omega in _trajectory_cases():

        def curve(h, t=t, a=a, omega=omega):
            phase = omega * (t + h)
            return np.array([a[0] * np.sin(2 * phase), a[1] * np.sin(phase), a[2] * np.sin(phase)])

        r = taylor(curve, 0.5 / omega, 4)
        for yaw in ("paper", "smooth"):
            d = references.sinusoid_trajectory(t, a, omega, yaw)
            for k, got in enumerate((d.r, d.v, d.a, d.j, d.s)):
                # The fourth derivative from 25 points over half of 1/omega: about 1e-16 * (25 / 0.5)^4 * 6 m.
                assert_allclose(np.array(got) / omega**k, r[k] / omega**k, atol=1e-8)
            # tan(psi) = y/x of the definition: psi is half the angle of the squared complex number.
            unit = np.exp(2j * d.psi)
            position = complex(d.r[0], d.r[1]) ** 2
            assert_allclose(position / abs(position), unit, atol=ROUNDING)


def check_yaw_rates_against_spectral_differences(references):
    for t, a, omega in _trajectory_cases():

        def smooth(h, t=t, a=a, omega=omega):
            return np.arctan2(a[1], 2 * a[0] * np.cos(omega * (t + h)))

        psi = taylor(smooth, 0.1 / omega)
        for yaw in ("paper", "smooth"):
            d = references.sinusoid_trajectory(t, a, omega, yaw)
            assert_allclose(
                [d.psi_dot / omega, d.psi_ddot / omega**2], [psi[1] / omega, psi[2] / omega**2], atol=SPECTRAL
            )
        assert_allclose(references.sinusoid_trajectory(t, a, omega, "smooth").psi, psi[0], atol=ROUNDING)


def check_paper_yaw(references):
    """atan2(y_d, x_d), its limit from the right at t = 0, a jump of pi at t = pi/0.4 and 2 pi/0.4."""
    amplitudes, omega = (4.0, 5.0, 2.0), 0.4

    def yaw(t, which="paper"):
        return references.sinusoid_trajectory(t, amplitudes, omega, which).psi

    for t in np.random.default_rng(12).uniform(0.01, 16, 100):
        x, y = 4 * np.sin(0.8 * t), 5 * np.sin(0.4 * t)
        assert_allclose(yaw(float(t)), np.arctan2(y, x), atol=ROUNDING)
        turns = (yaw(float(t), "smooth") - yaw(float(t))) / np.pi
        assert_allclose(turns, round(turns), atol=ROUNDING)
    assert_allclose(yaw(0.0), np.arctan2(5, 8), atol=ROUNDING)
    assert_allclose(yaw(0.0), yaw(1e-7), atol=1e-7)
    for t in (np.pi / 0.4, 2 * np.pi / 0.4):
        h = 1e-7
        jump = yaw(t + h) - yaw(t - h)
        # The heading turns by at most 1 rad/s, so by 2e-7 beside the jump.
        assert_allclose(abs(jump), np.pi, atol=1e-6)
        smooth = yaw(t + h, "smooth") - yaw(t - h, "smooth")
        assert_allclose(smooth, 0, atol=1e-6)


# Rotations.


def check_vector_algebra(so3, a, b, s):
    scale = 1 + np.abs(a).max() * max(np.abs(b).max(), abs(s))
    for got, expected in (
        (so3.add(a, b), np.add(a, b)),
        (so3.subtract(a, b), np.subtract(a, b)),
        (so3.scale(s, a), s * np.array(a)),
        (so3.multiply(a, b), np.diag(a) @ b),
        (so3.dot(a, b), np.dot(a, b)),
        (so3.cross(a, b), np.cross(a, b)),
    ):
        # A few roundings of 1e-16 of the largest product.
        assert_allclose(got, expected, atol=4e-15 * scale)


def check_matrix_algebra(so3, m, n, a):
    M, N = np.reshape(m, (3, 3)), np.reshape(n, (3, 3))
    scale = 1 + np.abs(M).max() * max(np.abs(N).max(), np.abs(a).max())
    for got, expected in (
        (so3.columns(*(floats(c) for c in M.T)), M),
        (so3.transpose(m), M.T),
        (so3.apply(m, a), M @ a),
        (so3.product(m, n), M @ N),
    ):
        assert_allclose(got, np.ravel(expected), atol=1e-14 * scale)


def check_vee(so3, m, a):
    M = np.reshape(m, (3, 3))
    assert_allclose(so3.vee(floats(hat(a))), a, atol=0, rtol=1e-15)
    w = np.array(so3.vee(m))
    b = np.array([0.3, -1.2, 0.7])
    assert_allclose(np.cross(w, b), (M - M.T) / 2 @ b, atol=1e-14 * (1 + np.abs(M).max()))


def check_unit_derivatives(so3, a, a_dot, a_ddot):
    a, a_dot, a_ddot = map(np.array, (a, a_dot, a_ddot))
    size = np.linalg.norm(a)
    # The direction's singularities are where a(t) . a(t) = 0, no nearer than about the least of these two times.
    half_width = 0.1 / (np.linalg.norm(a_dot) / size + np.sqrt(np.linalg.norm(a_ddot) / size) + 1e-3)

    def unit(t):
        a_t = a + a_dot * t + a_ddot * t**2 / 2
        return a_t / np.linalg.norm(a_t)

    for k, (got, expected) in enumerate(
        zip(so3.unit_derivatives(floats(a), floats(a_dot), floats(a_ddot)), taylor(unit, half_width), strict=True)
    ):
        assert_allclose(np.array(got) * half_width**k, expected * half_width**k, atol=1e-12)


def check_orthonormalized(so3, rotvec, error):
    """Gram and Schmidt's columns are those of NumPy's Householder QR, its signs made positive."""
    M = Rotation.from_rotvec(rotvec).as_matrix() @ (np.eye(3) + np.reshape(error, (3, 3)))
    got = np.reshape(so3.orthonormalized(floats(M)), (3, 3))
    Q, upper = np.linalg.qr(M)
    # Errors grow with the condition of the first two columns, below 3 for the errors that are drawn.
    assert_allclose(got, Q * np.sign(np.diag(upper)), atol=1e-14)
    assert_allclose(np.linalg.det(got), 1.0, atol=1e-14)


# The integrator.


def check_order_conditions(ode):
    """One step is exact on a polynomial system with a component for each rooted tree of at most four vertices.

    Those eight order conditions are necessary and sufficient for order 4 (Hairer, Norsett, Wanner, table II.2.1).
    The ninth component, t_dot^4, is not exact: the weights 1/6, 2/3, 1/6 of Simpson's rule give 5/24, not 1/5.
    """

    def f(y):
        t, tt, t2, ttt, *_ = y
        return (1.0, t, t * t, tt, t**3, t * tt, t2, ttt, t**4)

    h = 0.7
    y = ode.rk4_step(f, (0.0,) * 9, h)
    exact = (h, h**2 / 2, h**3 / 3, h**3 / 6, h**4 / 4, h**4 / 8, h**4 / 12, h**4 / 24)
    assert_allclose(y[:8], exact, rtol=1e-14)
    assert_allclose(y[8], 5 / 24 * h**5, rtol=1e-14)


def check_order_of_convergence(ode, f, x0, duration, n_steps):
    """Halving the step divides the error against DOP853 at rtol 1e-12 by 2^4."""
    exact = solve_ivp(lambda _, x: f(tuple(x)), (0, duration), x0, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    errors = [
        np.linalg.norm(np.subtract(ode.integrate(f, x0, duration, duration / n * (1 + 1e-12)), exact)) for n in n_steps
    ]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    # The next term of the error, of order h, is what is left of 4.
    assert_allclose(orders, 4, atol=0.15)
