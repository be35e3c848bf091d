"""Actuated planar pendulum with friction, and its feedback-linearising controller. Independent of FMI.

State x = (phi [rad], phi_dot [rad/s]); phi = 0 hangs down. The inputs are tangential forces [N]: that of the actuator,
and a disturbance, which may be left out.
Khan and Chatterjee (2020), "Online parameter estimation for safety-critical systems with Gaussian processes",
section IV-A.
"""

from math import sin, tanh

SLIDING = 0.01
"""Speed [m/s] at which three quarters of the dry friction act."""


def derivative(
    x: tuple[float, float], u: tuple[float, ...], m: float = 1.75, l: float = 0.75, b: float = 0.1, g: float = 9.81,
    F_c: float = 0.0,
) -> tuple[float, float]:  # fmt: skip
    """Return the time derivative of the pendulum state.

    phi_ddot = -(g/l) sin phi - (b/m) phi_dot + (u + F_d - F_c tanh(l phi_dot/v_s))/(m l)

    x: (phi [rad], phi_dot [rad/s]);  u: (tangential force [N], disturbance F_d [N], zero if left out);  m: mass [kg];
    l: length [m];  b: friction [kg/s];  g: gravity [m/s^2];  F_c: dry friction [N], smooth about rest, v_s = `SLIDING`:
    steps of h [s] need h F_c < 2 m v_s;  returns (rad/s, rad/s^2).
    """
    phi, phi_dot = x
    force = _total(u)
    if F_c:
        force -= F_c * tanh(l * phi_dot / SLIDING)
    return (phi_dot, -g / l * sin(phi) - b / m * phi_dot + force / (m * l))


def control(
    x: tuple[float, float], x_ref: tuple[float, float], m: float, l: float, b: float, g: float, Kp: float, Kd: float
) -> float:
    """Return the tangential force [N] of the feedback-linearising law, computed with the controller's own parameters.

    u = m l (Kp e1 + Kd e2) + m l ((g/l) sin phi + (b/m) phi_dot),  e = x_ref - x

    x, x_ref: (phi [rad], phi_dot [rad/s]);  Kp [1/s^2], Kd [1/s]: gains of the linear error dynamics
    e1_ddot + Kd e1_dot + Kp e1 = 0, which hold where the parameters are true.
    """
    phi, phi_dot = x
    e1, e2 = x_ref[0] - phi, x_ref[1] - phi_dot
    return m * l * (Kp * e1 + Kd * e2) + m * l * (g / l * sin(phi) + b / m * phi_dot)


def regression(
    x: tuple[float, float], u: tuple[float, ...], xdot: tuple[float], b: float = 0.1, g: float = 9.81
) -> tuple[tuple[tuple[float, float, float]], tuple[float]]:
    """Return the equation of motion: a row (1, 3) times (1/l, 1/m, 1/(m l)) = a target (1,), phi_ddot [rad/s^2].

    u: (tangential force [N], disturbance F_d [N], zero if left out). Linear in the three coefficients, which are
    not independent: see `coefficients`.
    """
    phi, phi_dot = x
    return (((-g * sin(phi), -b * phi_dot, _total(u)),), (xdot[0],))


def coefficients(m: float, l: float) -> tuple[float, float, float]:
    """Return (1/l, 1/m, 1/(m l)), the coefficients of `regression`."""
    return (1.0 / l, 1.0 / m, 1.0 / (m * l))


def _total(u: tuple[float, ...]) -> float:
    """Return the sum of the inputs [N]; the first alone, bit for bit, where no other acts."""
    return u[0] + u[1] if any(u[1:]) else u[0]
