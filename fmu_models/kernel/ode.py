"""Fixed-step Runge-Kutta integration on tuples, and disturbances; standard library only."""

from collections.abc import Callable, Sequence
from math import ceil

StateVector = tuple[float, ...]


def rk4_step(f: Callable[[StateVector], StateVector], x: StateVector, h: float) -> StateVector:
    """Return the state after one classical fourth-order Runge-Kutta step of x_dot = f(x).

    The input is held over the step: close over it in `f`.
    x: (n,) state;  h: step [s];  returns (n,).
    Kutta (1901); Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), table II.1.2.
    """
    half = 0.5 * h
    k1 = f(x)
    k2 = f(tuple([a + half * b for a, b in zip(x, k1)]))
    k3 = f(tuple([a + half * b for a, b in zip(x, k2)]))
    k4 = f(tuple([a + h * b for a, b in zip(x, k3)]))
    w = h / 6.0
    return tuple([a + w * (b1 + 2.0 * (b2 + b3) + b4) for a, b1, b2, b3, b4 in zip(x, k1, k2, k3, k4)])


def integrate(f: Callable[[StateVector], StateVector], x: StateVector, duration: float, max_step: float) -> StateVector:
    """Return the state after `duration`, in the fewest equal Runge-Kutta steps of at most `max_step`.

    x: (n,) state;  duration, max_step: [s];  returns (n,).
    """
    n_steps = max(1, ceil(duration / max_step * (1.0 - 1e-9)))
    h = duration / n_steps
    for _ in range(n_steps):
        x = rk4_step(f, x, h)
    return x


def is_acting(disturbance: Sequence[float]) -> bool:
    """Return whether a disturbance is other than zero: numbers, or an array of them at many points."""
    return bool(disturbance.any()) if hasattr(disturbance, "any") else any(disturbance)
