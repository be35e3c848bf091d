"""Speed of a permanent-magnet synchronous motor, in coordinates that turn with its rotor.

Krause, Wasynczuk and Sudhoff (2002), "Analysis of Electric Machinery and Drive Systems", section 6.3. State
x = (omega [rad/s], i_q [A], i_d [A]): speed, and the currents along and across the torque. The load is a torque on the
shaft [N m].
"""

from .plant import SPEED, Estimated, ForeignPlant, Signal, Values, total, wave

INDUCTANCE = 4e-4
"""Inductance along either axis [H]."""
INERTIA = 5e-5
"""Inertia of the rotor [kg m^2]."""
PAIRS = 4
"""Number of pairs of poles."""
POLE = 600.0
"""All poles of the errors at -600 rad/s."""


def derivative(x: Values, u: Values, R: float, psi: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state.

    J omega_dot = 1.5 p psi i_q + load,  L i_q_dot = u_q - R i_q - p omega (L i_d + psi),
    L i_d_dot = u_d - R i_d + p omega L i_q

    u: (u_q, u_d [V]);  R: resistance [ohm];  psi: flux of the magnets [V s].
    """
    omega, i_q, i_d = x
    u_q, u_d = u
    turning = PAIRS * omega
    q = (u_q - R * i_q - turning * (INDUCTANCE * i_d + psi)) / INDUCTANCE
    d = (u_d - R * i_d + turning * INDUCTANCE * i_q) / INDUCTANCE
    return ((1.5 * PAIRS * psi * i_q + load) / INERTIA, q, d)


def control(x: Values, reference: Values, R: float, psi: float) -> Values:
    """Return the voltages that make the speed follow, and i_d vanish: feedback linearisation."""
    omega, i_q, i_d = x
    omega_ref, alpha_ref, jerk_ref = reference
    by_current = 1.5 * PAIRS * psi / INERTIA
    jerk = jerk_ref + 2.0 * POLE * (alpha_ref - by_current * i_q) + POLE**2 * (omega_ref - omega)
    turning = PAIRS * omega
    u_q = INDUCTANCE * jerk / by_current + R * i_q + turning * (INDUCTANCE * i_d + psi)
    return (u_q, (R - INDUCTANCE * POLE) * i_d - turning * INDUCTANCE * i_q)


def reference(t: float) -> Values:
    """Return the desired speed to its second derivative."""
    return total(wave(t, 150.0, 40.0, n=2), wave(t, 30.0, 110.0, n=2))


_OMEGA, _ALPHA, _ = reference(0.0)
PLANT = ForeignPlant(
    name="pmsm",
    title="Synchronous motor with permanent magnets",
    parameters=(
        Estimated("R", "Ohm", 0.3, 0.4, "Resistance of a winding"),
        Estimated("psi", "V.s", 0.01, 0.0085, "Flux of the magnets"),
    ),
    states=(
        Signal("omega", "rad/s", "Speed", _OMEGA),
        Signal("i_q", "A", "Current along the torque", INERTIA * _ALPHA / (1.5 * PAIRS * 0.01)),
        Signal("i_d", "A", "Current across the torque"),
    ),
    controls=(Signal("u_q", "V", "Voltage along the torque"), Signal("u_d", "V", "Voltage across it")),
    references=SPEED,
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"omega": "omega_ref"},
    noise={"omega": 50.0, "i_q": 100.0},
    step=2e-4,
    divergence=150.0,
    rate=300.0,
    limit=6.0,
    speed="omega",
    pace=100.0,
)
