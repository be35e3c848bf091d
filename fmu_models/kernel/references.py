"""Signals of time for references, with their derivatives."""

from math import cos, sin


def step(t: float, initial: float, final: float, step_time: float) -> float:
    """Return `initial` before `step_time` [s], `final` from then on."""
    return final if t >= step_time else initial


def sinusoid(t: float, amplitude: float, omega: float) -> tuple[float, float, float, float, float]:
    """Return amplitude sin(omega t) with its first four time derivatives;  t [s], omega [rad/s]."""
    s, c = amplitude * sin(omega * t), amplitude * cos(omega * t)
    return (s, omega * c, -(omega**2) * s, -(omega**3) * c, omega**4 * s)
