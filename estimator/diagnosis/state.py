"""State of a diagnosis of sampled derivatives: all that changes from sample to sample."""

from collections import Counter
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from math import isnan
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..effects.friction import Friction
from ..effects.input_lag import InputHistory
from ..effects.step_means import StepMeans
from ..hypotheses import NEVER, Fit
from ..samples import Sample
from ..space import Vector
from .drift_rival import DriftRival
from .residual_scale import TOO_SMALL, ResidualScale, coloured_noise
from .resting import RestingResiduals
from .settings import FORGOTTEN, KINDS
from .verdict import Verdict
from .wandering import Findings, InForce, ParameterPath

WINDOW: Final = 20
"""Largest number of samples on which hypotheses are compared."""
_EVERY: Final = 5
"""Number of samples of which one is kept for long."""
_MOST_SINCE: Final = 60
"""Largest number of them."""
_MOST_QUIET: Final = 300
"""Largest number of quiet samples that are kept."""


@dataclass(frozen=True)
class FrictionTrial:
    """Parameters and disturbance that friction, which explains the samples, was found with; it must prove itself."""

    theta: Vector
    """Parameters (d,), which had followed the samples, or those that had lasted."""
    offset: Vector
    """Disturbance (c,) that was known with them."""
    n_samples: int
    """Number of the sample up to which the friction must explain all: as many again as it was found on."""


@dataclass
class DiagnosisState:
    """State of a diagnosis, one object that all its parts share: copied for a snapshot, restored in place."""

    samples: list[Sample]
    """The newest samples, from old to new; during a suspicion the older ones are thinned out."""
    scale: ResidualScale
    """True size of the residuals, which replaces the declared noise."""
    offset: Vector
    """Known disturbance (c,), in standard deviations of the declared noise."""
    rests_until: NDArray[np.intp]
    """Number of the sample (c,) at which a channel's rest ends."""
    is_resting: NDArray[np.bool_]
    """Whether a channel (c,) rests."""
    inputs: InputHistory = field(default_factory=InputHistory)
    """Inputs of the newest samples, and their known lag."""
    friction: Friction = field(default_factory=Friction)
    """Known friction that the model lacks."""
    trial: FrictionTrial | None = None
    """What the known friction was taken for, until it has proven itself; None else."""
    undisturbed: Vector | None = None
    """Parameters (d,) in force when that disturbance became known; None before one did."""
    n_failures: int = 0
    """Number of failed searches, one soon after the other."""
    is_noise_known: bool = False
    """True since the declared noise has explained many quiet samples, or parameters have where coloured noise does not.

    From the start for a filter's samples, which are too far apart for coloured noise to be seen in them.
    """
    n_doubts: int = 0
    """Number of times that samples have turned out to be doubtful, since many were quiet in a row."""
    largest_unexplained: Vector | None = None
    """Largest residuals (c,) of the last failed search; None before one, and since samples were suspicious again."""
    n_quiet: int = 0
    """Number of quiet samples in a row, those of a rest not among them; after 200 it begins again."""
    quiet: list[Sample] = field(default_factory=list[Sample])
    """The newest quiet samples in a row with all their values, while no channel rests and residuals are as declared.

    Replaced, never changed.
    """
    findings: Findings = field(default_factory=Findings)
    """Parameters that searches have found although a disturbance explains the samples as well."""
    suspected_at: int = 0
    """Number of the last sample that was suspicious."""
    path: ParameterPath = field(default_factory=ParameterPath)
    """Path of the parameters in force since the samples last were quiet for long."""
    in_force: InForce = field(default_factory=InForce)
    """Parameters in force at the newest samples."""
    lasting: Vector | None = None
    """Parameters (d,) that the samples have not contradicted for long; None before the first onset."""
    lasting_at: int = 0
    """Number of the sample at which these were contradicted."""
    lasting_until: int = 0
    """Number of the sample at which they were last in force."""
    since_lasting: list[Sample] = field(default_factory=list[Sample])
    """Samples since these were in force, every fifth one."""
    counts: Counter[str] = field(default_factory=Counter[str])
    """Number of events of each kind."""
    named: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    """The newest disturbances with their times [s] and sizes; replaced, never changed."""
    rested: list[Vector] = field(default_factory=list[Vector])
    """Residuals (c,) at the parameters in force since the first channel rests, with a known disturbance in them."""
    resting: RestingResiduals = field(default_factory=RestingResiduals)
    """Their sizes since the last rest began."""
    n_samples: int = 0
    """Number of samples so far."""
    n_since: int = 0
    """Number of the samples kept since the onset of the suspicion, 20 at most; 0 while quiet."""
    n_calm: int = 0
    """Number of samples before the onset that the reference has explained."""
    reference: Vector | None = None
    """Parameters (d,) in force at the onset, or accepted since."""
    has_moved: bool = False
    """True where other parameters have been in force since the onset."""
    is_disturbed: bool = False
    """True since a changing disturbance was named, until no sample was suspicious for twenty."""
    is_disproved: bool = False
    """True where samples after proven parameters were explained by none, by far, since it last was quiet."""
    has_hidden_change: bool = False
    """True where many quiet samples together have contradicted the parameters in force since the last suspicion."""
    changed: Vector | None = None
    """Place (d,) of the parameters that explained the samples last."""
    verdict: Verdict = field(default_factory=Verdict)
    """Whether changed parameters explain the newest samples of the suspicion."""
    restless_since: int = 0
    """Number of the first sample of a suspicion that began after some quiet."""
    drift_rival: DriftRival | None = None
    """What a walking disturbance explains of the samples since parameters have been followed; None before."""
    next_lag: int = 0
    """Number of the sample from which on a lag is sought again, none having explained the samples."""
    next_effect: int = 0
    """Number of the sample from which on an effect that the model lacks is sought again in all since `lasting_at`."""
    next_jump: int = 0
    """Number of the sample from which on constant parameters are sought again, none having explained the samples."""

    @classmethod
    def at_start(cls, n_channels: int, may_lag: Sequence[int] | None, means: StepMeans) -> "DiagnosisState":
        """Return the state before the first sample.

        may_lag: places of inputs that may be late, None for all; means: that samples have of the inputs.
        """
        none = np.zeros(n_channels)
        known = InputHistory(None if may_lag is None else tuple(may_lag), means=means)
        scale, rests_until, is_resting = ResidualScale(n_channels), none.astype(np.intp), none.astype(bool)
        return cls([], scale, none, rests_until, is_resting, known, is_noise_known=bool(means))

    def coloured_noise(self, rows: Vector) -> Fit:
        """Return the fit of coloured noise to residuals (n, c), `NEVER` since the noise is known."""
        return NEVER if self.is_noise_known else coloured_noise(rows)

    def reference_or(self, held: Vector) -> Vector:
        """Return the reference (d,); the parameters in force, held (d,), where there is none."""
        return held if self.reference is None else self.reference

    def has_lasted(self, held: Vector) -> bool:
        """Return whether the parameters in force, held (d,), are those that lasted."""
        return self.lasting is not None and np.array_equal(held, self.lasting)

    def end_suspicion(self) -> None:
        """End the suspicion; what new parameters were judged by is over, too."""
        self.n_since, self.verdict = 0, self.verdict.refuted()

    def begin_suspicion(self, held: Vector, z: Vector) -> None:
        """Begin a suspicion of the parameters in force, held (d,), whose place is z (d,)."""
        self.reference, self.changed, self.has_moved = held, None, False
        self.has_hidden_change, self.quiet = False, []
        self.verdict, self.largest_unexplained = self.verdict.refuted(), None
        if self.lasting is None or self.n_samples >= self.suspected_at + FORGOTTEN:
            self.begin_lasting(held)
        self.n_calm = self.n_samples - self.suspected_at - 1
        if self.n_samples >= self.suspected_at + WINDOW:
            self.restless_since, self.next_lag = self.n_samples, 0
            self.path, self.is_disproved, self.is_disturbed = self.path.begin(z), False, False

    def begin_lasting(self, theta: Vector) -> None:
        """Take parameters (d,) for those that lasted, from the newest sample on."""
        self.lasting, self.lasting_at, self.since_lasting = theta, self.n_samples, []
        self.lasting_until = self.n_samples
        self.next_effect = 0

    def count_suspicious(self, held: Vector) -> None:
        """Count the newest sample among those since the onset; held (d,): in force."""
        self.n_since, self.n_quiet = min(self.n_since + 1, len(self.samples)), 0
        self.suspected_at = self.n_samples
        self.has_moved |= self.reference is None or not np.array_equal(held, self.reference)

    def count_quiet(self) -> None:
        """Count a quiet sample, the newest; after many a failed search is forgotten, and so are doubtful samples."""
        newest = self.samples[-1]
        rests = bool(np.count_nonzero(self.is_resting))
        is_usual = not (rests or np.count_nonzero(self.scale.values > 1.0) or any(map(isnan, newest.xdot)))
        self.quiet = [*self.quiet, newest][-_MOST_QUIET:] if is_usual else []
        self.n_quiet += not rests
        if self.n_quiet >= FORGOTTEN:
            self.n_quiet, self.n_failures, self.n_doubts = 0, max(self.n_failures - 1, 0), 0

    def keep(self, sample: Sample) -> None:
        """Keep a sample; of those since an onset, where there are many, every second of the older ones.

        Of those after the parameters that lasted every fifth one is kept for long.
        """
        self.samples.append(sample)
        if len(self.samples) > WINDOW:
            if self.n_since < WINDOW:
                del self.samples[0]
            else:
                del self.samples[1 : WINDOW // 2 : 2]
                self.n_since = len(self.samples) - 1
        if self.n_samples % _EVERY == 0:
            self.since_lasting = [*self.since_lasting, sample][-_MOST_SINCE:]

    @property
    def every_since_lasting(self) -> list[Sample]:
        """Samples that are kept of those since the parameters that lasted were contradicted, from old to new."""
        long = self.since_lasting
        newest = [s for s in self.samples if long and s.t > long[0].t]
        return [*(s for s in long if not newest or s.t < newest[0].t), *newest]

    @property
    def since_last_in_force(self) -> list[Sample]:
        """Those of the samples that are kept for long since the parameters that lasted were last in force."""
        n = (self.n_samples - self.lasting_until) // _EVERY
        return self.since_lasting[-n:] if n else []

    @property
    def newest_hundred(self) -> list[Sample]:
        """The newest samples, and of those before them every fifth one: as many again, from old to new."""
        begin = self.samples[0].t
        return [*[s for s in self.since_lasting[-2 * WINDOW :] if s.t < begin][-WINDOW:], *self.samples]

    def rest(self, channels: NDArray[np.bool_], n: int) -> None:
        """Let the channels (c,) rest for n samples."""
        if len(self.rested) > 1:
            self._admit(self.rested, channels)
        self.rests_until = np.where(channels, self.n_samples + n, self.rests_until)
        self.is_resting = self.is_resting | channels
        self.rested.clear()
        self.resting = RestingResiduals()

    def wake(self) -> bool:
        """End the rests that are over; return whether there was one."""
        if not np.count_nonzero(self.is_resting):
            return False
        over = self.is_resting & (self.n_samples >= self.rests_until)
        if not over.any():
            return False
        self.is_resting = self.is_resting & ~over
        self.n_since = 0
        rested = np.array(self.rested).reshape(-1, len(over))
        self.scale.wake(np.where(over, rested[np.isfinite(rested).all(axis=1)], 0.0))
        return True

    def wake_early(self) -> None:
        """End all rests, as something has happened: what residuals were until then is what the model lacks."""
        self._admit(self.rested[: self.resting.n_usual - self.resting.n_samples], self.is_resting)
        self.n_since = 0
        self.wake_all()

    def wake_calm(self) -> None:
        """End all rests, as the parameters in force have long explained the samples again."""
        self._end_offset(_finite(self.rested[-self.resting.n_calm :]))
        self.n_since = 0
        self.wake_all()

    def wake_to_change(self) -> None:
        """End all rests, as changed parameters explain the newest samples without a known disturbance."""
        self.offset, self.n_since = np.zeros_like(self.offset), 0
        self.wake_all()

    def wake_all(self) -> None:
        """End all rests, as what the channels rested for is known; what follows is not of them."""
        self.rests_until, self.is_resting = np.zeros_like(self.rests_until), np.zeros_like(self.is_resting)
        self.rested.clear()
        self.resting = RestingResiduals()

    def _admit(self, residuals: Sequence[Vector], channels: NDArray[np.bool_]) -> None:
        """Take residuals (n, c) of these channels (c,) for what the model lacks.

        A known disturbance is forgotten where they are smaller without it.
        """
        rows = _finite(residuals)
        self._end_offset(np.where(channels, rows, self.offset))
        self.scale.admit(np.where(channels, rows - self.offset, 0.0))

    def _end_offset(self, rows: Vector) -> None:
        """Forget the known disturbance of channels whose residuals (n, c) are smaller without it."""
        is_over = np.sum(rows**2, axis=0) < np.sum((rows - self.offset) ** 2, axis=0)
        self.offset = np.where(is_over, 0.0, self.offset)

    def admit_usual(self, rows: Vector) -> bool:
        """Take residuals (n, c) of parameters that explain other samples for their usual size.

        Where they are larger than a declared noise may be too small they are something else. Return whether that size
        has changed.
        """
        declared = rows * self.scale.effective + self.offset
        is_small = np.sqrt(np.mean(declared**2, axis=0)) < TOO_SMALL
        return self.scale.admit(np.where(is_small, declared, 0.0))

    def copy(self) -> "DiagnosisState":
        """Return an independent copy; arrays are replaced, never changed."""
        other = copy(self)
        other.samples, other.scale, other.inputs = [*self.samples], self.scale.copy(), self.inputs.copy()
        other.rested, other.counts = [*self.rested], Counter(self.counts)
        return other

    def restore(self, other: "DiagnosisState") -> None:
        """Go back to a copy, which is used up: no part has to be given another state. Inputs since then stay known."""
        other.inputs.take_since(self.inputs)
        vars(self).update(vars(other))

    def summary(self, names: Sequence[str], sigma: Vector, inputs: Sequence[str]) -> dict[str, Any]:
        """Return what is known of each channel, and the number of events of each kind, as JSON values.

        names, sigma (c,): of the channels, and their declared noise; inputs (p,): names.
        """
        known = zip(channel_summary(names, self.scale), self.offset * sigma, self.is_resting, strict=True)
        channels = {name: row | {"disturbance": float(d), "is_resting": bool(r)} for (name, row), d, r in known}
        lag = {"input_lag": self.inputs.describe(self.inputs.lag, inputs)}
        return {"channels": channels, "disturbances": self.named} | lag | {kind: self.counts[kind] for kind in KINDS}


def channel_summary(names: Sequence[str], scale: ResidualScale) -> list[tuple[str, dict[str, Any]]]:
    """Return, for each channel, its name and what is known of its residuals' true size, as JSON values.

    noise_ratio: what the model leaves unexplained in quiet, in standard deviations of the declared noise, or None.
    """
    observed = [None] * len(names) if scale.observed is None else scale.observed.tolist()
    return [
        (name, {"noise_ratio": ratio, "scale": float(s), "correlation": float(rho)})
        for name, ratio, s, rho in zip(names, observed, scale.values, scale.correlations, strict=True)
    ]


def _finite(residuals: Sequence[Vector]) -> Vector:
    """Return those residuals (n, c) in which no channel lacks a value."""
    rows = np.array(residuals)
    return rows[np.isfinite(rows).all(axis=1)]
