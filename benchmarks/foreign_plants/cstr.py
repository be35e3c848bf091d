"""Stirred tank with an exothermic reaction, at its unstable middle steady state, with a cooling jacket.

Henson and Seborg (1997), "Nonlinear Process Control", chapter 1. A second of the run is a minute of the plant. State
x = (C [mol/l], T [K]): concentration and temperature. The load is heat from elsewhere [K/min].
"""

from math import exp

from .plant import Estimated, ForeignPlant, Signal, Values, limited, total, wave

FEED = 1.0
"""Concentration of the feed [mol/l]."""
WARM = 350.0
"""Temperature of the feed [K], and the one for which the rate of reaction is given."""
ACTIVATION = 8750.0
"""Activation energy over the gas constant [K]."""
HEAT = 209.2
"""Heat of reaction over the heat capacity [K l/mol]."""
POLE = 10.0
"""Pole of the temperature's error at -10 per minute."""


def derivative(x: Values, u: Values, k: float, h: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state, with the residence time 1 min.

    C_dot = 1 - C - r,  T_dot = 350 - T + 209.2 r - h (u + T - 350) + load,  r = k C exp(8750 (1/350 - 1/T))

    u: (cooling: the jacket below the feed [K]);  k: rate of reaction at 350 K [1/min];  h: heat transfer, by capacity
    [1/min].
    """
    C, T = x
    r = k * C * exp(ACTIVATION * (1.0 / WARM - 1.0 / T))
    return (FEED - C - r, WARM - T + HEAT * r + h * (WARM - u[0] - T) + load)


def control(x: Values, reference: Values, k: float, h: float) -> Values:
    """Return the cooling of the feedback-linearising law."""
    T = x[1]
    free = derivative(x, (WARM - T,), k, h)[1]
    return (limited(WARM - T - (reference[1] + POLE * (reference[0] - T) - free) / h, -50.0, 150.0),)


def reference(t: float) -> Values:
    """Return the desired temperature and its derivative."""
    T, rate = total(wave(t, 3.0, 1.0, n=1), wave(t, 0.8, 2.7, n=1))
    return (350.0 + T, rate)


_SAME = "there is no motion"
PLANT = ForeignPlant(
    name="cstr",
    title="Stirred tank with an exothermic reaction",
    parameters=(
        Estimated("k", "1/s", 1.0, 1.2, "Rate of reaction at 350 K, by minute"),
        Estimated("h", "1/s", 2.092, 1.8, "Heat transfer to the jacket by capacity, by minute"),
    ),
    states=(Signal("C", None, "Concentration, in mol/l", 0.52), Signal("T", "K", "Temperature", 350.0)),
    controls=(Signal("u", "K", "Temperature of the jacket, below the feed"),),
    references=(Signal("T_ref", "K", "Desired temperature"), Signal("T_dot_ref", "K/s", "Its derivative, by minute")),
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"T": "T_ref"},
    noise={"C": 0.005, "T": 0.2},
    step=0.02,
    divergence=25.0,
    rate=7.7,
    limit=53.2,
    omitted={
        "rate-change": "the true parameters do not hold it either",
        "limited-change": "the true parameters do not hold it either",
        "viscous": _SAME,
        "dry": _SAME,
    },
)
