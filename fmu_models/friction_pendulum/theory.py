"""Equations of the FMUs of the pendulum with stiction, as HTML for their documentation."""

from collections.abc import Mapping

from ..kernel.theory import Theory

_SOURCE = (
    "Karnopp (1985), “Computer simulation of stick-slip friction in mechanical dynamic systems”; "
    "Armstrong-Helouvry, Dupont and Canudas de Wit (1994), “A survey of models, analysis tools and compensation "
    "methods for the control of machines with friction”."
)

THEORY: Mapping[str, Theory] = {
    "FrictionPendulum": Theory(
        (
            "m l φ̈ = F − f,  F = u − min(max(u, −u<sub>d</sub>), u<sub>d</sub>) + F<sub>d</sub> − m g sin φ − b l φ̇",
            "slip, |φ̇| &gt; φ̇<sub>0</sub>:  f = sign(φ̇) (F<sub>c</sub> + F<sub>s</sub> exp(−(φ̇/φ̇<sub>s</sub>)²))",
            "break-away, |F| &gt; F<sub>c</sub> + F<sub>s</sub>:  f = sign(F) (F<sub>c</sub> + F<sub>s</sub>)",
            "stick, otherwise:  φ̈ = −φ̇/τ",
        ),
        "φ (phi) = 0 hangs down. φ̇<sub>0</sub> is phi_dot_0, φ̇<sub>s</sub> is phi_dot_s, τ is tau, "
        "F<sub>d</sub> a disturbance. Keep max_step at most tau.",
        _SOURCE,
    ),
    "FrictionPendulumController": Theory(
        (
            "F = m l (φ̈<sub>ref</sub> + K<sub>p</sub> e<sub>1</sub> + K<sub>d</sub> e<sub>2</sub>) + m g sin φ + b l φ̇"
            " + s(φ̇<sub>ref</sub>/φ̇<sub>w</sub>) (F<sub>c</sub> + F<sub>s</sub> exp(−(φ̇/φ̇<sub>s</sub>)²))",
            "u = F + u<sub>d</sub> s(F/F<sub>w</sub>),  s(z) = min(max(z, −1), 1)",
            "e<sub>1</sub> = φ<sub>ref</sub> − φ,  e<sub>2</sub> = φ̇<sub>ref</sub> − φ̇",
        ),
        "The ramps s keep u from jumping at a reversal.",
        _SOURCE,
    ),
}
"""Texts by the FMU's name."""
