"""Equations of the FMUs of the pendulum, as HTML for their documentation."""

from collections.abc import Mapping

from ..kernel.theory import Theory

_SOURCE = (
    "Khan and Chatterjee (2020), “Online parameter estimation for safety-critical systems with Gaussian processes”, "
    "section IV-A."
)

THEORY: Mapping[str, Theory] = {
    "Pendulum": Theory(
        ("φ̈ = −(g/l) sin φ − (b/m) φ̇ + (u + F<sub>d</sub> − F<sub>c</sub> tanh(l φ̇/v<sub>s</sub>))/(m l)",),
        "φ (phi) = 0 hangs down; the input u is a tangential force, F<sub>d</sub> a disturbance, F<sub>c</sub> dry "
        "friction, smooth about rest: v<sub>s</sub> = 0.01 m/s. Keep max_step below 2 m v<sub>s</sub>/F<sub>c</sub>.",
        _SOURCE,
    ),
    "PendulumController": Theory(
        (
            "u = m l (K<sub>p</sub> e<sub>1</sub> + K<sub>d</sub> e<sub>2</sub>) + m l ((g/l) sin φ + (b/m) φ̇)",
            "e<sub>1</sub> = φ<sub>ref</sub> − φ,  e<sub>2</sub> = φ̇<sub>ref</sub> − φ̇",
        ),
        "With true parameters the error obeys ë<sub>1</sub> + K<sub>d</sub> ė<sub>1</sub> + K<sub>p</sub> e<sub>1</sub>"
        " = 0. m, l and b are what the controller believes in; they may be changed at every communication point.",
        _SOURCE,
    ),
    "PendulumReference": Theory(
        ("φ<sub>ref</sub> = phi_initial for t &lt; step_time, phi_final from then on",),
        "The desired angular velocity is zero.",
        _SOURCE,
    ),
    "PendulumSine": Theory(
        (
            "φ<sub>ref</sub> = amplitude_1 sin(omega_1 t) + amplitude_2 sin(omega_2 t)",
            "φ̇<sub>ref</sub> and φ̈<sub>ref</sub>: its exact time derivatives",
        ),
        "Two frequencies show more parameters than one.",
        "",
    ),
}
"""Texts by the FMU's name."""
