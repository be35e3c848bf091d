"""A window that stays as it is while an episode lasts: for residuals that cost simulations. Knows nothing of those."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from .space import Vector
from .telemetry import Sample, chi2_limit

FALSE_ALARM: Final = 1e-4
"""Probability that samples count as not explained by the parameters that they came from."""


@dataclass(frozen=True)
class Stretch:
    """Consecutive samples; the first is where a simulation begins, those after it are what it is compared with."""

    samples: tuple[Sample, ...]
    """From old to new (n + 1,)."""
    origin: Any
    """What the judge gave for the first one."""

    @property
    def n_steps(self) -> int:
        """n."""
        return len(self.samples) - 1


class Judged(NamedTuple):
    """What became of a candidate."""

    residual: Vector
    """(D,) in standard deviations of the noise, channel by channel; not finite where it failed."""
    reason: str | None = None
    """Why it failed."""


class Judge(Protocol):
    """Compares candidates with samples, at a cost."""

    def hear(self, sample: Sample) -> None:
        """Take the newest sample."""
        ...

    def origin(self) -> Any:
        """What a simulation that begins at the newest sample will need."""
        ...

    def judge(self, thetas: Sequence[Vector], stretch: Stretch) -> list[Judged]:
        """Each candidate over the stretch; several at a time, where it can."""
        ...

    def believe(self, theta: Vector, stretch: Stretch) -> None:
        """From the stretch's beginning on, theta (d,) is taken for the plant's."""
        ...


class EpisodeWindow:
    """All candidates of an episode are judged on the same samples, once each; none is kept for the next episode.

    At a trigger the samples so far may be from before the parameters jumped. Those since an anchor, set every
    max_length samples, are taken where the parameters in force explain them (a chi-square test); else the window begins
    at the trigger, and the candidates wait until it is full.
    """

    is_rescoring_cheap = False

    def __init__(self, judge: Judge, max_length: int = 10, scale: Sequence[float] | None = None) -> None:
        """scale: (c,), the noise of each channel, for an estimator that wants residuals in physical units."""
        if max_length < 1:
            raise ValueError(f"max_length must be at least 1 sample, got {max_length}.")
        self._judge, self._max_length, self._scale = judge, max_length, scale
        self._recent: list[Sample] = []  # since the older of two anchors
        self._anchors: list[tuple[int, Any]] = []
        self._stretch: Stretch | None = None
        self._is_filling = False
        self._judged: dict[bytes, Judged] = {}
        self.n_model_calls = 0
        """Steps that were simulated of candidates, by `follow` left out."""

    @property
    def newest(self) -> Sample:
        """The newest sample. Raises IndexError where there is none."""
        return self._recent[-1]

    @property
    def is_ready(self) -> bool:
        """Whether an episode has its samples."""
        return self._stretch is not None

    @property
    def recent(self) -> Stretch:
        """The samples since the newer anchor; none before the first sample."""
        if not self._anchors:
            return Stretch((), None)
        first, origin = self._anchors[-1]
        return Stretch(tuple(self._recent[first:]), origin)

    def append(self, sample: Sample) -> None:
        """Take one sample more."""
        self._judge.hear(sample)
        self._recent.append(sample)
        if not self._anchors or len(self._recent) - 1 - self._anchors[-1][0] >= self._max_length:
            self._anchors.append((len(self._recent) - 1, self._judge.origin()))
            if len(self._anchors) > 2:
                first = self._anchors[1][0]
                del self._recent[:first]
                self._anchors = [(k - first, origin) for k, origin in self._anchors[1:]]
        if self._is_filling and len(self._recent) > self._max_length:
            self._is_filling, self._stretch = False, self._past()

    def begin(self, theta: Vector) -> str:
        """An episode begins with theta (d,) in force; returns on which samples."""
        self._judged.clear()
        past = self._past()
        if past.n_steps >= self._max_length:
            (found,) = self._judge.judge([theta], past)
            self.n_model_calls += past.n_steps
            if found.reason is None and is_explained(found.residual, FALSE_ALARM):
                self._judged[theta.tobytes()] = found
                self._stretch = past
                return f"the last {past.n_steps} samples, which the parameters in force explain"
        self._recent, self._anchors = self._recent[-1:], [(0, self._judge.origin())]
        self._is_filling = True
        return f"the next {self._max_length} samples"

    def end(self, theta: Vector) -> None:
        """The episode is over, with theta (d,) in force."""
        if self._stretch is not None:
            self._judge.believe(theta, self._stretch)
        self._stretch = None
        self._judged.clear()

    def residual(self, theta: Vector) -> Vector:
        """Residual (D,) of one candidate; not finite where it failed."""
        return self.residuals([theta])[0]

    def residuals(self, candidates: Iterable[Vector]) -> Sequence[Vector]:
        """The residual (D,) of each candidate, judged at the same time."""
        thetas = list(candidates)
        if self._stretch is None:
            raise RuntimeError("no candidate can be judged before the window is full.")
        new = [theta for key, theta in {t.tobytes(): t for t in thetas}.items() if key not in self._judged]
        self.n_model_calls += len(new) * self._stretch.n_steps
        for theta, judged in zip(new, self._judge.judge(new, self._stretch) if new else [], strict=True):
            self._judged[theta.tobytes()] = judged
        return [self._scaled(self._judged[theta.tobytes()].residual) for theta in thetas]

    def why_failed(self, theta: Vector) -> str | None:
        """Why a candidate of this episode failed."""
        found = self._judged.get(theta.tobytes())
        return found.reason if found else None

    def explain(self, theta: Vector, patient: bool = True) -> None:
        """The window does not change in an episode."""

    def keep(self, candidates: Iterable[Vector]) -> None:
        """Nothing outlives an episode."""

    def _past(self) -> Stretch:
        return Stretch(tuple(self._recent), self._anchors[0][1])

    def _scaled(self, residual: Vector) -> Vector:
        if self._scale is None or len(residual) % len(self._scale):
            return residual
        return (residual.reshape(len(self._scale), -1) * np.array(self._scale)[:, None]).reshape(-1)


def is_explained(residual: Vector, false_alarm: float) -> bool:
    """Whether a whitened residual (D,) passes the chi-square test."""
    return len(residual) == 0 or float(residual @ residual) <= chi2_limit(false_alarm, len(residual))
