"""Equations of the FMUs of the rigid body, as HTML for their documentation."""

from collections.abc import Mapping

from ..kernel.theory import Theory

_SOURCE = "Featherstone (2008), “Rigid Body Dynamics Algorithms”, sections 2.13-2.15."

THEORY: Mapping[str, Theory] = {
    "RigidBody": Theory(
        (
            "J dΩ/dt = M − c × F − Ω × J Ω",
            "v̇ = g e<sub>3</sub> + R (F/m − dΩ/dt × c − Ω × (Ω × c))",
            "ṙ = v,  Ṙ = R [Ω]<sub>×</sub>",
            "with F + Rᵀ (F<sub>d</sub> − k<sub>d</sub> v) for F, and M + M<sub>d</sub> for M",
        ),
        "r and v are of the body's origin, where the wrench (F, M) acts, in body axes; c is the centre of mass from "
        "there, J the inertia about the centre of mass. Inertial frame: z down. R is made orthogonal again after each "
        "step. F<sub>d</sub>, in inertial axes, and M<sub>d</sub>, in body axes, are disturbances; they and the drag "
        "act at the origin.",
        _SOURCE,
    ),
    "RigidBodyController": Theory(
        (
            "a = a<sub>d</sub> − K<sub>r</sub> e<sub>r</sub> − K<sub>v</sub> e<sub>v</sub>",
            "α = Q dΩ<sub>d</sub>/dt − Ω × Q Ω<sub>d</sub> − K<sub>R</sub> e<sub>R</sub> − K<sub>Ω</sub> e<sub>Ω</sub>,"
            "  Q = Rᵀ R<sub>d</sub>",
            "F = m (Rᵀ (a − g e<sub>3</sub>) + α × c + Ω × (Ω × c))",
            "M = J α + Ω × J Ω + c × F",
        ),
        "With true parameters ë<sub>r</sub> = −K<sub>r</sub> e<sub>r</sub> − K<sub>v</sub> ė<sub>r</sub> and "
        "ė<sub>Ω</sub> = −K<sub>R</sub> e<sub>R</sub> − K<sub>Ω</sub> e<sub>Ω</sub>.",
        "Siciliano et al. (2009), “Robotics”, section 8.5.2; errors of attitude: Lee et al. (2010).",
    ),
    "RigidBodyReference": Theory(
        (
            "q(t) = s (sin at − (a/b) sin bt) for each of x, y, z, roll, pitch and yaw, s being its amplitude",
            "R<sub>d</sub> = R<sub>z</sub>(yaw) R<sub>y</sub>(pitch) R<sub>x</sub>(roll), and its exact"
            " Ω<sub>d</sub> and dΩ<sub>d</sub>/dt",
        ),
        "a and b are multiples of omega that differ from coordinate to coordinate. The motion starts at rest and shows "
        "all ten parameters.",
        "Diebel (2006), “Representing attitude”, equations 67 and 74.",
    ),
}
"""Texts by the FMU's name."""
