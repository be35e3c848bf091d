"""Steel ball that a magnet holds in the air, with the coil's electrical dynamics: unstable without its controller.

Barie and Chiasson (1996), "Linear and nonlinear state-space controllers for magnetic levitation", Int. J. Systems
Science 27. State x = (y [m], v [m/s], i [A]): gap, downwards, its rate, and the coil's current. The load is a force on
the ball [N].
"""

from .plant import Estimated, ForeignPlant, Signal, Values, total, wave

G = 9.81
FORCE = 9.81e-5
"""Coefficient of the magnet's force [N m^2/A^2]: 1 A holds 0.1 kg at 10 mm."""
INDUCTANCE = 0.1
"""Inductance of the coil [H]."""
POLE = 80.0
"""Three poles of the gap's error at -80 rad/s."""


def derivative(x: Values, u: Values, m: float, R: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state: m v_dot = m g - 9.81e-5 i^2/y^2 + load,  0.1 i_dot = u - R i.

    u: (voltage [V]);  m: mass of the ball [kg];  R: resistance of the coil [ohm].
    """
    y, v, i = x
    return (v, G + (load - FORCE * (i / y) ** 2) / m, (u[0] - R * i) / INDUCTANCE)


def control(x: Values, reference: Values, m: float, R: float) -> Values:
    """Return the voltage that makes the gap follow to its third derivative: feedback linearisation."""
    y, v, i = x
    i = max(i, 0.05)
    pull = FORCE * (i / y) ** 2 / m
    gains, actual = (POLE**3, 3.0 * POLE**2, 3.0 * POLE), (y, v, G - pull)
    jerk = reference[3] + sum(k * (r - z) for k, r, z in zip(gains, reference, actual))
    i_dot = i * (v / y - jerk / (2.0 * pull))
    return (INDUCTANCE * i_dot + R * i,)


def reference(t: float) -> Values:
    """Return the desired gap to its third derivative."""
    y, *rates = total(wave(t, 1.5e-3, 15.0, n=3), wave(t, 0.3e-3, 40.0, n=3))
    return (0.01 + y, *rates)


_Y, _V, _A, _ = reference(0.0)
_NO_RUB = "nothing touches the ball"
PLANT = ForeignPlant(
    name="maglev",
    title="Ball in the field of a magnet",
    parameters=(
        Estimated("m", "kg", 0.1, 0.13, "Mass of the ball"),
        Estimated("R", "Ohm", 10.0, 12.0, "Resistance of the coil"),
    ),
    states=(
        Signal("y", "m", "Gap", _Y),
        Signal("v", "m/s", "Its rate", _V),
        Signal("i", "A", "Current of the coil", _Y * (0.1 * (G - _A) / FORCE) ** 0.5),
    ),
    controls=(Signal("u", "V", "Voltage of the coil"),),
    references=(
        Signal("y_ref", "m", "Desired gap"),
        Signal("v_ref", "m/s", "Its rate"),
        Signal("a_ref", "m/s2", "Its second derivative"),
        Signal("jerk_ref", "m/s3", "Its third derivative"),
    ),
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"y": "y_ref"},
    noise={"v": 0.02, "i": 0.2},
    step=0.001,
    divergence=0.007,
    rate=46.0,
    limit=12.2,
    omitted={
        "rate-change": "the true parameters do not hold it either",
        "limited-change": "the true parameters do not hold it either",
        "viscous": _NO_RUB,
        "dry": _NO_RUB,
    },
)
