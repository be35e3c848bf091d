"""Thermal process of two masses: a heater warms a vessel, which loses heat to the room.

State x = (T_1, T_2) [K above the room]: heater and vessel. The load is heat that comes from elsewhere into the vessel
[W].
"""

from .plant import Estimated, ForeignPlant, Signal, Values, total, wave

OWN = 200.0
"""Heat capacity of the heater [J/K]."""
THROUGH = 20.0
"""Conductance from heater to vessel [W/K]."""
POLE = 0.06
"""Both poles of the error at -0.06 rad/s."""


def derivative(x: Values, u: Values, C: float, G: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state: 200 T_1_dot = u - q,  C T_2_dot = q - G T_2 + load,  q = 20 (T_1 - T_2).

    u: (power [W]);  C: heat capacity of the vessel [J/K];  G: conductance to the room, the loss coefficient [W/K].
    """
    flow = THROUGH * (x[0] - x[1])
    return ((u[0] - flow) / OWN, (flow - G * x[1] + load) / C)


def control(x: Values, reference: Values, C: float, G: float) -> Values:
    """Return the power that makes the vessel follow to its second derivative: feedback linearisation."""
    flow = THROUGH * (x[0] - x[1])
    rate = (flow - G * x[1]) / C
    wanted = reference[2] + 2.0 * POLE * (reference[1] - rate) + POLE**2 * (reference[0] - x[1])
    return (OWN * (rate + (C * wanted + G * rate) / THROUGH) + flow,)


def reference(t: float) -> Values:
    """Return the desired temperature of the vessel to its second derivative."""
    T, rate, curvature = total(wave(t, 3.0, 0.02, n=2), wave(t, 0.7, 0.06, n=2))
    return (25.0 + T, rate, curvature)


_T, _RATE, _ = reference(0.0)
_SAME = "there is no motion"
PLANT = ForeignPlant(
    name="heater",
    title="Heater and vessel",
    parameters=(
        Estimated("C", "J/K", 2000.0, 3000.0, "Heat capacity of the vessel"),
        Estimated("G", "W/K", 12.0, 18.0, "Loss coefficient"),
    ),
    states=(
        Signal("T_1", "K", "Temperature of the heater above the room", _T + (2000.0 * _RATE + 12.0 * _T) / THROUGH),
        Signal("T_2", "K", "Temperature of the vessel above the room", _T),
    ),
    controls=(Signal("u", "W", "Power"),),
    references=(
        Signal("T_ref", "K", "Desired temperature of the vessel"),
        Signal("T_dot_ref", "K/s", "Its derivative"),
        Signal("T_ddot_ref", "K/s2", "Its second derivative"),
    ),
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"T_2": "T_ref"},
    noise={"T_1": 5e-3, "T_2": 5e-4},
    step=1.0,
    divergence=15.0,
    rate=6.8,
    limit=430.0,
    omitted={"viscous": _SAME, "dry": _SAME},
)
