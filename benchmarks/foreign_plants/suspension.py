"""Quarter of a car with an actuator beside its spring, which moves the body up and down.

Hrovat (1997), "Survey of advanced suspension developments and related optimal control applications", Automatica 33.
State x = (z [m], v [m/s], z_w [m], v_w [m/s]): body and wheel, above their places at rest. The load is a force on the
body [N].
"""

from .plant import PLACE, Estimated, ForeignPlant, Signal, Values, total, wave

WHEEL = 40.0
"""Mass of the wheel [kg]."""
DAMPER = 1000.0
"""Damper between body and wheel [N s/m]."""
TYRE, TYRE_DAMPER = 190e3, 300.0
"""Stiffness [N/m] and damping [N s/m] of the tyre."""
POLE = 15.0
"""Both poles of the body's error at -15 rad/s."""


def derivative(x: Values, u: Values, m: float, k: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state.

    m v_dot = F + load,  40 v_w_dot = -F - 190e3 z_w - 300 v_w,  F = u - k (z - z_w) - 1000 (v - v_w)

    u: (force of the actuator [N]);  m: mass of the body [kg];  k: stiffness of the spring [N/m].
    """
    z, v, z_w, v_w = x
    force = u[0] - k * (z - z_w) - DAMPER * (v - v_w)
    return (v, (force + load) / m, v_w, (-force - TYRE * z_w - TYRE_DAMPER * v_w) / WHEEL)


def control(x: Values, reference: Values, m: float, k: float) -> Values:
    """Return the force that makes the body follow, whatever the wheel does."""
    z, v, z_w, v_w = x
    z_ref, v_ref, a_ref = reference
    wanted = a_ref + 2.0 * POLE * (v_ref - v) + POLE**2 * (z_ref - z)
    return (m * wanted + k * (z - z_w) + DAMPER * (v - v_w),)


def reference(t: float) -> Values:
    """Return the desired place of the body to its second derivative."""
    return total(wave(t, 0.04, 6.0, n=2), wave(t, 0.01, 17.0, n=2))


_Z, _V, _ = reference(0.0)
PLANT = ForeignPlant(
    name="suspension",
    title="Quarter of a car with an active suspension",
    parameters=(
        Estimated("m", "kg", 300.0, 410.0, "Mass of the body"),
        Estimated("k", "N/m", 16e3, 13e3, "Stiffness of the spring"),
    ),
    states=(
        Signal("z", "m", "Place of the body", _Z),
        Signal("v", "m/s", "Speed of the body", _V),
        Signal("z_w", "m", "Place of the wheel"),
        Signal("v_w", "m/s", "Speed of the wheel"),
    ),
    controls=(Signal("u", "N", "Force of the actuator"),),
    references=PLACE[:3],
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"z": "x_ref"},
    noise={"v": 0.05, "v_w": 0.5},
    step=0.004,
    divergence=0.5,
    rate=1.3e4,
    limit=700.0,
    speed="v",
    pace=0.25,
)
