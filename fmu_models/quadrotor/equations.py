"""Quadrotor on SE(3), and the geometric tracking controller of Lee, Leok and McClamroch. Independent of FMI.

Inertial frame: z down (north-east-down). Body frame: z down, thrust along -b3. R takes body to inertial vectors.
State x (18,) = r (3) [m], v (3) [m/s], R (9, row by row), Omega (3) [rad/s, body];
input u = (F [N], M (3) [N m, body]), and, unless left out, disturbances F_d (3) [N, inertial] and M_d (3) [N m, body].
Lee, Leok, McClamroch (2010), "Geometric tracking control of a quadrotor UAV on SE(3)", equations 2-5 and 15-16.
"""

from math import cos, sin
from typing import NamedTuple

from ..kernel.ode import is_acting
from ..kernel.so3 import (
    Matrix3,
    Vector3,
    add,
    apply,
    columns,
    cross,
    dot,
    multiply,
    product,
    scale,
    subtract,
    transpose,
    unit_derivatives,
    vee,
)
from .trajectory import Trajectory

State = tuple[float, ...]


def derivative(
    x: State, u: tuple[float, ...],
    m: float = 1.25, J_x: float = 1.1, J_y: float = 1.1, J_z: float = 2.2, g: float = 9.81, k_d: float = 0.0,
) -> State:  # fmt: skip
    """Return the time derivative of the quadrotor state.

    r_dot = v;  v_dot = g e3 - (F/m) R e3 + (F_d - k_d v)/m;  R_dot = R hat(Omega);
    Omega_dot = J^-1 (M + M_d - Omega x J Omega)

    x: (18,) state;  u: (F [N], M_x, M_y, M_z [N m]), then F_d (3) [N], M_d (3) [N m], zero if left out;  m: mass [kg];
    J_x, J_y, J_z: inertia [kg m^2];  g: gravity [m/s^2];  k_d: linear drag [kg/s];  returns (18,).
    """
    _, _, _, vx, vy, vz, r11, r12, r13, r21, r22, r23, r31, r32, r33, p, q, r = x
    F, M_x, M_y, M_z = u[:4]
    a = F / m
    a_x, a_y, a_z = -a * r13, -a * r23, g - a * r33
    if is_acting(u[4:]):
        a_x, a_y, a_z = a_x + u[4] / m, a_y + u[5] / m, a_z + u[6] / m
        M_x, M_y, M_z = M_x + u[7], M_y + u[8], M_z + u[9]
    if k_d:
        a_x, a_y, a_z = a_x - k_d / m * vx, a_y - k_d / m * vy, a_z - k_d / m * vz
    return (
        vx, vy, vz,
        a_x, a_y, a_z,
        r12 * r - r13 * q, r13 * p - r11 * r, r11 * q - r12 * p,
        r22 * r - r23 * q, r23 * p - r21 * r, r21 * q - r22 * p,
        r32 * r - r33 * q, r33 * p - r31 * r, r31 * q - r32 * p,
        (M_x - (J_z - J_y) * q * r) / J_x, (M_y - (J_x - J_z) * p * r) / J_y, (M_z - (J_y - J_x) * p * q) / J_z,
    )  # fmt: skip


def regression(
    x: State, u: tuple[float, ...], xdot: tuple[float, ...], g: float = 9.81
) -> tuple[tuple[tuple[float, float, float, float], ...], tuple[float, ...]]:
    """Return the equations of motion as rows (6, 4) times (1/m, J_x, J_y, J_z) = targets (6,).

    (F_d - F R e3) (1/m) = v_dot - g e3 [m/s^2];  J Omega_dot + Omega x J Omega = M + M_d [N m].
    u: as for `derivative`;  xdot: (v_dot, Omega_dot) (6,). In the last three rows the sampled Omega_dot, and its noise,
    is in the regressors.
    """
    _, _, r13, _, _, r23, _, _, r33, p, q, r = x[6:]
    F, M_x, M_y, M_z = u[:4]
    F_x, F_y, F_z = -F * r13, -F * r23, -F * r33
    if any(u[4:]):
        F_x, F_y, F_z = F_x + u[4], F_y + u[5], F_z + u[6]
        M_x, M_y, M_z = M_x + u[7], M_y + u[8], M_z + u[9]
    a_x, a_y, a_z, p_dot, q_dot, r_dot = xdot
    rows = (
        (F_x, 0.0, 0.0, 0.0), (F_y, 0.0, 0.0, 0.0), (F_z, 0.0, 0.0, 0.0),
        (0.0, p_dot, -q * r, q * r), (0.0, p * r, q_dot, -p * r), (0.0, -p * q, p * q, r_dot),
    )  # fmt: skip
    return rows, (a_x, a_y, a_z - g, M_x, M_y, M_z)


def coefficients(m: float, J_x: float, J_y: float, J_z: float) -> tuple[float, float, float, float]:
    """Return (1/m, J_x, J_y, J_z), the coefficients of `regression`."""
    return (1.0 / m, J_x, J_y, J_z)


class Gains(NamedTuple):
    """Gains of the geometric controller, a number for each axis."""

    K_r: Vector3 = (5.0, 5.0, 5.0)
    """Position [N/m]."""
    K_v: Vector3 = (0.5, 0.5, 2.0)
    """Velocity [N s/m]."""
    K_R: Vector3 = (30.0, 30.0, 30.0)
    """Attitude [N m]."""
    K_Omega: Vector3 = (5.0, 10.0, 20.0)
    """Angular velocity [N m s]."""


class Attitude(NamedTuple):
    """Desired attitude and its motion."""

    R: Matrix3
    """Rotation, body to inertial."""
    Omega: Vector3
    """Angular velocity, in the desired body frame [rad/s]."""
    Omega_dot: Vector3
    """Angular acceleration, derivative of Omega [rad/s^2]."""


def desired_attitude(
    A: Vector3, A_dot: Vector3, A_ddot: Vector3, psi: float, psi_dot: float, psi_ddot: float
) -> Attitude:
    """Return the attitude of third axis along -A and heading psi, with its angular velocity and acceleration.

    b3d = -A/|A|;  b2d = b3d x b1c / |b3d x b1c|;  b1d = b2d x b3d;  b1c = (cos psi, sin psi, 0);
    hat(Omega_d) = R_d^T R_d_dot;  hat(Omega_dot_d) = R_d^T R_d_ddot - hat(Omega_d)^2.

    A [N] and psi [rad] with first and second time derivatives. Raises ZeroDivisionError where A = 0 or A is
    along the heading. Lee et al. (2010), eq. 12 and the text after it.
    """
    b3, b3_dot, b3_ddot = unit_derivatives(scale(-1.0, A), scale(-1.0, A_dot), scale(-1.0, A_ddot))
    c, s = cos(psi), sin(psi)
    h = (c, s, 0.0)
    h_dot = (-psi_dot * s, psi_dot * c, 0.0)
    h_ddot = (-psi_ddot * s - psi_dot**2 * c, psi_ddot * c - psi_dot**2 * s, 0.0)
    b2, b2_dot, b2_ddot = unit_derivatives(
        cross(b3, h),
        add(cross(b3_dot, h), cross(b3, h_dot)),
        add(add(cross(b3_ddot, h), cross(b3, h_ddot)), scale(2.0, cross(b3_dot, h_dot))),
    )
    b1 = cross(b2, b3)
    b1_dot = add(cross(b2_dot, b3), cross(b2, b3_dot))
    b1_ddot = add(add(cross(b2_ddot, b3), cross(b2, b3_ddot)), scale(2.0, cross(b2_dot, b3_dot)))
    R = columns(b1, b2, b3)
    R_T = transpose(R)
    # vee takes the skew part, and hat(Omega)^2 is symmetric: it drops out by itself.
    Omega = vee(product(R_T, columns(b1_dot, b2_dot, b3_dot)))
    Omega_dot = vee(product(R_T, columns(b1_ddot, b2_ddot, b3_ddot)))
    return Attitude(R, Omega, Omega_dot)


def control(
    x: State, d: Trajectory, m: float, J: Vector3, g: float, gains: Gains = Gains()
) -> tuple[float, float, float, float]:
    """Return thrust F [N] and moments M [N m, body] of the geometric law, with the controller's own parameters.

    A = -K_r e_r - K_v e_v - m g e3 + m a_d;  F = -A . R e3;
    M = -K_R e_R - K_Omega e_Omega + Omega x J Omega - J (hat(Omega) R^T R_d Omega_d - R^T R_d Omega_dot_d).
    A_dot and A_ddot carry the error terms, with the acceleration that the controller's own m, F and R predict.

    x: (18,) state;  d: desired trajectory;  m [kg];  J: (3,) diagonal of the inertia [kg m^2];  g [m/s^2].
    Raises ZeroDivisionError where the desired attitude is undefined (A = 0).
    Lee et al. (2010), eq. 15 and 16.
    """
    r, v, R, Omega = x[0:3], x[3:6], x[6:15], x[15:18]
    b3 = (R[2], R[5], R[8])
    e_r, e_v = subtract(r, d.r), subtract(v, d.v)
    A = _feedback(gains, e_r, e_v, m, (d.a[0], d.a[1], d.a[2] - g))
    F = -dot(A, b3)

    b3_dot = apply(R, (Omega[1], -Omega[0], 0.0))  # R (Omega x e3)
    e_a = subtract((0.0, 0.0, g), add(scale(F / m, b3), d.a))
    A_dot = _feedback(gains, e_v, e_a, m, d.j)
    F_dot = -dot(A_dot, b3) - dot(A, b3_dot)
    e_j = scale(-1.0, add(add(scale(F_dot / m, b3), scale(F / m, b3_dot)), d.j))
    A_ddot = _feedback(gains, e_a, e_j, m, d.s)

    desired = desired_attitude(A, A_dot, A_ddot, d.psi, d.psi_dot, d.psi_ddot)
    Q = product(transpose(R), desired.R)  # desired body frame -> body frame
    e_R = scale(-1.0, vee(Q))  # vee((R_d^T R - R^T R_d)/2)
    Omega_d = apply(Q, desired.Omega)
    e_Omega = subtract(Omega, Omega_d)
    feedforward = subtract(cross(Omega, Omega_d), apply(Q, desired.Omega_dot))
    M = subtract(
        cross(Omega, multiply(J, Omega)),
        add(add(multiply(gains.K_R, e_R), multiply(gains.K_Omega, e_Omega)), multiply(J, feedforward)),
    )
    return (F, *M)


def _feedback(gains: Gains, e: Vector3, e_dot: Vector3, m: float, a: Vector3) -> Vector3:
    """Return -K_r e - K_v e_dot + m a."""
    K_r, K_v = gains.K_r, gains.K_v
    return (
        -K_r[0] * e[0] - K_v[0] * e_dot[0] + m * a[0],
        -K_r[1] * e[1] - K_v[1] * e_dot[1] + m * a[1],
        -K_r[2] * e[2] - K_v[2] * e_dot[2] + m * a[2],
    )
