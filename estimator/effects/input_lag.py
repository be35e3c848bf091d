"""Inputs of the newest samples, what arrives of them at the plant, and the lag that explains samples."""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from math import inf, isfinite
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..hypotheses import NEVER, Fit, plain_fit
from ..samples import Sample
from ..space import Vector
from .input_limits import InputLimits
from .lag import Lag, arriving, step_means
from .lag_search import ASIDE, LEAST, RowsWith, TriedLag, best_lag, with_fitted_start
from .step_means import StepMeans

_KEPT: Final = 120
"""Number of samples whose inputs are kept: what came before has faded to less than a hundredth of the longest lag."""
_LITTLE: Final = 0.05
"""Share of their range by which inputs may have passed a limit before that was noticed."""
_FIRST: Final = 3
"""Number of the first samples whose inputs are kept, which what arrived before may explain."""
Inputs = Mapping[float, tuple[float, ...]]
"""Inputs (p,) that arrive at the plant, by the time [s]."""


@dataclass(frozen=True)
class FoundLag:
    """Lag that explains samples best."""

    lag: Lag
    arriving: Inputs
    """Inputs that arrive at the plant then at the end of each step, from some time on."""
    fit: Fit


NO_LAG: Final = FoundLag(Lag(), {}, NEVER)


@dataclass
class InputHistory:
    """Newest inputs, and what arrives at the plant where a lag is known.

    Inputs are those of samples; where these have means over several steps, of the steps (`take_input`), since it is
    there that a lag acts.
    """

    may_lag: tuple[int, ...] | None = None
    """Places of the inputs that actuators may delay, all by the same; None for all. The others are measured."""
    lag: Lag = field(default_factory=Lag)
    """Known lag."""
    means: StepMeans = field(default_factory=StepMeans)
    """Means that samples have of the steps' inputs."""
    _times: list[float] = field(default_factory=list[float])
    _inputs: list[tuple[float, ...]] = field(default_factory=list[tuple[float, ...]])
    _arriving: dict[float, tuple[float, ...]] = field(default_factory=dict[float, tuple[float, ...]])
    _sampled: list[float] = field(default_factory=list[float])  # times of samples that have means
    _in_samples: dict[float, tuple[float, ...]] = field(default_factory=dict[float, tuple[float, ...]])

    def copy(self) -> "InputHistory":
        """Return an independent copy."""
        other = copy(self)
        other._times, other._inputs, other._arriving = [*self._times], [*self._inputs], dict(self._arriving)
        other._sampled, other._in_samples = [*self._sampled], dict(self._in_samples)
        return other

    def take(self, sample: Sample) -> None:
        """Take the input of a sample; where that is a mean, those of the steps are known already."""
        if self.means:
            self._take_time(sample.t)
        else:
            self.take_input(sample.t, sample.u)

    def take_input(self, t: float, u: tuple[float, ...]) -> None:
        """Take the input (p,) held up to t [s], where no value is missing.

        One that is no newer than those before is known already.
        """
        if (self._times and t <= self._times[-1]) or not all(map(isfinite, u)):
            return
        self._times.append(t)
        self._inputs.append(u)
        if self.lag and len(self._times) > 1:
            self._arriving[t] = self._arrives()
        if len(self._times) >= _KEPT * self.means.every + len(self.means.weights):
            self._forget(1)

    def take_since(self, later: "InputHistory") -> None:
        """Take the inputs of a later history that are newer than those here."""
        for t, u in zip(later._times, later._inputs, strict=True):
            self.take_input(t, u)
        for t in later._sampled:
            self._take_time(t)

    def _take_time(self, t: float) -> None:
        """Take the time of a sample that has means [s]."""
        if not self._sampled or t > self._sampled[-1]:
            self._sampled.append(t)
            self._in_samples.update(self._of_samples([t]))

    def _of_samples(self, times: Sequence[float]) -> Inputs:
        """Return what arrives, by the known lag, in the means of samples at these times [s]; none without a lag."""
        kept = [t for t in times if t >= self.begin] if self._arriving else []
        if not kept:
            return {}
        places = self._places_of(kept)
        first = max(int(places[0]) - self.means.n_before, 0)
        steps, inputs = self._times[first:], np.array(self._inputs[first:])
        made = np.array([self._arriving[t] for t in steps])[None]
        means = self._means([self.lag], np.array(steps), inputs, made, places - first)
        return dict(zip(kept, map(tuple, means[0].tolist()), strict=True))

    def _places_of(self, times: Sequence[float]) -> NDArray[np.intp]:
        """Return the places of the newest steps of samples at these times [s] among the inputs that are kept."""
        return np.searchsorted(np.array(self._times) - self.means.lead, times, side="right") - 1

    def _means(
        self, lags: Sequence[Lag], times: Vector, inputs: Vector, made: Vector, places: NDArray[np.intp]
    ) -> Vector:
        """Return what samples have (k, ..., n, p) of what arrives (k, ..., N, p).

        places (n,): of the samples' newest steps.
        """
        if not self.means:
            return made[..., places, :]
        late, arrives = self._places(inputs), made.copy()
        arrives[..., late] = step_means(lags, times, inputs[:, late], made[..., late])
        return self.means.of(arrives, places)

    def _arrives(self) -> tuple[float, ...]:
        """Return what arrives with the newest input, by the known lag."""
        n = self.lag.n_late
        start = self._inputs[-1 - n] if 0 < n < len(self._inputs) else self._arriving[self._times[-2]]
        newest = slice(-1, None) if n else slice(-2, None)
        made = self._made([self.lag], *map(np.array, (self._times[newest], self._inputs[newest], start)))
        return tuple(made[0, -1].tolist())

    def _made(self, lags: Sequence[Lag], times: Vector, inputs: Vector, start: Vector) -> Vector:
        """Return what arrives of inputs (n, p) with each of k lags (k, n, p): the measured ones as they are."""
        places = self._places(inputs)
        made = np.repeat(inputs[None], len(lags), axis=0)
        made[..., places] = arriving(lags, times, inputs[:, places], start[places])
        return made

    def _places(self, inputs: Vector) -> list[int]:
        return [*range(inputs.shape[1])] if self.may_lag is None else [*self.may_lag]

    def _forget(self, n: int) -> None:
        for t in self._times[:n]:
            self._arriving.pop(t, None)
        del self._times[:n], self._inputs[:n]
        while self._sampled and self._sampled[0] < self.begin:
            self._in_samples.pop(self._sampled.pop(0), None)

    @property
    def arriving(self) -> Inputs:
        """Inputs that samples have of what arrives at the plant, by their time; none where those that were sent do."""
        return self._in_samples if self.means else self._arriving

    @property
    def begin(self) -> float:
        """Time from which on the inputs of samples are kept [s]; infinite without any."""
        n = len(self.means.weights)
        return self._times[n - 1] - self.means.lead if len(self._times) >= n else inf

    def describe(self, lag: Lag, names: Sequence[str]) -> dict[str, Any]:
        """Return a lag as JSON values, in seconds; names (p,): of the inputs."""
        step = float(np.median(np.diff(self._times))) if lag.n_late else 0.0
        rates = [rate if isfinite(rate) else None for rate in lag.rates]
        places = range(len(names)) if self.may_lag is None else self.may_lag
        limits = {
            names[j]: [limit if isfinite(limit) else None for limit in of]
            for j, of in zip(places, lag.limits, strict=False)
            if any(map(isfinite, of))
        }
        return {"time_constant": lag.time_constant, "dead_time": lag.n_late * step, "rates": rates, "limits": limits}

    def adopt(self, found: FoundLag) -> None:
        """Take a lag for known."""
        self.lag, self._arriving = found.lag, dict(found.arriving)
        if self._arriving:
            self._forget(self._times.index(next(iter(self._arriving))))
        self._in_samples = dict(self._of_samples(self._sampled))

    def search(self, rows_with: RowsWith, times: Sequence[float], *, is_late: bool = True) -> FoundLag:
        """Return the lag that explains best: none, one of all inputs that are kept, or of those since the first sample.

        rows_with: residuals of n samples with what arrives at the plant; times (n,): theirs [s], all of them kept.
        is_late: false to seek limits of the inputs only.
        """
        places = self._places_of(times)
        none = FoundLag(Lag(), {}, plain_fit(rows_with(self.means.of(np.array(self._inputs)[None], places))[0], 0))
        if self.may_lag == () or len(self._times) < LEAST or not np.any(np.diff(self._inputs, axis=0)):
            return none
        found = [none]
        if is_late:
            found.append(self._best(rows_with, places, none.fit, 0, is_free=False))
            if not found[-1].fit.is_explained:
                first = max(int(places[0]) - self.means.n_before, 0)
                found.append(self._best(rows_with, places, none.fit, first, is_free=True))
        if not self.lag or self.lag.limits:
            found.append(self._limited(rows_with, places))
        return min(found, key=lambda one: one.fit.score)

    def late(self, rows_with: RowsWith, times: Sequence[float]) -> FoundLag:
        """Return the lag of all inputs that are kept that explains best; `NO_LAG` where there is none.

        rows_with, times: as of `search`.
        """
        if self.may_lag == () or not np.any(np.diff(self._inputs, axis=0)) or times[0] < self.begin:
            return NO_LAG
        places = self._places_of(times)
        none = plain_fit(rows_with(self.means.of(np.array(self._inputs)[None], places))[0], 0)
        return self._best(rows_with, places, none, 0, is_free=False)

    def late_from_start(self, rows_with: RowsWith, times: Sequence[float]) -> FoundLag:
        """Return the lag that explains best the first samples whose inputs are kept; `NO_LAG` for others.

        What arrived before them may be fitted, too; `NO_LAG` where a lag is known, or none shows. rows_with, times: as
        of `search`.
        """
        may_be_late = self.may_lag != () and not self.lag and bool(np.any(np.diff(self._inputs, axis=0)))
        if not may_be_late or not times or times[0] < self.begin:
            return NO_LAG
        places = self._places_of(times)
        if places[0] >= _FIRST * self.means.every + self.means.n_before:
            return NO_LAG
        none = plain_fit(rows_with(self.means.of(np.array(self._inputs)[None], places))[0], 0)
        found = (self._best(rows_with, places, none, 0, is_free=is_free) for is_free in (False, True))
        return min(found, key=lambda one: one.fit.score)

    def stuck_or_free(self, rows_with: RowsWith, times: Sequence[float]) -> Fit:
        """Return the fit to samples of one input, or all of them, being stuck since the first of them.

        Where that is known, of what is sent arriving again. `NEVER` where nothing can be told.
        rows_with, times: as of `search`.
        """
        is_known = bool(self.lag.limits)
        if self.may_lag == () or (self.lag and not is_known) or not times or times[0] < self.begin:
            return NEVER
        places = self._places_of(times)
        if is_known:
            return plain_fit(rows_with(self.means.of(np.array(self._inputs)[None], places))[0], 0)
        found = self._limits(rows_with, places).stuck()
        return NEVER if found is None else found.fit

    def were_within(self, lag: Lag, t: float) -> bool:
        """Return whether the inputs before time t [s] were within limits, but for a little; False without any."""
        before = np.array(self._inputs[: max(int(self._places_of([t])[0]) - self.means.n_before, 0)])
        if not len(before):
            return False
        lower, upper = np.transpose(lag.limits)
        sent = before[:, self._places(before)]
        little = _LITTLE * np.ptp(sent, axis=0)
        return bool(np.all((sent >= lower - little) & (sent <= upper + little)))

    def were_slower(self, lag: Lag, t: float) -> bool:
        """Return whether the inputs before time t [s] moved within limited rates; False without two of them."""
        n = max(int(self._places_of([t])[0]) - self.means.n_before, 0)
        if n < 2:
            return False
        before = np.array(self._inputs[:n])
        moves = np.abs(np.diff(before[:, self._places(before)], axis=0))
        return bool(np.all(moves <= np.diff(self._times[:n])[:, None] * np.array(lag.rates)))

    def _limits(self, rows_with: RowsWith, places: NDArray[np.intp]) -> InputLimits:
        first = max(int(places[0]) - self.means.n_before, 0)
        inputs = np.array(self._inputs[first : int(places[-1]) + 1])
        return InputLimits(rows_with, inputs, self._places(inputs), lambda made: self.means.of(made, places - first))

    def _limited(self, rows_with: RowsWith, places: NDArray[np.intp]) -> FoundLag:
        """Return the limits of the inputs that explain samples best, from the first of them on; places (n,): theirs."""
        limits = self._limits(rows_with, places)
        found = limits.best()
        if found is None:
            return NO_LAG
        first, lag = max(int(places[0]) - self.means.n_before, 0), limits.lag(found)
        times, inputs = np.array(self._times[first:]), np.array(self._inputs[first:])
        made = self._made([lag], times, inputs, np.zeros(inputs.shape[1]))
        return self._found(TriedLag(lag, made[0], found.fit), first)

    def _best(self, rows_with: RowsWith, places: NDArray[np.intp], none: Fit, first: int, *, is_free: bool) -> FoundLag:
        """Return the best lag of the inputs from the first one on; is_free: what arrives then is fitted, too.

        places (n,): of the samples' inputs among those that are kept; none: fit without a lag.
        """
        if len(self._times) - first < LEAST:
            return NO_LAG
        times, inputs = np.array(self._times[first:]), np.array(self._inputs[first:])
        start = np.array(self._arriving.get(self._times[first], self._inputs[first]))
        seen, may_lag = places - first, self._places(inputs)
        aside = np.diag(ASIDE * np.maximum(np.abs(inputs).max(axis=0), 1e-6))[may_lag] if is_free else None

        def fits(lags: Sequence[Lag]) -> list[TriedLag]:
            def of_samples(made: Vector) -> Vector:
                return self._means(lags, times, inputs, made, seen)

            made = self._made(lags, times, inputs, start)
            rows = rows_with(of_samples(made))
            if aside is not None:
                fading = np.array([lag.fading(times) for lag in lags])
                made = with_fitted_start(made, fading[:, None, :, None] * aside[:, None], rows, of_samples, rows_with)
                rows = rows_with(of_samples(made))
            tried = zip(lags, made, rows, strict=True)
            n_start = is_free * len(may_lag)
            return [TriedLag(lag, arrives, plain_fit(left, lag.n_values + n_start)) for lag, arrives, left in tried]

        best = best_lag(fits, times, inputs[:, may_lag], none, is_free=is_free, every=self.means.every)
        return self._found(best, first)

    def _found(self, best: TriedLag | None, first: int) -> FoundLag:
        """Return a lag that was tried on the inputs from the first one on, as what is found."""
        if best is None:
            return NO_LAG
        return FoundLag(best.lag, dict(zip(self._times[first:], map(tuple, best.made.tolist()), strict=True)), best.fit)
