"""Desired trajectory of a quadrotor, with its time derivatives."""

from math import atan2, cos, pi, sin
from typing import Literal, NamedTuple

from ..kernel.references import sinusoid
from ..kernel.so3 import Vector3

Yaw = Literal["paper", "smooth"]


class Trajectory(NamedTuple):
    """Desired position to its fourth derivative and yaw to its second, at one time."""

    r: Vector3
    """Position, inertial [m]."""
    v: Vector3
    """Velocity [m/s]."""
    a: Vector3
    """Acceleration [m/s^2]."""
    j: Vector3
    """Jerk [m/s^3]."""
    s: Vector3
    """Snap [m/s^4]."""
    psi: float
    """Yaw [rad]."""
    psi_dot: float
    """Yaw rate [rad/s]."""
    psi_ddot: float
    """Yaw acceleration [rad/s^2]."""


def sinusoid_trajectory(t: float, amplitudes: Vector3, omega: float, yaw: Yaw = "paper") -> Trajectory:
    """Return r_d = (a1 sin 2wt, a2 sin wt, a3 sin wt) with yaw psi_d = atan2(y_d, x_d), and their derivatives.

    The yaw is undefined where x_d = y_d = 0 and jumps by pi there; its smooth branch is atan2(a2, 2 a1 cos wt).
    `yaw="paper"` follows the atan2, with the limit from the right at such a point; `"smooth"` stays on the branch.
    The derivatives are those of the smooth branch for both. Needs a2 > 0.

    t [s];  amplitudes [m];  omega: w [rad/s]. Khan and Chatterjee (2020), section IV-B.
    """
    a1, a2, a3 = amplitudes
    x = sinusoid(t, a1, 2.0 * omega)
    y = sinusoid(t, a2, omega)
    z = sinusoid(t, a3, omega)
    # psi = atan2(a2, p), so psi_dot = -a2 p_dot / (p^2 + a2^2).
    p, p_dot = 2.0 * a1 * cos(omega * t), -2.0 * a1 * omega * sin(omega * t)
    p_ddot = -(omega**2) * p
    n = p * p + a2 * a2
    psi = atan2(a2, p)
    psi_dot = -a2 * p_dot / n
    psi_ddot = -a2 * p_ddot / n + 2.0 * a2 * p * p_dot**2 / n**2
    if yaw == "paper" and (sin(omega * t) or cos(omega * t)) < 0.0:
        psi -= pi
    r, v, a, j, s = zip(x, y, z)
    return Trajectory(r, v, a, j, s, psi, psi_dot, psi_ddot)
