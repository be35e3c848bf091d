"""Hydraulic cylinder of equal areas with a servo valve, which moves a mass.

Merritt (1967), "Hydraulic Control Systems", section 6.1; Jelali and Kroll (2003), "Hydraulic Servo-systems".
State x = (s [m], v [m/s], p [Pa]): place and speed of the mass, and the pressure across the piston. The load is a force
on the mass [N].
"""

from math import copysign

from .plant import Estimated, ForeignPlant, Signal, Values, total, wave

SUPPLY = 1.4e7
"""Pressure of the supply [Pa]."""
AREA = 1e-3
"""Area of the piston [m^2]."""
VOLUME = 5e-4
"""Volume of oil [m^3]."""
VALVE = 2.7e-7
"""Flow of the open valve by the root of pressure [m^3/(s Pa^0.5)]."""
LEAKAGE = 1e-11
"""Flow past the piston by pressure [m^3/(s Pa)]."""
POLE = 60.0
"""Three poles of the error at -60 rad/s."""


def _root(p: float, direction: float) -> float:
    """Return the root of the pressure across the valve's edge [Pa^0.5]."""
    return max(SUPPLY - copysign(p, direction * p), 1e4) ** 0.5


def derivative(x: Values, u: Values, m: float, E: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state: m v_dot = A p + load,  V/(4 E) p_dot = Q - A v - 1e-11 p.

    Q = 2.7e-7 u sqrt(1.4e7 - sign(u) p);  u: (opening of the valve);  m: mass [kg];  E: bulk modulus of the oil [Pa].
    """
    _, v, p = x
    flow = VALVE * u[0] * _root(p, u[0])
    return (v, (AREA * p + load) / m, 4.0 * E / VOLUME * (flow - AREA * v - LEAKAGE * p))


def control(x: Values, reference: Values, m: float, E: float) -> Values:
    """Return the valve's opening that makes the mass follow to its third derivative: feedback linearisation."""
    s, v, p = x
    gains, actual = (POLE**3, 3.0 * POLE**2, 3.0 * POLE), (s, v, AREA * p / m)
    jerk = reference[3] + sum(k * (r - y) for k, r, y in zip(gains, reference, actual))
    flow = VOLUME / (4.0 * E) * m * jerk / AREA + AREA * v + LEAKAGE * p
    return (flow / (VALVE * _root(p, flow)),)


def reference(t: float) -> Values:
    """Return the desired place to its third derivative."""
    return total(wave(t, 0.04, 10.0, n=3), wave(t, 0.005, 27.0, n=3))


_S, _V, _A, _ = reference(0.0)
PLANT = ForeignPlant(
    name="cylinder",
    title="Hydraulic cylinder with a servo valve",
    parameters=(
        Estimated("m", "kg", 400.0, 600.0, "Mass"),
        Estimated("E", "Pa", 8e8, 5e8, "Bulk modulus of the oil"),
    ),
    states=(
        Signal("s", "m", "Place", _S),
        Signal("v", "m/s", "Speed", _V),
        Signal("p", "Pa", "Pressure across the piston", 400.0 * _A / AREA),
    ),
    controls=(Signal("u", "1", "Opening of the valve"),),
    references=(
        Signal("s_ref", "m", "Desired place"),
        Signal("v_ref", "m/s", "Desired speed"),
        Signal("a_ref", "m/s2", "Desired acceleration"),
        Signal("jerk_ref", "m/s3", "Desired derivative of the acceleration"),
    ),
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"s": "s_ref"},
    noise={"v": 0.05, "p": 5e5},
    step=0.001,
    divergence=0.06,
    rate=6.6,
    limit=0.44,
    speed="v",
    pace=0.3,
)
