"""Course of a ship by Nomoto's equation with Norrbin's cubic term.

Fossen (2011), "Handbook of Marine Craft and Hydrodynamics and Motion Control", section 7.2.
State x = (psi [rad], r [rad/s]): course and rate of turn. The load is what wind and waves do, as a rate of turn
[rad/s].
"""

from .plant import Estimated, ForeignPlant, Signal, Values, total, wave

CUBIC = 1000.0
"""Norrbin's coefficient of r^3 [s^2/rad^2]."""
POLE = 0.2
"""Both poles of the course's error at -0.2 rad/s."""


def derivative(x: Values, u: Values, T: float, K: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state: T r_dot = K u - r - 1000 r^3 + load.

    u: (rudder's angle [rad]);  T: time constant [s];  K: rate of turn by rudder [1/s].
    """
    r = x[1]
    return (r, (K * u[0] - r - CUBIC * r**3 + load) / T)


def control(x: Values, reference: Values, T: float, K: float) -> Values:
    """Return the rudder's angle of the feedback-linearising law."""
    psi, r = x
    psi_ref, r_ref, r_dot_ref = reference
    wanted = r_dot_ref + 2.0 * POLE * (r_ref - r) + POLE**2 * (psi_ref - psi)
    return ((T * wanted + r + CUBIC * r**3) / K,)


def reference(t: float) -> Values:
    """Return the desired course to its second derivative."""
    return total(wave(t, 0.4, 0.05, n=2), wave(t, 0.05, 0.13, n=2))


_NO_LAW = "the law of resistance is the model's own, so more of it is a change of T and K"
PLANT = ForeignPlant(
    name="ship",
    title="Course of a ship",
    parameters=(
        Estimated("T", "s", 10.0, 16.0, "Time constant"),
        Estimated("K", "1/s", 0.15, 0.1, "Rate of turn by rudder"),
    ),
    states=(Signal("psi", "rad", "Course"), Signal("r", "rad/s", "Rate of turn", reference(0.0)[1])),
    controls=(Signal("u", "rad", "Angle of the rudder"),),
    references=(
        Signal("psi_ref", "rad", "Desired course"),
        Signal("r_ref", "rad/s", "Desired rate of turn"),
        Signal("r_dot_ref", "rad/s2", "Its derivative"),
    ),
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"psi": "psi_ref"},
    noise={"r": 1e-5},
    step=0.5,
    divergence=1.5,
    rate=0.016,
    limit=0.24,
    omitted={"viscous": _NO_LAW, "dry": "nothing rubs"},
)
