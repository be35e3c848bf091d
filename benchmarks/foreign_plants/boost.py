"""Boost converter, averaged over the switching period.

Sira-Ramirez and Silva-Ortigoza (2006), "Control Design Techniques in Power Electronics Devices", section 2.3.
State x = (i [A], v [V]): current of the inductor, voltage of the capacitor. The load from outside is a voltage in
series with the inductor [V]; its friction is the inductor's resistance.
"""

from .plant import Estimated, ForeignPlant, Signal, Values, limited, wave

SOURCE = 12.0
"""Voltage of the source [V]."""
CAPACITY = 1e-3
"""Capacity of the output [F]."""
MEAN = 26.0
"""Mean of the desired voltage [V]."""
POLE = 800.0
"""Both poles of the error of the stored energy at -800 rad/s."""


def derivative(x: Values, u: Values, L: float, R: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state: L i_dot = E - (1 - u) v + load,  C v_dot = (1 - u) i - v/R.

    u: (duty ratio);  L: inductance [H];  R: resistance of the consumer [ohm].
    """
    i, v = x
    rest = 1.0 - u[0]
    return ((SOURCE - rest * v + load) / L, (rest * i - v / R) / CAPACITY)


def control(x: Values, reference: Values, L: float, R: float) -> Values:
    """Return the duty ratio by which the stored energy, the flat output, follows to its second derivative."""
    i, v = x
    v_ref, v_dot, v_ddot = reference
    i_ref = (v_ref * v_ref / R + CAPACITY * v_ref * v_dot) / SOURCE
    i_dot = (2.0 * v_ref * v_dot / R + CAPACITY * (v_dot * v_dot + v_ref * v_ddot)) / SOURCE
    i_ref += L * i_ref * i_dot / SOURCE  # what the inductor takes up of the power
    energy = 0.5 * (L * i * i + CAPACITY * v * v)
    desired = 0.5 * (L * i_ref * i_ref + CAPACITY * v_ref * v_ref)
    power, power_ref = SOURCE * i - v * v / R, SOURCE * i_ref - v_ref * v_ref / R
    wanted = SOURCE * i_dot - 2.0 * v_ref * v_dot / R + 2.0 * POLE * (power_ref - power) + POLE**2 * (desired - energy)
    free = SOURCE * SOURCE / L + 2.0 * v * v / (R * R * CAPACITY)
    rest = (free - wanted) / (SOURCE * v / L + 2.0 * v * i / (R * CAPACITY))
    return (limited(1.0 - rest, 0.0, 0.95),)


def reference(t: float) -> Values:
    """Return the desired voltage to its second derivative."""
    v, v_dot, v_ddot = wave(t, 3.0, 200.0, n=2)
    return (MEAN + v, v_dot, v_ddot)


_V, _V_DOT, _ = reference(0.0)
PLANT = ForeignPlant(
    name="boost",
    title="Averaged boost converter",
    parameters=(
        Estimated("L", "H", 1e-3, 1.5e-3, "Inductance"),
        Estimated("R", "Ohm", 20.0, 30.0, "Resistance of the consumer"),
    ),
    states=(
        Signal("i", "A", "Current of the inductor", (_V * _V / 20.0 + CAPACITY * _V * _V_DOT) / SOURCE),
        Signal("v", "V", "Voltage of the capacitor", _V),
    ),
    controls=(Signal("u", "1", "Duty ratio"),),
    references=(
        Signal("v_ref", "V", "Desired voltage"),
        Signal("v_dot_ref", "V/s", "Its derivative"),
        Signal("v_ddot_ref", "V/s2", "Its second derivative"),
    ),
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"v": "v_ref"},
    noise={"i": 5.0, "v": 3.0},
    step=1e-4,
    divergence=15.0,
    rate=7.2,
    limit=0.56,
    speed="i",
    pace=4.0,
    omitted={"dry": "the current has one direction, so a diode's voltage is a constant"},
)
