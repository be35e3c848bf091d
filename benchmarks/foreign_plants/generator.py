"""Generator at a stiff network: swing equation, and the excitation's one-axis model.

Kundur (1994), "Power System Stability and Control", sections 3.9 and 12.4.
State x = (delta [rad], omega [rad/s], E): the rotor's angle against the network, its rate, and the voltage behind the
transient reactance (per unit, as all that follows). The load is mechanical power that is added.
"""

from math import cos, pi, sin

from .plant import Estimated, ForeignPlant, Signal, Values, total, wave

SYNCHRONOUS = 2.0 * pi * 50.0
"""Speed of the network [rad/s]."""
POWER = 0.8
"""Mechanical power."""
ARMATURE = 0.8
"""Synchronous less transient reactance."""
FIELD = 5.0
"""Time constant of the field [s]."""
POLE = 8.0
"""Three poles of the angle's error at -8 rad/s."""


def derivative(x: Values, u: Values, H: float, D: float, X: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state, with the network's voltage 1.

    2 H/314 omega_dot = 0.8 - E sin delta/X - D omega + load,  5 E_dot = u - E - 0.8 (E - cos delta)/X

    u: (excitation);  H: inertia [s];  D: damping [s/rad];  X: reactance between E and the network.
    """
    delta, omega, E = x
    accelerating = POWER - E * sin(delta) / X - D * omega + load
    return (omega, accelerating * SYNCHRONOUS / (2.0 * H), (u[0] - E - ARMATURE * (E - cos(delta)) / X) / FIELD)


def control(x: Values, reference: Values, H: float, D: float, X: float) -> Values:
    """Return the excitation that makes the angle follow to its third derivative: feedback linearisation."""
    delta, omega, E = x
    acceleration = derivative(x, (0.0,), H, D, X)[1]
    gains, actual = (POLE**3, 3.0 * POLE**2, 3.0 * POLE), (delta, omega, acceleration)
    jerk = reference[3] + sum(k * (r - y) for k, r, y in zip(gains, reference, actual))
    power_rate = -2.0 * H / SYNCHRONOUS * jerk - D * acceleration
    E_dot = (power_rate * X - E * cos(delta) * omega) / sin(delta)
    return (FIELD * E_dot + E + ARMATURE * (E - cos(delta)) / X,)


def reference(t: float) -> Values:
    """Return the desired angle to its third derivative."""
    delta, *rates = total(wave(t, 0.1, 2.0, n=3), wave(t, 0.03, 5.0, n=3))
    return (0.6 + delta, *rates)


_DELTA, _OMEGA, _ALPHA, _ = reference(0.0)
_E = (POWER - 0.02 * _OMEGA - 8.0 / SYNCHRONOUS * _ALPHA) * 0.6 / sin(_DELTA)
_OWN = "damping is a parameter of the model"
PLANT = ForeignPlant(
    name="generator",
    title="Generator at a stiff network, with its excitation",
    parameters=(
        Estimated("H", "s", 4.0, 5.5, "Inertia"),
        Estimated("D", "s/rad", 0.02, 0.035, "Damping"),
        Estimated("X", "1", 0.6, 0.42, "Reactance to the network"),
    ),
    states=(
        Signal("delta", "rad", "Angle of the rotor", _DELTA),
        Signal("omega", "rad/s", "Speed against the network", _OMEGA),
        Signal("E", "1", "Voltage behind the transient reactance", _E),
    ),
    controls=(Signal("u", "1", "Excitation"),),
    references=(
        Signal("delta_ref", "rad", "Desired angle"),
        Signal("omega_ref", "rad/s", "Its derivative"),
        Signal("alpha_ref", "rad/s2", "Its second derivative"),
        Signal("jerk_ref", "rad/s3", "Its third derivative"),
    ),
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"delta": "delta_ref"},
    noise={"omega": 0.02, "E": 0.005},
    step=0.005,
    divergence=0.5,
    rate=6.4,
    limit=2.0,
    omitted={"viscous": _OWN, "dry": "nothing rubs"},
)
