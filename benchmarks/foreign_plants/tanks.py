"""Two tanks in a row, the first of which a pump fills, and whose second level is controlled.

Slotine and Li (1991), "Applied Nonlinear Control", example 6.1, with a second tank. State x = (h1 [m], h2 [m]): levels.
The load is a flow into the second tank [m^3/s], which no input reaches at once.
"""

from math import sqrt

from .plant import Estimated, ForeignPlant, Signal, Values, total, wave

G = 9.81
AREA = 0.02
"""Cross-section of each tank [m^2]."""
POLE = 0.05
"""Both poles of the error of the second level at -0.05 rad/s."""
_LEAST = 1e-3
"""Least level that an outlet is computed with [m]."""


def derivative(x: Values, u: Values, a1: float, a2: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state.

    A h1_dot = u - a1 sqrt(2 g h1),  A h2_dot = a1 sqrt(2 g h1) - a2 sqrt(2 g h2) + load

    u: (flow of the pump [m^3/s]);  a1, a2: effective outlets of the first and the second tank [m^2].
    """
    between, out = a1 * sqrt(2.0 * G * max(x[0], _LEAST)), a2 * sqrt(2.0 * G * max(x[1], _LEAST))
    return ((u[0] - between) / AREA, (between - out + load) / AREA)


def control(x: Values, reference: Values, a1: float, a2: float) -> Values:
    """Return the flow that makes the second level follow to its second derivative: feedback linearisation."""
    level, rate, wanted = reference
    h1, h2 = (max(h, _LEAST) for h in x)
    between, out = a1 * sqrt(2.0 * G * h1), a2 * sqrt(2.0 * G * h2)
    h2_dot = (between - out) / AREA
    wanted += 2.0 * POLE * (rate - h2_dot) + POLE * POLE * (level - h2)
    by_level = G * a1 * a1 / between  # d between / d h1
    h1_dot = (AREA * wanted + h2_dot * G * a2 * a2 / out) / by_level
    return (AREA * h1_dot + between,)


def reference(t: float) -> Values:
    """Return the desired level to its second derivative."""
    level, *others = total(wave(t, 0.04, 0.006, n=2), wave(t, 0.006, 0.016, n=2))
    return (0.3 + level, *others)


_H2, _RATE, _ = reference(0.0)
_A1, _A2 = 1.0e-5, 0.9e-5
_H1 = ((AREA * _RATE + _A2 * sqrt(2.0 * G * _H2)) / _A1) ** 2 / (2.0 * G)
PLANT = ForeignPlant(
    name="tanks",
    title="Two tanks in a row",
    parameters=(
        Estimated("a1", "m2", _A1, 1.3e-5, "Effective outlet of the first tank"),
        Estimated("a2", "m2", _A2, 0.8e-5, "Effective outlet of the second tank"),
    ),
    states=(
        Signal("h1", "m", "Level of the first tank", _H1),
        Signal("h2", "m", "Level of the second tank", _H2),
    ),
    controls=(Signal("u", "m3/s", "Flow of the pump"),),
    references=(
        Signal("h_ref", "m", "Desired level of the second tank"),
        Signal("rate_ref", "m/s", "Its derivative"),
        Signal("a_ref", "m/s2", "Its second derivative"),
    ),
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"h2": "h_ref"},
    noise={"h1": 2e-5, "h2": 2e-5},
    step=2.0,
    divergence=0.3,
    rate=2.5e-7,
    limit=3.8e-5,
    omitted={"rate-change": "the true parameters do not hold it either"},
)
