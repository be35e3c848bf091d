"""Actuated planar pendulum with friction, and its feedback-linearising controller. Independent of FMI.

State x = (phi [rad], phi_dot [rad/s]); phi = 0 hangs down. The input u is a tangential force [N].
Khan and Chatterjee (2020), "Online parameter estimation for safety-critical systems with Gaussian processes",
section IV-A.
"""

from math import sin


def derivative(
    x: tuple[float, float], u: tuple[float], m: float = 1.75, l: float = 0.75, b: float = 0.1, g: float = 9.81
) -> tuple[float, float]:
    """Return the time derivative of the pendulum state.

    phi_ddot = -(g/l) sin phi - (b/m) phi_dot + u/(m l)

    x: (phi [rad], phi_dot [rad/s]);  u: (tangential force [N],);  m: mass [kg];  l: length [m];
    b: friction [kg/s];  g: gravity [m/s^2];  returns (rad/s, rad/s^2).
    """
    phi, phi_dot = x
    return (phi_dot, -g / l * sin(phi) - b / m * phi_dot + u[0] / (m * l))


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
    x: tuple[float, float], u: tuple[float], xdot: tuple[float], b: float = 0.1, g: float = 9.81
) -> tuple[tuple[tuple[float, float, float]], tuple[float]]:
    """Return the equation of motion: a row (1, 3) times (1/l, 1/m, 1/(m l)) = a target (1,), phi_ddot [rad/s^2].

    Linear in the three coefficients, which are not independent: see `coefficients`.
    """
    phi, phi_dot = x
    return (((-g * sin(phi), -b * phi_dot, u[0]),), (xdot[0],))


def coefficients(m: float, l: float) -> tuple[float, float, float]:
    """Return (1/l, 1/m, 1/(m l)), the coefficients of `regression`."""
    return (1.0 / l, 1.0 / m, 1.0 / (m * l))
