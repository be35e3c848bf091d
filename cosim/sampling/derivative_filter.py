"""Derivatives filtered from sampled states, where a plant has none to measure, with matching states and inputs.

A plant obeys xdot = f(x, u; theta). A linear filter of samples whose coefficients sum to zero is a weighted mean of
their slopes, and the mean slope of a macro step is the mean of xdot over it:

    xdot_bar = sum_i d_i x_(k-i) = sum_i W_i (x_(k-i) - x_(k-i-1)) / h = integral of w(s) xdot(s) ds,    sum_i W_i = 1

with w = W_i / h, constant over a step. So whatever the filter, x and u are averaged with the same W: u, constant over
a step, exactly, and x by the trapezoidal rule. Then xdot_bar = f(x_bar, u_bar) for an f that is linear in x and u,
however long the filter is and however the input jumps. For any other f, f(x_bar, u_bar) is off by about 1/2 f'' times
the variance of (x, u) under w, so the sample has its macro steps as nodes, over which the mean of f is taken by the
midpoint rule. What is left is of the order of h^2: f' h^2/12 times the second derivative of x. All three belong to the
time t_k - delay.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import Final

import numpy as np
import scipy  # its parts, 0.3 s, are loaded when they are used

from estimator import Sample, Vector
from estimator.samples import Node

from ..scenarios.schema.sampling import Sampling, SavitzkyGolay, StateVariable

_CORRELATED: Final = 0.05  # what two samples' noise may share
_MOST_NODES: Final = 50


@dataclass(frozen=True)
class Kernel:
    """Weights of the macro steps in the mean of a filter."""

    weights: Vector
    """W (n,), the newest step first; sums to one."""
    macro_step: float
    """h [s]."""

    @cached_property
    def difference(self) -> Vector:
        """Coefficients d (n + 1,) [1/s]: the derivative is the sum of d times the samples, the newest first."""
        return (np.append(self.weights, 0.0) - np.append(0.0, self.weights)) / self.macro_step

    @cached_property
    def mean(self) -> Vector:
        """Coefficients (n + 1,) of the samples in their mean, by the trapezoidal rule."""
        return (np.append(self.weights, 0.0) + np.append(0.0, self.weights)) / 2.0

    @property
    def delay(self) -> float:
        """Delay of the mean behind the newest sample [s]."""
        return float(self.weights @ self._age)

    @property
    def variance(self) -> float:
        """Second moment of the weights about the mean [s^2]; zero for a Savitzky-Golay filter of third order."""
        return float(self.weights @ ((self._age - self.delay) ** 2 + self.macro_step**2 / 12.0))

    @property
    def noise_gain(self) -> float:
        """Noise gain |d|_2 [1/s]: standard deviation of the derivative's noise over that of the white sample noise."""
        return float(np.linalg.norm(self.difference))

    @property
    def independent_after(self) -> int:
        """Number of points after which the correlation of the derivative's noise is at most 5 %."""
        shared = np.abs(np.correlate(self.difference, self.difference, "full")[len(self.weights) :])
        return int(np.flatnonzero(shared > _CORRELATED * shared[0])[-1]) + 1

    @property
    def _age(self) -> Vector:
        """Age of the middle of each step (n,) [s]."""
        return self.macro_step * np.arange(0.5, len(self.weights))


def savitzky_golay(points: int, order: int, macro_step: float) -> Kernel:
    """Return the kernel of the derivative, at the middle of the points, of the polynomial that fits them best.

    Savitzky and Golay (1964); scipy.signal.savgol_coeffs.
    """
    from scipy.signal import savgol_coeffs  # 0.3 s, and most scenarios have no filter

    newest_first = savgol_coeffs(points, order, deriv=1, delta=macro_step, use="conv")
    return Kernel(macro_step * np.cumsum(newest_first)[:-1], macro_step)


def state_variable(settings: StateVariable, macro_step: float) -> Kernel:
    """Return the kernel of the filter F(s) = (cutoff / (s + cutoff))^order, cutoff in rad/s.

    Young and Jakeman (1980); Garnier and Wang (2008), section 1.5. It is exact for a signal held over each
    step: F's step response is that of a gamma distribution. The response is cut where 0.1 % is left.
    """
    n = settings.n_steps(macro_step)
    weights = np.diff(scipy.special.gammainc(settings.order, settings.cutoff * macro_step * np.arange(n + 1)))
    return Kernel(weights / weights.sum(), macro_step)


def kernel_of(settings: SavitzkyGolay | StateVariable, macro_step: float) -> Kernel:
    """Return the kernel of a scenario's filter."""
    match settings:
        case SavitzkyGolay():
            return savitzky_golay(settings.points, settings.order, macro_step)
        case StateVariable():
            return state_variable(settings, macro_step)


def points_apart(settings: SavitzkyGolay | StateVariable, kernel: Kernel) -> int:
    """Return the number of points between samples with derivatives, by default so many that they share no noise."""
    return settings.every or kernel.independent_after


def derivative_noise(sampling: Sampling, macro_step: float) -> tuple[float, ...]:
    """Return the standard deviation of each derivative's noise (c,): the scenario's, else the filter's |d|_2 sigma."""
    gain = kernel_of(sampling.filter, macro_step).noise_gain if sampling.filter else 0.0
    return tuple(d.noise or gain * sampling.states[d.of or name].noise for name, d in sampling.derivatives.items())


class DerivativeFilter:
    """Filter from measurements at every point to samples with derivatives, each delayed by the filter.

    Samples are spaced so that two share next to no noise: the samples of a window are treated as independent.
    """

    def __init__(self, settings: SavitzkyGolay | StateVariable, macro_step: float, channels: Sequence[int]) -> None:
        """channels (c,): places in x of the states whose derivatives are wanted."""
        self.kernel = kernel_of(settings, macro_step)
        self._channels = list(channels)
        self._every = points_apart(settings, self.kernel)
        self._points: deque[Sample] = deque(maxlen=len(self.kernel.weights) + 1)
        self._wait = 0

    def __call__(self, measured: Sample) -> Sample | None:
        """Return the sample that this point completes, or None; a gap or a missing value restarts the filter."""
        h = self.kernel.macro_step
        if not all(map(isfinite, (*measured.x, *measured.u))):
            self._points.clear()
            return None
        if self._points and abs(measured.t - self._points[0].t - h) > 1e-6 * h:
            self._points.clear()
        self._points.appendleft(measured)
        self._wait = max(self._wait - 1, 0)
        if self._wait or len(self._points) <= len(self.kernel.weights):
            return None
        self._wait = self._every
        return averaged(self.kernel, [*self._points], self._channels)


def averaged(kernel: Kernel, points: Sequence[Sample], channels: list[int]) -> Sample:
    """Return the sample that measurements (n + 1,) make, the newest first; channels (c,): places in x.

    A node is a macro step, of a long filter the mean of as many steps as leave no more than 50 nodes.
    """
    x = np.array([p.x for p in points])
    u = np.array([p.u for p in points[:-1]])  # the oldest's is of the step before
    begins = np.arange(0, len(u), -(-len(u) // _MOST_NODES))
    weights = np.add.reduceat(kernel.weights, begins)
    lengths = np.diff(np.append(begins, len(u)))[:, None]
    middle, held = (np.add.reduceat(of_steps, begins) / lengths for of_steps in ((x[:-1] + x[1:]) / 2.0, u))
    change = np.add.reduceat(x[:-1] - x[1:], begins)
    of_nodes = middle - weights @ middle, held - weights @ held, change
    nodes = zip(weights.tolist(), *(map(_tuple, table) for table in of_nodes), strict=True)
    xdot = kernel.difference @ x[:, channels]
    return Sample(
        points[0].t - kernel.delay,
        _tuple(kernel.mean @ x),
        _tuple(kernel.weights @ u),
        _tuple(xdot),
        nodes=tuple([Node(*node) for node in nodes]),
    )


def _tuple(values: Vector) -> tuple[float, ...]:
    return tuple(values.tolist())
