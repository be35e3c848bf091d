"""Free rigid body with its centre of mass off the origin, and its computed-torque controller. Independent of FMI.

Inertial frame: z down. The wrench acts at the body's origin and has body axes. R takes body to inertial vectors.
State x (18,) = r (3) [m], v (3) [m/s] of the origin, R (9, row by row), Omega (3) [rad/s, body];
input u = (F (3) [N, body], M (3) [N m, body, about the origin]), and, unless left out, disturbances that act there too,
F_d (3) [N, inertial] and M_d (3) [N m, body].
Featherstone (2008), "Rigid Body Dynamics Algorithms", sections 2.13-2.15: Newton and Euler about the centre of mass.
"""

from math import cos, sin
from typing import NamedTuple

from ..kernel.so3 import Matrix3, Vector3, add, apply, cross, product, scale, subtract, transpose, vee

State = tuple[float, ...]
Wrench = tuple[float, float, float, float, float, float]
Inertia = tuple[float, float, float, float, float, float]
"""J_xx, J_yy, J_zz, J_xy, J_xz, J_yz, elements of the matrix: J_xy = -sum of m x y [kg m^2]."""

TONES = ((1.0, 2.2), (1.2, 2.6), (1.4, 2.9), (1.7, 3.1), (1.5, 3.5), (1.3, 2.7))
"""Angular frequencies of x, y, z and roll, pitch, yaw in `motion`, in units of its omega."""
SINGULAR = 1e-13
"""Ratio det J / |J|^3 below which it is rounding: six products of three, each to 1e-16, and room for twenty more."""


def derivative(
    x: State, u: tuple[float, ...],
    m: float = 2.5, c_x: float = 0.0, c_y: float = 0.0, c_z: float = 0.0,
    J_xx: float = 0.3, J_yy: float = 0.4, J_zz: float = 0.5, J_xy: float = 0.0, J_xz: float = 0.0, J_yz: float = 0.0,
    g: float = 9.81, k_d: float = 0.0,
) -> State:  # fmt: skip
    """Return the time derivative of the state of the body's origin.

    J Omega_dot = M - c x F - Omega x J Omega;  v_dot = g e3 + R (F/m - Omega_dot x c - Omega x (Omega x c)),
    with F + R^T (F_d - k_d v) for F, and M + M_d for M

    x: (18,) state;  u: F (3) [N], M (3) [N m], then F_d (3) [N], M_d (3) [N m], zero if left out;  m: mass [kg];
    c: from the origin to the centre of mass [m, body];  J: inertia about the centre of mass [kg m^2];
    g: gravity [m/s^2];  k_d: linear drag at the origin [kg/s];  returns (18,).
    Raises ValueError for a singular J, ZeroDivisionError for m = 0; an indefinite J is not refused.
    """
    _, _, _, vx, vy, vz, r11, r12, r13, r21, r22, r23, r31, r32, r33, p, q, r = x
    Omega, F, M, c, J = (p, q, r), u[0:3], u[3:6], (c_x, c_y, c_z), (J_xx, J_yy, J_zz, J_xy, J_xz, J_yz)
    if any(u[6:]):
        F, M = add(F, apply(transpose(x[6:15]), u[6:9])), add(M, u[9:12])
    if k_d:
        F = subtract(F, apply(transpose(x[6:15]), scale(k_d, (vx, vy, vz))))
    M_c = subtract(M, cross(c, F))
    Omega_dot = solve(J, subtract(M_c, cross(Omega, apply(matrix(J), Omega))))
    a = apply(x[6:15], subtract(scale(1.0 / m, F), _lever(c, Omega, Omega_dot)))
    return (
        vx, vy, vz,
        a[0], a[1], g + a[2],
        r12 * r - r13 * q, r13 * p - r11 * r, r11 * q - r12 * p,
        r22 * r - r23 * q, r23 * p - r21 * r, r21 * q - r22 * p,
        r32 * r - r33 * q, r33 * p - r31 * r, r31 * q - r32 * p,
        *Omega_dot,
    )  # fmt: skip


def matrix(J: Inertia) -> Matrix3:
    """Return the symmetric matrix of an inertia."""
    xx, yy, zz, xy, xz, yz = J
    return (xx, xy, xz, xy, yy, yz, xz, yz, zz)


def solve(J: Inertia, b: Vector3) -> Vector3:
    """Return J^-1 b, by the adjugate, which takes an indefinite J as well. Raises ValueError for a singular one."""
    xx, yy, zz, xy, xz, yz = J
    a_xx, a_xy, a_xz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    a_yy, a_yz, a_zz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    det = xx * a_xx + xy * a_xy + xz * a_xz
    if not abs(det) > SINGULAR * max(map(abs, J)) ** 3:
        raise ValueError(f"inertia must be regular, got {J} kg m^2.")
    return scale(1.0 / det, apply((a_xx, a_xy, a_xz, a_xy, a_yy, a_yz, a_xz, a_yz, a_zz), b))


class Gains(NamedTuple):
    """Gains of the computed-torque law; the errors are linear with them where the parameters are true."""

    K_r: float = 9.0
    """Position [1/s^2]."""
    K_v: float = 6.0
    """Velocity [1/s]."""
    K_R: float = 25.0
    """Attitude [1/s^2]."""
    K_Omega: float = 10.0
    """Angular velocity [1/s]."""


class Motion(NamedTuple):
    """Desired motion of the body's origin and attitude, at one time."""

    r: Vector3
    """Position, inertial [m]."""
    v: Vector3
    """Velocity [m/s]."""
    a: Vector3
    """Acceleration [m/s^2]."""
    R: Matrix3
    """Rotation, body to inertial."""
    Omega: Vector3
    """Angular velocity, in the desired body frame [rad/s]."""
    Omega_dot: Vector3
    """Angular acceleration, derivative of Omega [rad/s^2]."""


def control(x: State, d: Motion, m: float, c: Vector3, J: Inertia, g: float, gains: Gains = Gains()) -> Wrench:
    """Return the wrench of inverse dynamics on SE(3), with the controller's own parameters.

    a = a_d - K_r e_r - K_v e_v;  F = m (R^T (a - g e3) + alpha x c + Omega x (Omega x c));
    alpha = Q Omega_dot_d - Omega x Q Omega_d - K_R e_R - K_Omega e_Omega;  M = J alpha + Omega x J Omega + c x F;
    Q = R^T R_d;  e_R = vee((Q^T - Q)/2);  e_Omega = Omega - Q Omega_d.

    With true parameters e_r_ddot = -K_r e_r - K_v e_v and e_Omega_dot = -K_R e_R - K_Omega e_Omega.
    x: (18,) state;  d: desired motion;  m [kg];  c: (3,) [m];  J [kg m^2];  g [m/s^2];  returns F (3) [N], M (3) [N m].
    Siciliano et al. (2009), "Robotics", section 8.5.2; errors of attitude: Lee et al. (2010), eq. 10 and 11.
    """
    R_T, Omega = transpose(x[6:15]), x[15:18]
    e_r, e_v = subtract(x[0:3], d.r), subtract(x[3:6], d.v)
    a = subtract(d.a, add(scale(gains.K_r, e_r), scale(gains.K_v, e_v)))
    Q = product(R_T, d.R)  # desired body frame -> body frame
    e_R = scale(-1.0, vee(Q))
    Omega_d = apply(Q, d.Omega)
    feedback = add(scale(gains.K_R, e_R), scale(gains.K_Omega, subtract(Omega, Omega_d)))
    alpha = subtract(subtract(apply(Q, d.Omega_dot), cross(Omega, Omega_d)), feedback)
    F = scale(m, add(apply(R_T, subtract(a, (0.0, 0.0, g))), _lever(c, Omega, alpha)))
    J_matrix = matrix(J)
    M = add(add(apply(J_matrix, alpha), cross(Omega, apply(J_matrix, Omega))), cross(c, F))
    return (*F, *M)


def motion(t: float, amplitudes: Vector3, angles: Vector3, omega: float) -> Motion:
    """Return a motion that excites all ten parameters, from rest at the origin: two tones in each coordinate.

    R = Rz(yaw) Ry(pitch) Rx(roll) and its exact Omega and Omega_dot; frequencies: `TONES`.

    t [s];  amplitudes: of x, y, z [m];  angles: of roll, pitch, yaw [rad];  omega [rad/s].
    """
    coordinates = [_tones(t, s, a * omega, b * omega) for s, (a, b) in zip((*amplitudes, *angles), TONES)]
    r, v, a = zip(*coordinates[:3])
    return Motion(r, v, a, *_attitude(*zip(*coordinates[3:])))


def _tones(t: float, s: float, a: float, b: float) -> Vector3:
    """Return s (sin(a t) - (a/b) sin(b t)), which starts at rest, with its first two time derivatives."""
    return (
        s * (sin(a * t) - a / b * sin(b * t)),
        s * a * (cos(a * t) - cos(b * t)),
        s * a * (b * sin(b * t) - a * sin(a * t)),
    )


def _attitude(e: Vector3, e_dot: Vector3, e_ddot: Vector3) -> tuple[Matrix3, Vector3, Vector3]:
    """Return R, Omega, Omega_dot of roll, pitch, yaw e [rad] with two derivatives. Diebel (2006), eq. 67 and 74."""
    (cx, cy, cz), (sx, sy, sz) = map(cos, e), map(sin, e)
    px, py, pz = e_dot
    qx, qy, qz = e_ddot
    R = (
        cy * cz, sx * sy * cz - cx * sz, cx * sy * cz + sx * sz,
        cy * sz, sx * sy * sz + cx * cz, cx * sy * sz - sx * cz,
        -sy, sx * cy, cx * cy,
    )  # fmt: skip
    Omega = (px - pz * sy, py * cx + pz * cy * sx, pz * cy * cx - py * sx)
    Omega_dot = (
        qx - qz * sy - pz * py * cy,
        qy * cx - py * px * sx + qz * cy * sx - pz * py * sy * sx + pz * px * cy * cx,
        qz * cy * cx - pz * py * sy * cx - pz * px * cy * sx - qy * sx - py * px * cx,
    )
    return R, Omega, Omega_dot


def _lever(c: Vector3, Omega: Vector3, Omega_dot: Vector3) -> Vector3:
    """Return Omega_dot x c + Omega x (Omega x c), the centre of mass's acceleration over the origin's [m/s^2, body]."""
    return add(cross(Omega_dot, c), cross(Omega, cross(Omega, c)))
