"""Chemostat with Monod's kinetics.

Bastin and Dochain (1990), "On-line Estimation and Adaptive Control of Bioreactors", chapter 1.
A second of the run is an hour of the plant. State x = (X [g/l], S [g/l]): biomass and substrate. The load is substrate
that comes from elsewhere [g/(l h)].
"""

from .plant import Estimated, ForeignPlant, Signal, Values, limited, total, wave

FEED = 20.0
"""Substrate in the feed [g/l]."""
POLE = 2.0
"""Pole of the substrate's error at -2 per hour."""
MOST = 3.0
"""Largest dilution rate [1/h]."""


def derivative(x: Values, u: Values, mu_max: float, K_s: float, Y: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state: X_dot = (mu - D) X,  S_dot = D (20 - S) - mu X/Y + load.

    u: (dilution rate D [1/h]);  mu = mu_max S/(K_s + S);  mu_max: [1/h];  K_s: [g/l];  Y: yield.
    """
    biomass, S = x
    growth = mu_max * S / (K_s + S) * biomass
    return (growth - u[0] * biomass, u[0] * (FEED - S) - growth / Y + load)


def control(x: Values, reference: Values, mu_max: float, K_s: float, Y: float) -> Values:
    """Return the dilution rate of the feedback-linearising law."""
    biomass, S = x
    consumed = mu_max * S / (K_s + S) * biomass / Y
    return (limited((reference[1] + POLE * (reference[0] - S) + consumed) / (FEED - S), 0.0, MOST),)


def reference(t: float) -> Values:
    """Return the desired substrate and its derivative."""
    S, rate = total(wave(t, 0.5, 0.5, n=1), wave(t, 0.1, 1.3, n=1))
    return (1.3 + S, rate)


_SAME = "there is no motion"
PLANT = ForeignPlant(
    name="bio",
    title="Chemostat with Monod's kinetics",
    parameters=(
        Estimated("mu_max", "1/s", 0.6, 0.85, "Largest growth rate, by hour"),
        Estimated("K_s", "kg/m3", 1.0, 1.5, "Substrate at which it is half of that"),
        Estimated("Y", "1", 0.5, 0.65, "Yield"),
    ),
    states=(Signal("X", None, "Biomass, in g/l", 9.4), Signal("S", None, "Substrate, in g/l", 1.3)),
    controls=(Signal("D", "1/s", "Dilution rate, by hour"),),
    references=(
        Signal("S_ref", None, "Desired substrate, in g/l"),
        Signal("S_dot_ref", None, "Its derivative"),
    ),
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"S": "S_ref"},
    noise={"X": 0.01, "S": 0.01},
    step=0.05,
    divergence=3.0,
    rate=0.048,
    limit=0.375,
    omitted={"viscous": _SAME, "dry": _SAME},
)
