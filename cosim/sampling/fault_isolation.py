"""Isolation of a fault: whether a state's sensor is wrong, or its derivative's, where the two contradict each other.

A wrong derivative spoils one residual, and the others are left to estimate from. A wrong state spoils every residual
that depends on it, and other parameters seem to explain them. So the two are compared as hypotheses: an error of the
state's sensor must explain the residuals of all channels, and the state's own motion, as well as they were explained
before, and far better than an error of the derivative's sensor, or none (structured residuals: Blanke et al., Diagnosis
and Fault-Tolerant Control, chapter 6; generalised likelihood ratio: Willsky and Jones 1976).
"""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import exp
from typing import Final, NamedTuple

import numpy as np
import scipy

from estimator import Sample, Vector

from .sensor_checks import SUMMED

_DECIDED: Final = (5, 10, 20, 40)
"""Numbers of samples since a pair began to be inconsistent after which it is decided; until then neither is trusted."""
_BETTER: Final = 1.5
"""Least multiple by which an error of the state's sensor must make the mean squared residual smaller."""
_MARGIN: Final = 7.0
"""Least logarithm of the likelihood ratio, the noise being unknown."""
_AS_BEFORE: Final = 2.0
"""Multiple of the mean squared residual before the fault up to which an error explains the samples."""
_FORGIVEN: Final = 5 * SUMMED
"""Number of samples that no error must explain better for a state's sensor to be good again."""
_JUMP: Final = 6.0
"""Size of a motion that the derivative does not show, in standard deviations, with which a fault begins."""
_STEP: Final = 1e-6
"""Relative step of the differences."""
_MOST: Final = 60
"""Largest number of errors of a sensor that are tried."""


@dataclass(frozen=True)
class Pair:
    """A state and its derivative."""

    channel: int | None
    """Place among the sampled derivatives; None where it is not sampled, but modelled without any parameter."""
    place: int
    """Place among the states."""
    noise: tuple[float, float]
    """Standard deviations of the derivative and of the state."""


@dataclass(frozen=True)
class ResidualModel:
    """Model with which samples are compared."""

    residual: Callable[[Vector, Sample], Vector]
    """Whitened residual (c,) of one sample."""
    slope: Callable[[Vector, Sequence[float], Sequence[float]], Sequence[float]]
    """Modelled derivatives (n,) at theta (d,), x (n,), u (p,)."""
    h: float
    """Macro step [s]."""


class FaultIsolation:
    """Isolation over the newest samples; a state's sensor that is found to be faulty is so until no error is better."""

    def __init__(self, pairs: tuple[Pair, ...], model: ResidualModel) -> None:
        self._pairs, self._model = pairs, model
        self._recent: deque[Sample] = deque(maxlen=6 * SUMMED)
        self._n_inconsistent = [0] * len(pairs)
        self._faults: dict[int, _Fault] = {}  # of the states, by pair

    def step(self, sample: Sample, theta: Vector, inconsistent: Iterable[int]) -> frozenset[int]:
        """Take a sample and the pairs that are inconsistent; return the faulty states. theta (d,): in force.

        A pair stays suspect until it is decided for the last time.
        """
        if self._recent and abs(sample.t - self._recent[-1].t - self._model.h) > 0.5 * self._model.h:
            self._recent.clear()
        self._recent.append(sample)
        now = {*inconsistent}
        if not (now or self._faults or any(self._n_inconsistent)):
            return frozenset()
        for i, (pair, n) in enumerate(zip(self._pairs, self._n_inconsistent, strict=True)):
            goes_on = i in now or 0 < n < _DECIDED[-1]
            self._n_inconsistent[i] = n = n + 1 if goes_on else 0
            if n in _DECIDED and i not in self._faults and (fault := self._begun(pair, theta, n)):
                self._faults[i] = fault
        for i, fault in [*self._faults.items()]:
            self._faults[i] = fault = self._gone_on(fault, self._pairs[i], theta)
            if fault.n_unseen > _FORGIVEN:
                del self._faults[i]
        return self.states

    @property
    def states(self) -> frozenset[int]:
        """Places of the states whose sensors are faulty."""
        return frozenset(self._pairs[i].place for i in self._faults)

    @property
    def is_undecided(self) -> bool:
        """True for the first samples of an inconsistent pair: neither its state nor its derivative is trusted."""
        return any(0 < n < _DECIDED[0] for n in self._n_inconsistent)

    def _begun(self, pair: Pair, theta: Vector, n: int) -> "_Fault | None":
        """Return the fault of the state's sensor, if it is that, n samples after the pair began to be inconsistent.

        It has begun where the state has jumped, if it has, else before.
        """
        recent = tuple(self._recent)
        if len(recent) <= _DECIDED[0]:  # after a gap
            return None
        stretch = _Stretch(recent[-SUMMED - n - 1 :], theta, pair, self._model)
        unshown, _ = stretch.unshown(recent)  # of all, as most of these are older than the fault
        known = unshown[np.isfinite(unshown)]
        stretch = replace(stretch, usual=1.4826 * float(np.median(np.abs(known))) if len(known) else 0.0)
        motion = np.abs(stretch.motion(stretch.samples))
        onset, as_before = int(np.argmax(motion)), 1.0
        if motion[onset] > _JUMP:
            stretch = replace(stretch, samples=stretch.samples[onset:], has_jump=True)
            before = replace(stretch, samples=recent[: 1 - len(stretch.samples)], has_jump=False)
            if len(before.samples) > _DECIDED[0]:
                as_before = before.unexplained
        if len(stretch.samples) <= _DECIDED[0]:
            return None
        return _Fault(stretch.error_of_state.p, stretch.usual) if stretch.is_of_state(as_before) else None

    def _gone_on(self, fault: "_Fault", pair: Pair, theta: Vector) -> "_Fault":
        """Return the fault after one more sample: now and then, whether an error still explains more than none."""
        fault = replace(fault, n_unseen=fault.n_unseen + 1)
        if fault.n_unseen % SUMMED or len(self._recent) <= _DECIDED[0]:
            return fault
        newest = tuple(self._recent)[-SUMMED - 1 :]
        stretch = _Stretch(newest, theta, pair, self._model, usual=fault.usual, begin=fault.error)
        error = stretch.error_of_state
        return _Fault(error.p, fault.usual) if error.squares * stretch.ratio < stretch.unexplained else fault


@dataclass(frozen=True)
class _Fault:
    """Error of a state's sensor, offset and gain (2,), what was usual before, and for how many samples it is unseen."""

    error: Vector
    usual: float
    n_unseen: int = 0


class _Error(NamedTuple):
    """Offset and gain of a sensor (2,), and the mean squared residual with it."""

    p: Vector
    squares: float


@dataclass(frozen=True)
class _Stretch:
    """Successive samples in which a sensor may be faulty, and how well errors of it explain them.

    Each is the least mean squared residual of all channels but in the first sample, and of the pair's motions.
    """

    samples: tuple[Sample, ...]
    theta: Vector
    pair: Pair
    model: ResidualModel
    has_jump: bool = False
    """True where the first sample is the last before the fault, whose onset shows in the motion to the second."""
    usual: float = 0.0
    """What the derivative usually does not show of a motion, as a standard deviation: of a coarse sensor."""
    begin: Vector | None = None
    """Error of the state's sensor (2,) with which the search begins; None where that is none, or the jump."""

    def is_of_state(self, before: float) -> bool:
        """Return whether the fault is the state's sensor's; before: mean squared residual before the fault."""
        state = self.error_of_state.squares
        if state > _AS_BEFORE * before or state * self.ratio >= self.unexplained:
            return False
        return state * self.ratio < self.error_of_derivative.squares

    @property
    def ratio(self) -> float:
        """Multiple by which one must be better than another."""
        return max(_BETTER, exp(2.0 * _MARGIN / (len(self.samples) * (len(self.samples[-1].xdot) + 1))))

    @cached_property
    def unexplained(self) -> float:
        """Without any error; a jump of the state may then be a collision, which no derivative shows."""
        return _mean_square(self._rows(self.samples)[self.has_jump :])

    @cached_property
    def error_of_state(self) -> _Error:
        """With an offset and a gain of the state's sensor, which explain a jump, too."""
        place = self.pair.place
        x = np.array([s.x[place] for s in self.samples])

        def rows(p: Vector) -> Vector:
            right = x - p[0] - p[1] * x
            if self.has_jump:
                right[0] = x[0]
            pairs = zip(self.samples, right.tolist(), strict=True)
            return self._rows([replace(s, x=_with(s.x, place, value)) for s, value in pairs])

        begin = np.zeros(2) if self.begin is None else self.begin
        if self.has_jump:
            begin = np.array([self.unshown(self.samples[:2])[0][0], 0.0])
        return _least(rows, begin, float(np.abs(x).max()))

    @cached_property
    def error_of_derivative(self) -> _Error:
        """With an offset and a gain of the derivative's sensor; infinite where it is not sampled."""
        channel = self.pair.channel
        if channel is None:
            return _Error(np.zeros(2), np.inf)
        xdot = np.array([s.xdot[channel] for s in self.samples])

        def rows(p: Vector) -> Vector:
            right = xdot - p[0] - p[1] * xdot
            pairs = zip(self.samples, right.tolist(), strict=True)
            return self._rows([replace(s, xdot=_with(s.xdot, channel, value)) for s, value in pairs])

        return _least(rows, np.zeros(2), float(np.abs(xdot).max()))

    def motion(self, samples: Sequence[Sample]) -> Vector:
        """Return what the derivative does not show of each motion (n - 1,), in standard deviations; 0 if not known."""
        unshown, std = self.unshown(samples)
        return np.where(np.isfinite(unshown), unshown / std, 0.0)

    def _rows(self, samples: Sequence[Sample]) -> Vector:
        """Return the motions, and then the whitened residuals of all samples but the first; 0 where one is missing."""
        residuals = np.array([self.model.residual(self.theta, s) for s in samples[1:]])
        residuals[np.isnan([s.xdot for s in samples[1:]])] = 0.0
        return np.concatenate([self.motion(samples), residuals.ravel()])

    def unshown(self, samples: Sequence[Sample]) -> tuple[Vector, Vector]:
        """Return what the derivative does not show of each motion (n - 1,), and its standard deviation (n - 1,).

        By the trapezoidal rule as the model has it: each step begins with the state of the sample before, and the input
        that is held over it. The rule's own error counts as half of its correction.
        """
        place, h, (noise, state_noise) = self.pair.place, self.model.h, self.pair.noise
        x = np.array([s.x[place] for s in samples])
        slope = np.array([self.model.slope(self.theta, s.x, s.u)[place] for s in samples[1:]])
        drift = slope - [self.model.slope(self.theta, a.x, b.u)[place] for a, b in pairwise(samples)]
        channel = self.pair.channel
        xdot = slope if channel is None else np.array([s.xdot[channel] for s in samples[1:]])
        std = np.sqrt((h * noise) ** 2 + 2.0 * state_noise**2 + (0.25 * h * drift) ** 2)
        return np.diff(x) - h * (xdot - 0.5 * drift), np.hypot(std, self.usual) + np.finfo(float).eps * np.abs(x).max()


def _least(rows: Callable[[Vector], Vector], begin: Vector, size: float) -> _Error:
    """Return the offset and gain with the least mean square of the rows, sought from `begin` on; size: of an offset."""
    if not np.isfinite(rows(begin)).all():
        return _Error(begin, np.inf)
    try:
        found = scipy.optimize.least_squares(
            rows, begin, method="lm", x_scale=(size or 1.0, 1.0), diff_step=_STEP, max_nfev=_MOST
        )
    except ValueError:  # the model has no value on the way
        return _Error(begin, np.inf)
    return _Error(found.x, _mean_square(found.fun))


def _mean_square(rows: Vector) -> float:
    """Return the mean square, 1 at least, which noise explains; infinite where it is no number."""
    value = float(np.mean(np.square(rows)))
    return max(value, 1.0) if value == value else np.inf


def _with(values: tuple[float, ...], place: int, value: float) -> tuple[float, ...]:
    return (*values[:place], value, *values[place + 1 :])
