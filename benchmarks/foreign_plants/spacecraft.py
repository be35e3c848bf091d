"""Rates of a spacecraft that thrusters turn.

Wie (2008), "Space Vehicle Dynamics and Control", chapter 6: Euler's equations about the principal axes. State
x = (w1, w2, w3 [rad/s]). The load is a torque about the first axis [N m].
"""

from .plant import Estimated, ForeignPlant, Signal, Values, wave

POLE = 0.8
"""Pole of each rate's error [rad/s]."""


def derivative(x: Values, u: Values, J1: float, J2: float, J3: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state: J1 w1_dot = (J2 - J3) w2 w3 + u1 + load, and so on in turn.

    u: (u1, u2, u3: torques [N m]);  J1, J2, J3: moments of inertia [kg m^2].
    """
    w1, w2, w3 = x
    u1, u2, u3 = u
    return (
        ((J2 - J3) * w2 * w3 + u1 + load) / J1,
        ((J3 - J1) * w3 * w1 + u2) / J2,
        ((J1 - J2) * w1 * w2 + u3) / J3,
    )


def control(x: Values, reference: Values, J1: float, J2: float, J3: float) -> Values:
    """Return the torques that make the rates follow: computed torque."""
    w1, w2, w3 = x
    a1, a2, a3 = (a + POLE * (w_ref - w) for w, w_ref, a in zip(x, reference[:3], reference[3:]))
    return (
        J1 * a1 - (J2 - J3) * w2 * w3,
        J2 * a2 - (J3 - J1) * w3 * w1,
        J3 * a3 - (J1 - J2) * w1 * w2,
    )


def reference(t: float) -> Values:
    """Return the desired rates, and their derivatives."""
    waves = (wave(t, 0.06, 0.25, n=1), wave(t, 0.05, 0.34, 1.0, n=1), wave(t, 0.07, 0.19, 2.0, n=1))
    return (*(w for w, _ in waves), *(a for _, a in waves))


_BEGIN = reference(0.0)
PLANT = ForeignPlant(
    name="spacecraft",
    title="Spacecraft that thrusters turn",
    parameters=(
        Estimated("J1", "kg.m2", 20.0, 27.0, "Moment of inertia about the first axis"),
        Estimated("J2", "kg.m2", 17.0, 19.0, "Moment of inertia about the second axis"),
        Estimated("J3", "kg.m2", 12.0, 10.0, "Moment of inertia about the third axis"),
    ),
    states=tuple(Signal(f"w{i + 1}", "rad/s", f"Rate about axis {i + 1}", _BEGIN[i]) for i in range(3)),
    controls=tuple(Signal(f"u{i}", "N.m", f"Torque about axis {i}") for i in (1, 2, 3)),
    references=(
        *(Signal(f"w{i}_ref", "rad/s", f"Desired rate about axis {i}") for i in (1, 2, 3)),
        *(Signal(f"a{i}_ref", "rad/s2", f"Desired acceleration about axis {i}") for i in (1, 2, 3)),
    ),
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"w1": "w1_ref", "w2": "w2_ref", "w3": "w3_ref"},
    noise={"w1": 2e-4, "w2": 2e-4, "w3": 2e-4},
    step=0.1,
    divergence=1.0,
    rate=0.065,
    limit=0.2,
    speed="w1",
    pace=0.04,
)
