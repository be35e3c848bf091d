"""Speed of a permanent-magnet DC motor with the electrical dynamics of its winding.

Krishnan (2001), "Electric Motor Drives", section 2.2. State x = (omega [rad/s], i [A]): speed and current. The load is
a torque on the shaft [N m].
"""

from .plant import SPEED, Estimated, ForeignPlant, Signal, Values, total, wave

INDUCTANCE = 1e-3
"""Inductance of the winding [H]."""
POLE = 300.0
"""Both poles of the speed's error at -300 rad/s."""


def derivative(x: Values, u: Values, R: float, K: float, J: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state: J omega_dot = K i + load,  1e-3 i_dot = u - R i - K omega.

    u: (voltage [V]);  R: resistance [ohm];  K: torque by current [N m/A], and voltage by speed;  J: inertia [kg m^2].
    """
    omega, i = x
    return ((K * i + load) / J, (u[0] - R * i - K * omega) / INDUCTANCE)


def control(x: Values, reference: Values, R: float, K: float, J: float) -> Values:
    """Return the voltage that makes the speed follow to its second derivative: feedback linearisation."""
    omega, i = x
    omega_ref, alpha_ref, jerk_ref = reference
    jerk = jerk_ref + 2.0 * POLE * (alpha_ref - K * i / J) + POLE**2 * (omega_ref - omega)
    return (INDUCTANCE * J * jerk / K + R * i + K * omega,)


def reference(t: float) -> Values:
    """Return the desired speed to its second derivative."""
    return total(wave(t, 120.0, 20.0, n=2), wave(t, 30.0, 55.0, n=2))


_OMEGA, _ALPHA, _ = reference(0.0)
PLANT = ForeignPlant(
    name="motor",
    title="DC motor with a permanent magnet",
    parameters=(
        Estimated("R", "Ohm", 1.0, 1.3, "Resistance of the winding"),
        Estimated("K", "N.m/A", 0.05, 0.044, "Torque by current"),
        Estimated("J", "kg.m2", 1e-4, 1.5e-4, "Inertia"),
    ),
    states=(
        Signal("omega", "rad/s", "Speed", _OMEGA),
        Signal("i", "A", "Current", 1e-4 * _ALPHA / 0.05),
    ),
    controls=(Signal("u", "V", "Voltage"),),
    references=SPEED,
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"omega": "omega_ref"},
    noise={"omega": 20.0, "i": 5.0},
    step=5e-4,
    divergence=120.0,
    rate=275.0,
    limit=9.0,
    speed="omega",
    pace=90.0,
)
