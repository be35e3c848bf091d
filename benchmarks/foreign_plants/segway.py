"""Person on two wheels: an inverted pendulum whose motor acts between the body and the wheels.

Grasser, D'Arrigo, Colombi and Rufer (2002), "JOE: a mobile, inverted pendulum", IEEE Trans. Industrial Electronics 49.
State x = (x [m], v [m/s], phi [rad], omega [rad/s]): place, and the body's angle from upright. The load is a force at
the axle [N].
"""

from math import cos, sin

from .plant import PLACE, Estimated, ForeignPlant, Signal, Values, wave

G = 9.81
WHEELS = 20.0
"""Mass of the wheels, with their inertia over their radius squared [kg]."""
RADIUS = 0.24
"""Radius of the wheels [m]."""
INERTIA = 12.0
"""Inertia of the body about its centre [kg m^2]."""
OMEGA = 1.4
"""Angular frequency of the reference [rad/s]."""
POLE = 4.0
"""Four poles of the error at -4 rad/s."""


def derivative(x: Values, u: Values, m: float, l: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state.

    (20 + m) v_dot + m l (omega_dot cos phi - omega^2 sin phi) = u/0.24 + load,
    m l v_dot cos phi + (12 + m l^2) omega_dot - m g l sin phi = -u

    u: (torque of the motor [N m]);  m: mass of the body [kg];  l: height of its centre above the axle [m].
    """
    _, v, phi, omega = x
    s, moment, body = sin(phi), m * l, INERTIA + m * l * l
    coupling = moment * cos(phi)
    a, b = u[0] / RADIUS + load + moment * omega * omega * s, moment * G * s - u[0]
    det = (WHEELS + m) * body - coupling * coupling
    return (v, (body * a - coupling * b) / det, omega, ((WHEELS + m) * b - coupling * a) / det)


def control(x: Values, reference: Values, m: float, l: float) -> Values:
    """Return the torque: feedforward and state feedback on y = x + ratio phi, whose second derivative is lift phi.

    So it is of small angles; what the body needs to be turned so is exact.
    """
    place, v, phi, omega = x
    moment, body = m * l, INERTIA + m * l * l
    along = (WHEELS + m) * RADIUS + moment
    ratio, lift = (moment * RADIUS + body) / along, moment * G / along
    share = 1.0 / (1.0 + ratio * OMEGA**2 / lift)  # of x in y, for a sinusoid
    actual = (place + ratio * phi, v + ratio * omega, lift * phi, lift * omega)
    gains = (POLE**4, 4.0 * POLE**3, 6.0 * POLE**2, 4.0 * POLE)
    turn = (reference[4] * share + sum(k * (share * r - y) for k, r, y in zip(gains, reference, actual))) / lift
    s, coupling = sin(phi), moment * cos(phi)
    swing = moment * omega * omega * s
    a = (moment * G * s + RADIUS * swing - (coupling * RADIUS + body) * turn) / ((WHEELS + m) * RADIUS + coupling)
    return (moment * G * s - coupling * a - body * turn,)


def reference(t: float) -> Values:
    """Return the desired place to its fourth derivative."""
    return wave(t, 0.5, OMEGA)


_X, _V, _A, _JERK, _ = reference(0.0)
_ALONG = 95.0 * RADIUS + 67.5
_LIFT = 67.5 * G / _ALONG
_SHARE = 1.0 / (1.0 + (67.5 * RADIUS + INERTIA + 60.75) / _ALONG * OMEGA**2 / _LIFT)
PLANT = ForeignPlant(
    name="segway",
    title="Person on two wheels",
    parameters=(
        Estimated("m", "kg", 75.0, 100.0, "Mass of the body"),
        Estimated("l", "m", 0.9, 1.05, "Height of its centre above the axle"),
    ),
    states=(
        Signal("x", "m", "Place", _X),
        Signal("v", "m/s", "Speed", _V),
        Signal("phi", "rad", "Angle of the body from upright", _SHARE * _A / _LIFT),
        Signal("omega", "rad/s", "Speed of the body", _SHARE * _JERK / _LIFT),
    ),
    controls=(Signal("u", "N.m", "Torque of the motor"),),
    references=PLACE,
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"x": "x_ref"},
    noise={"v": 0.02, "omega": 0.02},
    step=0.01,
    divergence=2.0,
    rate=27.7,
    limit=18.8,
    speed="v",
    pace=0.5,
    omitted={"limited-change": "the true parameters do not hold it either"},
)
