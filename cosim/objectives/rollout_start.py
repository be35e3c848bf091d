"""Whitening of roll-outs that begin in measured states, whose noise is in every residual after."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
import scipy  # its parts, 0.3 s, are loaded when they are used

from estimator import Evaluation, Sample, SampleSequence, Vector

from .rollout import RolloutObjective


class NoisyStartObjective:
    """A RolloutObjective whose residuals are white although the states that roll-outs begin in are noisy.

    To first order r = r0 + G e, e the states' noise in standard deviations, so that cov r = I + G G', which its
    Cholesky factor whitens step by step: the innovations that an extended Kalman filter without process noise has.
    Kailath (1968), "An innovations approach to least-squares estimation", part I. G is from roll-outs begun a standard
    deviation aside. Where roll-outs begin otherwise it changes nothing. Leaving the context ends the processes.
    """

    is_of_outputs = True

    def __init__(self, opened: Callable[[], RolloutObjective], noise: Sequence[float]) -> None:
        """opened: makes an objective; noise (n,): standard deviation of each state, in its unit, 0 for an exact one."""
        self._noise, self._stack = np.array(noise), ExitStack()
        n_noisy = np.count_nonzero(self._noise)
        self._objective, *self._aside = (self._stack.enter_context(opened()) for _ in range(n_noisy + 1))
        self._factor: tuple[Sample, int, Any, Vector] | None = None  # of which first sample, how many steps, newest y

    def __enter__(self) -> "NoisyStartObjective":
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def is_ready(self) -> bool:
        """True where it is decided how roll-outs begin."""
        return self._objective.is_ready

    @property
    def why_lost(self) -> str | None:
        """Reason why the roll-out with the present parameters failed when last tried; None: it did not."""
        return self._objective.why_lost

    def describe(self) -> str:
        """Return the description of the inner objective."""
        return self._objective.describe()

    def add_sample(self, sample: Sample) -> None:
        """Add the newest sample. Raises ScenarioError where no way to begin a roll-out is left."""
        self._objective.add_sample(sample)

    def snapshot(self, is_needed: bool) -> Any:
        """Return the inner objective's snapshot."""
        return self._objective.snapshot(is_needed)

    def accept(self, theta: Vector, stretch: SampleSequence) -> None:
        """Pass the accepted parameters on to the inner objective."""
        self._objective.accept(theta, stretch)

    def revert(self, theta: Vector) -> None:
        """Pass the parameters on to the inner objective."""
        self._objective.revert(theta)

    def move_inputs(self, moved: Vector, stretch: SampleSequence) -> None:
        """Pass the moved inputs on to the inner objectives, whose roll-outs are followed."""
        for objective in (self._objective, *self._aside):
            objective.move_inputs(moved, stretch)

    def evaluate(self, thetas: Sequence[Vector], stretch: SampleSequence) -> list[Evaluation]:
        """Evaluate the candidates over the stretch; all are whitened by the factor of the first that does not fail.

        It stays for later candidates, and for the same stretch with other inputs.
        """
        found = self._objective.evaluate(thetas, stretch)
        if self._objective.way != "measured":
            return found
        factor = self._factor_of(stretch)
        if factor is None:
            known = next((i for i, judged in enumerate(found) if judged.reason is None), None)
            if known is None:
                return found
            moved = [self._objective.evaluate([thetas[known]], aside)[0].residual for aside in self._moved(stretch)]
            factor = _factor(found[known].residual, moved, stretch.n_steps)
            self._factor = stretch.samples[0], stretch.n_steps, stretch.samples[-1].y, factor
        return [j if j.reason else _whitened(factor, j.residual, stretch.n_steps) for j in found]

    def _factor_of(self, stretch: SampleSequence) -> Vector | None:
        """Return the factor found before for a stretch of the same start and length, whatever its inputs; or None."""
        if self._factor is None:
            return None
        first, n_steps, newest, factor = self._factor
        is_same = first is stretch.samples[0] and n_steps == stretch.n_steps and newest is stretch.samples[-1].y
        return factor if is_same else None

    def track(self, theta: Vector, stretch: SampleSequence) -> Vector:
        """Return the residual of theta over a stretch that grows; each state's roll-out steps on too."""
        residual = self._objective.track(theta, stretch)
        if self._objective.way != "measured" or not len(residual):
            return residual
        for objective in self._aside:
            objective.way = self._objective.way  # proved once, by the first
        moved = [j.track(theta, s) for j, s in zip(self._aside, self._moved(stretch), strict=True)]
        return _whitened(_factor(residual, moved, stretch.n_steps), residual, stretch.n_steps).residual

    def _moved(self, stretch: SampleSequence) -> list[SampleSequence]:
        """Return the stretch begun a standard deviation aside, state by state."""
        first, *others = stretch.samples
        moved = np.array(first.x) + np.diag(self._noise)[self._noise > 0.0]
        return [replace(stretch, samples=(replace(first, x=tuple(x)), *others)) for x in moved.tolist()]


def _factor(residual: Vector, moved: Sequence[Vector], n_steps: int) -> Vector:
    """Return the lower Cholesky factor (D, D) of the covariance, from old to new; failed roll-outs are left out."""
    g = [_by_time(r - residual, n_steps) for r in moved if len(r) == len(residual) and np.all(np.isfinite(r))]
    aside = np.array(g).reshape(len(g), len(residual))
    # By QR of (G; I): in I + G'G the identity is lost where G is large, as of a roll-out that diverges.
    upper = np.asarray(np.linalg.qr(np.vstack([aside, np.eye(len(residual))]), mode="r"), dtype=np.float64)
    return (upper * np.sign(upper.diagonal())[:, None]).T


def _whitened(factor: Vector, residual: Vector, n_steps: int) -> Evaluation:
    white: Vector = scipy.linalg.solve_triangular(factor, _by_time(residual, n_steps), lower=True)
    steps = white.reshape(n_steps, -1)
    return Evaluation(steps.T.reshape(-1), None, np.sum(steps**2, axis=1))


def _by_time(residual: Vector, n_steps: int) -> Vector:
    """Reorder a residual from channel by channel to step by step."""
    return residual.reshape(-1, n_steps).T.reshape(-1)
