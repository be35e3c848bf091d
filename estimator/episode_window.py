"""Window that stays the same during an episode, for residuals that need simulations, which it does not run itself."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from .samples import Sample
from .significance import chi2_limit, is_explained
from .space import Vector

_ALLOWANCE: Final = 0.01
"""Probability that a step's residuals exceed the allowance of the cumulative sum where nothing has changed."""
_LONGEST: Final = 4
"""Largest length of a window that has been extended, in lengths of a usual one."""


@dataclass(frozen=True)
class SampleSequence:
    """Consecutive samples; the first is where a simulation begins, those after it are what it is compared with."""

    samples: tuple[Sample, ...]
    """From old to new (n + 1,)."""
    origin: Any
    """Snapshot of the objective at the first sample."""
    is_measured: NDArray[np.bool_] | None = None
    """Which values that candidates are compared with were measured (n, c), those of the others being 0; None: all."""

    @property
    def n_steps(self) -> int:
        """Number n of steps."""
        return len(self.samples) - 1


class Evaluation(NamedTuple):
    """Result of evaluating a candidate."""

    residual: Vector
    """(D,) in standard deviations of the noise, channel by channel; not finite where it failed."""
    reason: str | None = None
    """Reason why it failed, or None."""
    squares: Vector | None = None
    """Sum of squared residuals of each step (n,), where residuals belong to steps."""


class Tracked(NamedTuple):
    """Residual of the parameters in force on the newest samples, in standard deviations; empty where unknown."""

    values: Vector
    """All, output by output; 0 where one was not measured."""
    measured: Vector
    """Those that were measured (D,)."""


class SequenceObjective(Protocol):
    """Objective that compares candidates with a sequence of samples, by simulations."""

    @property
    def is_of_outputs(self) -> bool:
        """True where residuals are of the outputs, output by output and step by step: 0 where one was not measured."""
        ...

    @property
    def is_ready(self) -> bool:
        """True where it can evaluate candidates already."""
        ...

    def add_sample(self, sample: Sample) -> None:
        """Take the newest sample."""
        ...

    def snapshot(self, is_needed: bool) -> Any:
        """Return what a simulation from the newest sample on needs; None where that is expensive and not needed."""
        ...

    def evaluate(self, thetas: Sequence[Vector], stretch: SampleSequence) -> list[Evaluation]:
        """Return the evaluation of each candidate over the stretch; several run in parallel where possible."""
        ...

    def track(self, theta: Vector, stretch: SampleSequence) -> Vector:
        """Return the residual (D,) of theta (d,) over a stretch that grows from call to call; empty where unknown."""
        ...

    def accept(self, theta: Vector, stretch: SampleSequence) -> None:
        """Take theta (d,) for the plant's parameters from the stretch's beginning on."""
        ...

    def revert(self, theta: Vector) -> None:
        """Take theta (d,), accepted before, for the plant's parameters since others were accepted."""
        ...

    def move_inputs(self, moved: Vector, stretch: SampleSequence) -> None:
        """Take inputs moved by (p,) for those that have acted from the stretch's beginning on."""
        ...


class EpisodeWindow:
    """Window on which all candidates of an episode are evaluated, once each; none is kept for the next episode.

    At a trigger some of the samples may be from before the parameters jumped. Those since an anchor, set every
    max_length samples, are taken where the parameters in force explain them (a chi-square test). Otherwise the window
    begins where these stopped explaining them (Page's cumulative sum) or, where that is not known, at the trigger,
    and the candidates wait until it is full. Where outputs are missing, that takes twice as many values as parameters.
    """

    is_rescoring_cheap = False

    def __init__(
        self, objective: SequenceObjective, max_length: int = 10, scale: Sequence[float] | None = None
    ) -> None:
        """scale: (c,), the noise of each channel, for an estimator with residuals in physical units."""
        if max_length < 1:
            raise ValueError(f"max_length must be at least 1 sample, got {max_length}.")
        self._objective, self._max_length = objective, max_length
        self._scale = None if scale is None else np.array(scale)
        self._recent: list[Sample] = []
        self._origins: list[Any] = []  # of these
        self._anchors: list[int] = []  # two of their places, the first being 0
        self._stretch: SampleSequence | None = None
        self._is_filling = False
        self._extended = 0  # number of steps to wait for after an episode that could not tell; 0 for a usual window
        self._n_needed = 0  # number of measured values
        self._n_measured = 0  # since the first of the recent samples
        self._judged: dict[bytes, Evaluation] = {}
        self.n_model_calls = 0
        """Number of samples at which parameters were evaluated."""
        self.weights: Vector | None = None
        """Factors (c,) of the residuals, where their true size is not that of the declared noise; or None."""

    @property
    def newest(self) -> Sample:
        """The newest sample. Raises IndexError where there is none."""
        return self._recent[-1]

    @property
    def is_ready(self) -> bool:
        """True where the episode has all its samples."""
        return self._stretch is not None

    def append(self, sample: Sample) -> None:
        """Add a sample."""
        self._objective.add_sample(sample)
        is_due = not self._anchors or len(self._recent) - self._anchors[-1] >= self._max_length
        is_anchor = is_due and (not self._anchors or _is_whole(sample))
        if is_anchor:
            self._anchors.append(len(self._recent))
        self._recent.append(sample)
        self._n_measured += _n_measured(sample) if len(self._recent) > 1 else 0
        self._origins.append(self._objective.snapshot(is_anchor))
        is_in_episode = self._is_filling or self._stretch is not None
        while len(self._anchors) > 2 and not is_in_episode:
            self._drop(self._anchors[1])
        self._freeze()

    def correct(self, newest: Sample) -> None:
        """Replace the newest sample, one of whose values has turned out to be wrong.

        Where candidates have been compared with it already, it is a residual of 0 for the others: all have as many.
        """
        if len(self._recent) > 1:
            self._n_measured += _n_measured(newest) - _n_measured(self._recent[-1])
        self._recent[-1] = newest
        if self._stretch is not None and self._stretch.n_steps + 1 == len(self._recent):
            self._stretch = replace(self._stretch, samples=tuple(self._recent))
            self._judged.clear()

    def begin(self, theta: Vector) -> str:
        """Begin an episode with theta (d,) in force; return on which samples, in words."""
        self._judged.clear()
        self._n_needed = 2 * len(theta)
        if self._extended and self._stretch is not None:
            self._extended = 0
            return f"the last {self._stretch.n_steps}, on fewer of which the episode before could not tell"
        self._is_filling = True
        past, first = self._stretch_from(0), len(self._recent) - 1
        if past.n_steps and self._objective.is_ready:
            (found,) = self._objective.evaluate([theta], past)
            self.n_model_calls += past.n_steps
            weighted = self._weighted(found.residual)
            is_long = found.reason is None and self._is_long(self._max_length)
            if is_long and is_explained(_measured(weighted, past)):
                self._judged[theta.tobytes()] = found
                self._stretch, self._is_filling = past, False
                return f"the last {past.n_steps}, which the parameters in force explain"
            squares = found.squares
            if squares is not None and self.weights is not None:
                squares = np.sum(weighted.reshape(len(self.weights), -1) ** 2, axis=0)
            change = None if squares is None else _last_explained(squares, _n_values(len(weighted), past))
            if change is not None and self._origins[change] is not None:
                first = change
        first = self._beginning(first)
        if self._origins[first] is None:
            self._origins[first] = self._objective.snapshot(True)
        self._drop(first)
        self._freeze()
        n_past = len(self._recent) - 1
        more = "" if past.is_measured is None else " or more, as some values are missing"
        text = f"the next {max(self._max_length - n_past, 0)}{more}"
        return f"the last {n_past}, which they do not explain, and {text}" if n_past else text

    def end(self, theta: Vector) -> None:
        """End the episode with theta (d,) in force."""
        if self._stretch is not None:
            self._objective.accept(theta, self._stretch)
        self._stretch, self._is_filling, self._extended = None, False, 0
        self._judged.clear()

    def forget(self) -> None:
        """Forget all samples before the newest: no later episode begins on them."""
        first = self._beginning(len(self._recent) - 1)
        if self._origins[first] is None:
            self._origins[first] = self._objective.snapshot(True)
        self._drop(first)

    def revert(self, theta: Vector) -> None:
        """Take earlier parameters theta (d,) for those of the plant since others were accepted."""
        self._objective.revert(theta)

    def move_inputs(self, moved: Vector) -> None:
        """Take inputs moved by (p,) for those that have acted since the present episode's first sample."""
        assert self._stretch is not None
        first, *others = self._recent
        self._recent = [first, *(_with_inputs(sample, moved) for sample in others)]
        self._stretch = replace(self._stretch, samples=tuple(self._recent[: self._stretch.n_steps + 1]))
        self._judged.clear()
        self._objective.move_inputs(moved, self._stretch)

    def extend(self) -> bool:
        """End the episode, and begin the next one on the same samples and as many again, when they are there.

        Return False, and do nothing, where the window would be longer than four usual ones.
        """
        stretch = self._stretch
        if stretch is None or stretch.samples[0] is not self._recent[0]:
            return False
        n_steps = 2 * stretch.n_steps
        if n_steps > _LONGEST * self._max_length:
            return False
        self._stretch, self._is_filling, self._extended = None, True, n_steps
        self._judged.clear()
        self._freeze()
        return True

    @property
    def is_extended(self) -> bool:
        """True from the end of an episode that could not tell to the beginning of the next, on more samples."""
        return self._extended > 0

    def residual(self, theta: Vector) -> Vector:
        """Return the residual (D,) of one candidate; not finite where it failed."""
        return self.residuals([theta])[0]

    def residuals(self, candidates: Iterable[Vector]) -> Sequence[Vector]:
        """Return the residual (D,) of each candidate; those not known yet are evaluated together."""
        thetas = list(candidates)
        if self._stretch is None:
            raise RuntimeError("no candidate can be judged before the window is full.")
        new = [theta for key, theta in {t.tobytes(): t for t in thetas}.items() if key not in self._judged]
        self.n_model_calls += len(new) * self._stretch.n_steps
        for theta, judged in zip(new, self._objective.evaluate(new, self._stretch) if new else [], strict=True):
            self._judged[theta.tobytes()] = judged
        return [_measured(self._scaled(self._judged[t.tobytes()].residual), self._stretch) for t in thetas]

    @property
    def sequence(self) -> SampleSequence | None:
        """Samples of the present episode; None before they are complete."""
        return self._stretch

    def whitened(self, theta: Vector) -> Vector:
        """Return the residual (D,) of one candidate in standard deviations, whatever the estimator gets."""
        self.residuals([theta])
        assert self._stretch is not None
        return _measured(self._weighted(self._judged[theta.tobytes()].residual), self._stretch)

    def rows(self, theta: Vector, n_channels: int) -> Vector:
        """Return the residuals (n, c) of one candidate in standard deviations; NaN where an output was not measured."""
        self.residuals([theta])
        assert self._stretch is not None
        rows = self._weighted(self._judged[theta.tobytes()].residual).reshape(n_channels, -1).T
        is_measured = self._stretch.is_measured
        return rows if is_measured is None else np.where(is_measured, rows, np.nan)

    def with_inputs(self, theta: Vector, moved: Vector) -> Vector:
        """Return the residual (D,) of theta (d,) with moved (p,) added to every input, in standard deviations."""
        assert self._stretch is not None
        first, *others = self._stretch.samples
        aside = [_with_inputs(sample, moved) for sample in others]
        (found,) = self._objective.evaluate([theta], replace(self._stretch, samples=(first, *aside)))
        self.n_model_calls += self._stretch.n_steps
        return _measured(self._weighted(found.residual), self._stretch)

    def largest_inputs(self) -> Vector:
        """Return the largest absolute value of each input (p,) in the present episode."""
        assert self._stretch is not None
        return np.abs(np.array([s.u for s in self._stretch.samples[1:]])).max(axis=0)

    def why_failed(self, theta: Vector) -> str | None:
        """Return the reason why a candidate of this episode failed, or None."""
        found = self._judged.get(theta.tobytes())
        return found.reason if found else None

    def track(self, theta: Vector) -> "Tracked":
        """Return the residual of the parameters in force on the samples since the anchor before, or empty.

        It costs one simulated step a sample: see SequenceObjective.track.
        """
        stretch = self._stretch_from(self._tracked_from)
        if not stretch.n_steps:
            return Tracked(np.empty(0), np.empty(0))
        self.n_model_calls += 1
        values = self._weighted(self._objective.track(theta, stretch))
        return Tracked(values, _measured(values, stretch))

    @property
    def n_tracked(self) -> int:
        """Number of samples that `track` is about."""
        return len(self._recent) - 1 - self._tracked_from

    @property
    def _tracked_from(self) -> int:
        """Place of the newest anchor that has samples after it, if there is one."""
        is_newest = len(self._anchors) > 1 and self._anchors[-1] == len(self._recent) - 1
        return self._anchors[-2 if is_newest else -1]

    def innovation(self, theta: Vector, sample: Sample) -> Vector:
        """Return the residual (D,) for a trigger, on the samples that `track` is about, this one the newest."""
        return self.track(theta).measured

    def explain(self, theta: Vector, patient: bool = True) -> None:
        """Do nothing: the window does not change in an episode."""

    def keep(self, candidates: Iterable[Vector]) -> None:
        """Do nothing: no residual outlives an episode."""

    def _freeze(self) -> None:
        is_long = self._is_filling and self._is_long(self._extended or self._max_length)
        if is_long and self._objective.is_ready:
            self._is_filling, self._stretch = False, self._stretch_from(0)

    def _is_long(self, n_steps: int) -> bool:
        """Return whether there are n_steps and, where outputs are missing, twice as many values as parameters."""
        n_needed = min(self._n_needed, n_steps * len(self._recent[-1].y)) if self._objective.is_of_outputs else 0
        return len(self._recent) > n_steps and self._n_measured >= n_needed

    def _beginning(self, first: int) -> int:
        """Return the place nearest to one, if possible after it, of a sample that a simulation can begin at."""
        newest = len(self._recent) - 1
        places = [*range(first, newest + 1), *range(first - 1, -1, -1)]
        can_begin = (k for k in places if k == newest or self._origins[k] is not None)
        return next((k for k in can_begin if _is_whole(self._recent[k])), first)

    def _stretch_from(self, first: int) -> SampleSequence:
        samples, is_measured = tuple(self._recent[first:]), None
        if self._objective.is_of_outputs and len(samples) > 1:
            is_measured = ~np.isnan(np.array([s.y for s in samples[1:]], dtype=float))
        is_whole = is_measured is None or is_measured.all()
        return SampleSequence(samples, self._origins[first], None if is_whole else is_measured)

    def _drop(self, first: int) -> None:
        """Forget the samples before that place, which becomes an anchor."""
        del self._recent[:first], self._origins[:first]
        self._n_measured = sum(map(_n_measured, self._recent[1:]))
        self._anchors = [0, *(k - first for k in self._anchors if k > first)]

    def _scaled(self, residual: Vector) -> Vector:
        """Return the residual as the estimator gets it."""
        weighted = self._weighted(residual)
        if self._scale is None or len(residual) % len(self._scale):
            return weighted
        return (weighted.reshape(len(self._scale), -1) * self._scale[:, None]).reshape(-1)

    def _weighted(self, residual: Vector) -> Vector:
        if self.weights is None or len(residual) % len(self.weights):
            return residual
        return (residual.reshape(len(self.weights), -1) * self.weights[:, None]).reshape(-1)


def _is_whole(sample: Sample) -> bool:
    """Return whether no state is missing, so that a simulation can begin there."""
    return all(map(isfinite, sample.x))


def _n_measured(sample: Sample) -> int:
    """Return the number of outputs that were measured."""
    return sum(y == y for y in sample.y)  # a NaN differs from itself


def _measured(residual: Vector, stretch: SampleSequence) -> Vector:
    """Return the values of a residual (D,) that were measured; all where it has failed."""
    if stretch.is_measured is None or len(residual) != stretch.is_measured.size:
        return residual
    return residual[stretch.is_measured.T.reshape(-1)]


def _n_values(n_residuals: int, stretch: SampleSequence) -> Vector:
    """Return the number of values of each step (n,)."""
    if stretch.is_measured is None:
        return np.full(stretch.n_steps, n_residuals // stretch.n_steps)
    return np.count_nonzero(stretch.is_measured, axis=1)


def _with_inputs(sample: Sample, moved: Vector) -> Sample:
    return replace(sample, u=tuple((np.array(sample.u) + moved).tolist()))


def _last_explained(squares: Vector, n_values: Vector) -> int | None:
    """Return the number of steps before those not explained, from each step's sum of n_values squared residuals (n,).

    The last step at which the cumulative sum of excesses over an allowance was zero: Page (1954). None where that is
    before the first step, or where no step comes after it.
    """
    excess, last = 0.0, 0
    for k, (square, n) in enumerate(zip(squares.tolist(), n_values.tolist(), strict=True), 1):
        excess = max(0.0, excess + square - (chi2_limit(_ALLOWANCE, n) if n else 0.0))
        last = k if excess == 0.0 else last
    return last if 0 < last < len(squares) else None
