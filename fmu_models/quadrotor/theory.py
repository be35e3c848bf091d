"""Equations of the FMUs of the quadrotor, as HTML for their documentation."""

from collections.abc import Mapping

from ..kernel.theory import Theory

_KHAN = (
    "Khan and Chatterjee (2020), “Online parameter estimation for safety-critical systems with Gaussian processes”, "
    "section IV-B."
)
_LEE = (
    "Lee, Leok, McClamroch (2010), “Geometric tracking control of a quadrotor UAV on SE(3)”, equations 2-5 and 15-16."
)

THEORY: Mapping[str, Theory] = {
    "Quadrotor": Theory(
        (
            "ṙ = v",
            "v̇ = g e<sub>3</sub> − (F/m) R e<sub>3</sub> + (F<sub>d</sub> − k<sub>d</sub> v)/m",
            "Ṙ = R [Ω]<sub>×</sub>",
            "J dΩ/dt = M + M<sub>d</sub> − Ω × J Ω,  J = diag(J<sub>x</sub>, J<sub>y</sub>, J<sub>z</sub>)",
        ),
        "Inertial frame: z down (north-east-down). Body frame: z down, thrust along −z. R takes body to inertial "
        "vectors; Ω (Omega) and M are in body axes, and [Ω]<sub>×</sub> b = Ω × b. R is made orthogonal again after "
        "each step. F<sub>d</sub>, in inertial axes, and M<sub>d</sub>, in body axes, are disturbances.",
        _LEE,
    ),
    "QuadrotorController": Theory(
        (
            "A = −K<sub>r</sub> e<sub>r</sub> − K<sub>v</sub> e<sub>v</sub> − m g e<sub>3</sub> + m a<sub>d</sub>,"
            "  F = −A · R e<sub>3</sub>",
            "M = −K<sub>R</sub> e<sub>R</sub> − K<sub>Ω</sub> e<sub>Ω</sub> + Ω × J Ω"
            " − J ([Ω]<sub>×</sub> Rᵀ R<sub>d</sub> Ω<sub>d</sub> − Rᵀ R<sub>d</sub> dΩ<sub>d</sub>/dt)",
            "R<sub>d</sub>: third axis −A/|A|, heading ψ<sub>d</sub>; Ω<sub>d</sub> and dΩ<sub>d</sub>/dt from Ȧ and Ä",
            "e<sub>r</sub> = r − r<sub>d</sub>,  e<sub>v</sub> = v − v<sub>d</sub>,"
            "  ê<sub>R</sub> = (R<sub>d</sub>ᵀ R − Rᵀ R<sub>d</sub>)/2,"
            "  e<sub>Ω</sub> = Ω − Rᵀ R<sub>d</sub> Ω<sub>d</sub>",
        ),
        "Ȧ and Ä carry the error terms, with the acceleration that the controller's own m, F and R predict. "
        "Undefined, and an error, where A = 0 or A is along the heading.",
        _LEE,
    ),
    "QuadrotorReference": Theory(
        (
            "r<sub>d</sub> = (amplitude_x sin 2ωt, amplitude_y sin ωt, amplitude_z sin ωt), to its fourth derivative",
            "ψ<sub>d</sub> = atan2(y<sub>d</sub>, x<sub>d</sub>), or with smooth_yaw"
            " atan2(amplitude_y, 2 amplitude_x cos ωt), to its second derivative",
        ),
        "atan2 jumps by π where x<sub>d</sub> = y<sub>d</sub> = 0; the smooth branch does not. ω is omega.",
        _KHAN,
    ),
}
"""Texts by the FMU's name."""
