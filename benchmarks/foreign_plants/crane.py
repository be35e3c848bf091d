"""Gantry crane: a trolley with a payload on a rope.

State x = (x [m], v [m/s], theta [rad], omega [rad/s]): the trolley, and the rope's angle from hanging down. The load
from outside is a force on the trolley [N].
"""

from math import cos, sin

from .plant import PLACE, Estimated, ForeignPlant, Signal, Values, wave

G = 9.81
TROLLEY = 1.5
"""Mass of the trolley [kg]."""
OMEGA = 1.6
"""Angular frequency of the reference [rad/s]."""
POLE = 3.0
"""Four poles of the error at -3 rad/s."""


def derivative(x: Values, u: Values, m: float, l: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state.

    (1.5 + m sin^2 theta) v_dot = u + load + m l omega^2 sin theta + m g sin theta cos theta,
    l omega_dot = -g sin theta - v_dot cos theta

    u: (force on the trolley [N]);  m: payload [kg];  l: length of the rope [m].
    """
    _, v, theta, omega = x
    s, c = sin(theta), cos(theta)
    a = (u[0] + load + m * l * omega * omega * s + m * G * s * c) / (TROLLEY + m * s * s)
    return (v, a, omega, -(G * s + a * c) / l)


def control(x: Values, reference: Values, m: float, l: float) -> Values:
    """Return the force: feedforward and state feedback on the payload's place y = x + l theta.

    Its second derivative is about -g theta, so that the rope does not go on swinging.
    """
    place, v, theta, omega = x
    share = 1.0 / (1.0 - l * OMEGA**2 / G)  # of x in y, for a sinusoid
    actual, gains = (place + l * theta, v + l * omega, -G * theta, -G * omega), (
        POLE**4, 4.0 * POLE**3, 6.0 * POLE**2, 4.0 * POLE,
    )  # fmt: skip
    snap = reference[4] * share + sum(k * (share * r - y) for k, r, y in zip(gains, reference, actual))
    s, c = sin(theta), cos(theta)
    a = (l * snap / G - G * s) / c
    return (a * (TROLLEY + m * s * s) - m * l * omega * omega * s - m * G * s * c,)


def reference(t: float) -> Values:
    """Return the desired place of the trolley to its fourth derivative."""
    return wave(t, 0.4, OMEGA)


_X, _V, _A, _JERK, _ = reference(0.0)
_SHARE = 1.0 / (1.0 - 0.8 * OMEGA**2 / G)
PLANT = ForeignPlant(
    name="crane",
    title="Trolley with a payload on a rope",
    parameters=(
        Estimated("m", "kg", 1.0, 1.6, "Payload"),
        Estimated("l", "m", 0.8, 1.1, "Length of the rope"),
    ),
    states=(
        Signal("x", "m", "Place of the trolley", _X),
        Signal("v", "m/s", "Speed of the trolley", _V),
        Signal("theta", "rad", "Angle of the rope", -_SHARE * _A / G),
        Signal("omega", "rad/s", "Speed of the rope", -_SHARE * _JERK / G),
    ),
    controls=(Signal("u", "N", "Force on the trolley"),),
    references=PLACE,
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"x": "x_ref"},
    noise={"v": 0.01, "omega": 0.02},
    step=0.01,
    divergence=1.5,
    rate=4.2,
    limit=2.2,
    speed="v",
    pace=0.5,
)
