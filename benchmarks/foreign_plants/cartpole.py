"""Cart with a pole that stands on it, stabilised: unstable without its controller. The pole is a point mass on a rod.

State x = (x [m], v [m/s], phi [rad], omega [rad/s]): the cart, and the pole's angle from upright. The load is a force
on the cart [N].
"""

from math import cos, sin

from .plant import PLACE, Estimated, ForeignPlant, Signal, Values, wave

G = 9.81
CART = 1.0
"""Mass of the cart [kg]."""
OMEGA = 1.5
"""Angular frequency of the reference [rad/s]."""
POLE = 3.5
"""Four poles of the error at -3.5 rad/s."""


def derivative(x: Values, u: Values, m: float, l: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state.

    (1 + m sin^2 phi) v_dot = u + load + m l omega^2 sin phi - m g sin phi cos phi,  l omega_dot = g sin phi - v_dot cos
    phi

    u: (force on the cart [N]);  m: mass of the pole [kg];  l: its length [m].
    """
    _, v, phi, omega = x
    s, c = sin(phi), cos(phi)
    a = (u[0] + load + m * l * omega * omega * s - m * G * s * c) / (CART + m * s * s)
    return (v, a, omega, (G * s - a * c) / l)


def control(x: Values, reference: Values, m: float, l: float) -> Values:
    """Return the force: feedforward and state feedback on y = x + l phi, whose second derivative is about g phi."""
    place, v, phi, omega = x
    share = 1.0 / (1.0 + l * OMEGA**2 / G)  # of x in y, for a sinusoid
    actual, gains = (place + l * phi, v + l * omega, G * phi, G * omega), (POLE**4, 4 * POLE**3, 6 * POLE**2, 4 * POLE)
    snap = reference[4] * share + sum(k * (share * r - y) for k, r, y in zip(gains, reference, actual))
    s, c = sin(phi), cos(phi)
    a = (G * s - l * snap / G) / c
    return (a * (CART + m * s * s) - m * l * omega * omega * s + m * G * s * c,)


def reference(t: float) -> Values:
    """Return the desired place of the cart to its fourth derivative."""
    return wave(t, 0.4, OMEGA)


_X, _V, _A, _JERK, _ = reference(0.0)
_SHARE = 1.0 / (1.0 + 0.5 * OMEGA**2 / G)
PLANT = ForeignPlant(
    name="cartpole",
    title="Cart with a pole that stands on it",
    parameters=(
        Estimated("m", "kg", 0.3, 0.5, "Mass of the pole"),
        Estimated("l", "m", 0.5, 0.7, "Length of the pole"),
    ),
    states=(
        Signal("x", "m", "Place of the cart", _X),
        Signal("v", "m/s", "Speed of the cart", _V),
        Signal("phi", "rad", "Angle of the pole from upright", _SHARE * _A / G),
        Signal("omega", "rad/s", "Speed of the pole", _SHARE * _JERK / G),
    ),
    controls=(Signal("u", "N", "Force on the cart"),),
    references=PLACE,
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"x": "x_ref"},
    noise={"v": 0.005, "omega": 0.02},
    step=0.01,
    divergence=1.5,
    rate=1.75,
    limit=1.13,
    omitted={"limited-change": "the true parameters do not hold it either"},
    speed="v",
    pace=0.5,
)
