"""Equations of the FMUs of magnetic levitation, as HTML for their documentation."""

from collections.abc import Mapping

from ..kernel.theory import Theory

_SOURCE = (
    "Wong (1986), “Design of a magnetic levitation control system: an undergraduate project”, IEEE Trans. Education "
    "E-29, with z<sub>0</sub> added to the gap."
)

THEORY: Mapping[str, Theory] = {
    "MagneticLevitation": Theory(
        (
            "ż = v",
            "v̇ = g − (k/m) (i/(z + z<sub>0</sub>))² + (F<sub>d</sub> − k<sub>d</sub> v)/m",
        ),
        "z is the gap between magnet and ball and grows downwards; z<sub>0</sub> is the length of air that iron and "
        "non-magnetic layers are worth. F<sub>d</sub> is a disturbance. The ball falls, or jumps to the magnet, unless "
        "the current is controlled; stops are not modelled.",
        _SOURCE,
    ),
    "MagneticLevitationController": Theory(
        (
            "i = (z + z<sub>0</sub>) √((m/k) max(g − v̇<sub>ref</sub> − K<sub>p</sub> e − K<sub>d</sub> ė, 0)),"
            "  0 ≤ i ≤ i<sub>max</sub>",
            "e = z<sub>ref</sub> − z,  ė = v<sub>ref</sub> − v",
        ),
        "With true parameters, and off the limits, the error obeys ë + K<sub>d</sub> ė + K<sub>p</sub> e = 0. The "
        "magnet can only pull. m and z<sub>0</sub> are what the controller believes in.",
        _SOURCE,
    ),
    "MagneticLevitationReference": Theory(
        (
            "z<sub>ref</sub> = mean + amplitude sin(omega t)",
            "v<sub>ref</sub> and v̇<sub>ref</sub>: its exact time derivatives",
        ),
        "The gap has to move for m and z<sub>0</sub> to show apart.",
        "",
    ),
}
"""Texts by the FMU's name."""
