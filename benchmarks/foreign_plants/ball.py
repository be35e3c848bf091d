"""Ball that rolls on a beam, whose motor gives a torque.

Hauser, Sastry and Kokotovic (1992), "Nonlinear control via approximate input-output linearization: the ball and beam
example", IEEE Trans. Automatic Control 37.
State x = (r [m], v [m/s], theta [rad], omega [rad/s]): place of the ball, from the beam's axis, and the beam's angle.
The load is a torque on the beam [N m].
"""

from math import asin, cos, sin

from .plant import Estimated, ForeignPlant, Signal, Values, wave

G = 9.81
ROLLING = 5.0 / 7.0
"""Share of the force along the beam that moves a solid ball, which has to turn as well."""
GAINS = (1296.0 / (ROLLING * G), 864.0 / (ROLLING * G), 216.0, 24.0)
"""Gains on the errors of r, v, theta and omega: four poles at -6 rad/s."""
_APART = 1e-3
"""Step of the differences of the desired angle [s]."""


def derivative(x: Values, u: Values, m: float, J: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state.

    r_ddot = 5/7 (r omega^2 - g sin theta),  (J + m r^2) omega_dot = u + load - 2 m r v omega - m g r cos theta

    u: (torque [N m]);  m: mass of the ball [kg];  J: inertia of the beam [kg m^2].
    """
    r, v, theta, omega = x
    torque = u[0] + load - 2.0 * m * r * v * omega - m * G * r * cos(theta)
    return (v, ROLLING * (r * omega * omega - G * sin(theta)), omega, torque / (J + m * r * r))


def control(x: Values, reference: Values, m: float, J: float) -> Values:
    """Return the torque that gives the beam the desired acceleration: computed torque, and state feedback."""
    r, v, theta, omega = x
    r_ref, v_ref, theta_ref, omega_ref, alpha_ref = reference
    K_r, K_v, K_theta, K_omega = GAINS
    alpha = alpha_ref + K_theta * (theta_ref - theta) + K_omega * (omega_ref - omega)
    alpha -= K_r * (r_ref - r) + K_v * (v_ref - v)
    return ((J + m * r * r) * alpha + 2.0 * m * r * v * omega + m * G * r * cos(theta),)


def _angle(t: float) -> float:
    """Return the angle [rad] at which the ball follows its reference."""
    r, _, r_ddot, jerk, _ = wave(t, 0.25, 2.0)
    sine = r_ddot / (ROLLING * G)
    omega = -jerk / (ROLLING * G * (1.0 - sine * sine) ** 0.5)
    return asin(r * omega * omega / G - sine)


def reference(t: float) -> Values:
    """Return place, speed, and the beam's angle to its second derivative."""
    r, v, *_ = wave(t, 0.25, 2.0)
    before, now, after = (_angle(t + s) for s in (-_APART, 0.0, _APART))
    return (r, v, now, (after - before) / (2.0 * _APART), (after - 2.0 * now + before) / _APART**2)


_BEGIN = reference(0.0)
PLANT = ForeignPlant(
    name="ball",
    title="Ball that rolls on a beam",
    parameters=(
        Estimated("m", "kg", 0.3, 0.5, "Mass of the ball"),
        Estimated("J", "kg.m2", 0.05, 0.08, "Inertia of the beam"),
    ),
    states=(
        Signal("r", "m", "Place of the ball", _BEGIN[0]),
        Signal("v", "m/s", "Speed of the ball", _BEGIN[1]),
        Signal("theta", "rad", "Angle of the beam", _BEGIN[2]),
        Signal("omega", "rad/s", "Speed of the beam", _BEGIN[3]),
    ),
    controls=(Signal("u", "N.m", "Torque on the beam"),),
    references=(
        Signal("r_ref", "m", "Desired place"),
        Signal("v_ref", "m/s", "Desired speed"),
        Signal("theta_ref", "rad", "Desired angle"),
        Signal("omega_ref", "rad/s", "Desired speed of the beam"),
        Signal("alpha_ref", "rad/s2", "Desired acceleration of the beam"),
    ),
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"r": "r_ref"},
    noise={"v": 0.005, "omega": 0.02},
    step=0.005,
    divergence=1.0,
    rate=1.42,
    limit=0.65,
    omitted={"limited-change": "the true parameters do not hold it either"},
    speed="omega",
    pace=0.3,
)
