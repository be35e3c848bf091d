"""Diagnosis for objectives that judge whole sequences of samples: simulations, and functions of the user's.

The lumped disturbance is a constant added to each of the plant's inputs; its effect is found by simulating with inputs
moved aside. Otherwise as `diagnosis`.
"""

from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any, Final

import numpy as np

from ..contract import Estimate, scaled_estimate
from ..differences import forward_differences
from ..episode_window import EpisodeWindow
from ..events import Event
from ..hypotheses import MARGIN, NEVER, ChangedParameters, Fit, Weighing, changed_parameters, plain_fit
from ..identifiability import IDENTIFIABLE_BELOW, information
from ..objective import DIFFERENCE_STEP
from ..samples import Sample
from ..space import ParameterSpace, Vector
from ..triggers import Trigger
from .disturbed_inputs import DisturbedInputs, disturbed_inputs
from .episode_rest import EpisodeRest
from .episode_state import EpisodeState, Unexplained
from .evidence import Evidence
from .residual_scale import (
    LARGER,
    LARGEST,
    MUCH_LARGER,
    NOISY,
    TOO_SMALL,
    ResidualScale,
    is_rough,
    larger_noise,
    spread_of,
)
from .settings import (
    BETTER,
    FORGOTTEN,
    KINDS,
    MOST_NAMED,
    PASSED,
    PATIENCE,
    QUIET,
    DiagnosisSettings,
    Judgement,
    is_at_unseen_bound,
)
from .state import WINDOW, channel_summary

_LITTLE: Final = 0.1
"""Share of the squares left beside a disturbance that parameters may leave for a noise that is correlated."""
_AGAIN: Final = 2
"""Number of failed searches, one soon after the other, from which on what has passed may be noise."""
_MORE: Final = "parameters and a disturbance explained fewer samples equally well"
"""Reason of an episode on a longer window."""


class EpisodeDiagnosis:
    """Diagnosis on an `EpisodeWindow`."""

    def __init__(
        self,
        window: EpisodeWindow,
        outputs: tuple[str, ...],
        inputs: tuple[str, ...],
        settings: DiagnosisSettings,
        space: ParameterSpace,
        driven: Collection[str] | None = None,
    ) -> None:
        """outputs: names of the channels; one for a function of the user's; inputs: names of the plant's.

        driven: those of the inputs that disturbances are added to; others may do the same as they; by default all.
        """
        self._driven = [i for i, name in enumerate(inputs) if driven is None or name in driven]
        self._window, self._outputs, self._inputs = window, outputs, inputs
        self._settings, self.space = settings, space
        self.evidence = Evidence()
        self._state = EpisodeState(ResidualScale(len(outputs)), np.zeros(len(inputs)))
        self._rest = EpisodeRest(window, outputs, settings, self._state, self.evidence)
        self._known: tuple[object, bytes, DisturbedInputs] | None = None
        self._newest: Vector = np.empty(0)
        self._verdict: Judgement = "refuted"
        self._is_certain = False
        self._of_rivals: tuple[object, Fit] = (None, NEVER)  # the fit of the rival on a sequence
        self._is_undoing = False  # the last failed search goes back for the rival
        self._judged: object = None  # the sequence that the verdict is about
        self._n_judged = 0  # number of its values
        self._searched: object = None  # the sequence on which other parameters than the estimator's were tried
        self._found: Estimate | None = None  # those, where they explain it and are warranted

    def summary(self) -> dict[str, Any]:
        """Return what is known of each output and input, and the number of events of each kind, as JSON values."""
        state = self._state
        channels = {n: row | {"is_resting": self._rest.is_on} for n, row in channel_summary(self._outputs, state.scale)}
        inputs = dict(zip(self._inputs, state.inputs.tolist(), strict=True))
        counts = {kind: state.counts[kind] for kind in KINDS}
        return {"channels": channels, "inputs": inputs, "disturbances": state.named} | counts

    @property
    def n_calm(self) -> int:
        """Number of newest samples that the parameters in force explain."""
        return self._state.n_calm

    @property
    def n_values(self) -> int:
        """Number of values that parameters were judged by last."""
        return self._n_judged

    def corrected(self, sample: Sample) -> Sample:
        """Return the sample with the known disturbance added to its inputs."""
        if not np.any(self._state.inputs):
            return sample
        return replace(sample, u=tuple((np.array(sample.u) + self._state.inputs).tolist()))

    def reason(self, trigger: Trigger, sample: Sample, tracking_error: float, theta: Vector) -> str | None:
        """Return the trigger's reason to begin an episode; None where the samples do not contradict theta (d,)."""
        state = self._state
        state.n_samples += 1
        tracked = self._window.track(theta)
        residual = self._newest = tracked.measured
        newest = self._of_newest(tracked.values, sample)
        if self._rest.is_on:
            self._rest.take(newest)
            return None
        if not len(tracked.values):
            state.n_calm = 0
            return trigger(sample, tracking_error, theta) if self._window.n_tracked else None
        if self._window.is_extended:
            return _MORE if self._window.is_ready else None
        if self._settings.is_usual(residual, len(residual)):
            self._quiet(newest)
            return None
        n_before = len(residual) - int(np.count_nonzero(np.isfinite(newest)))
        if self._is_only_newest(tracked.values, n_before):  # it may be an isolated value, which the next one tells
            return None
        if state.lasting is None or state.n_samples >= state.suspected_at + FORGOTTEN:
            state.lasting, state.rival = theta, None
        if state.n_calm >= WINDOW:
            state.restless_since, state.is_provisional = state.n_samples, False
        state.suspected_at, state.n_calm = state.n_samples, 0
        reason = trigger(sample, tracking_error, theta)
        if reason is not None and state.unexplained is not None:  # samples from before may be of what has failed
            self._window.forget()
        return reason

    def _is_only_newest(self, residual: Vector, n_before: int) -> bool:
        """Return whether a residual (D,) is unusual for its newest sample only, with n_before values before it."""
        others = residual.reshape(len(self._outputs), -1)[:, :-1]
        return self._settings.is_usual(others.ravel(), n_before)

    def _of_newest(self, residual: Vector, sample: Sample) -> Vector:
        """Return the newest sample's residual (c,) in standard deviations of the declared noise.

        NaN where an output was not measured, empty where a simulation has failed.
        """
        newest = residual.reshape(len(self._outputs), -1)[:, -1:].ravel()
        if len(newest) and self._window.weights is not None:
            newest = newest / self._window.weights
        return np.where(np.isnan(sample.y), np.nan, newest) if len(newest) == len(sample.y) else newest

    def innovation(self, theta: Vector, sample: Sample) -> Vector:
        """Return the residual (D,) that `reason` has computed for this sample: a simulation is not continued twice."""
        return self._newest

    def judge(self, theta: Vector, held: Vector) -> Judgement:
        """Return whether parameters theta (d,) in place of those in force are warranted by the sequence."""
        window, space = self._window, self.space
        if window.sequence is not self._judged:
            self._judged, self._verdict, self._is_certain = window.sequence, "refuted", False
            self._found = None
        residual = window.whitened(theta)
        self._n_judged = len(residual)
        of_held, of_theta = _fit(window.whitened(held), 0), _fit(residual, len(space))
        self._note(nothing=of_held, parameters=of_theta)
        others = of_held, self._of_lasting(held), self._of_rival(held)
        if any(f.is_explained and f.score <= of_theta.score + MARGIN for f in others):
            return "refuted"
        if of_theta.is_explained:
            self._compare(of_theta, of_held, held)
        elif self._verdict == "refuted" and window.sequence is not self._searched:
            self._searched = window.sequence

            def rows_at(z: Vector) -> Vector:
                there = window.whitened(space.from_unit(np.clip(z, 0.0, 1.0)))
                return (there if len(there) == len(residual) else np.full(len(residual), np.nan))[:, None]  # has failed

            found = changed_parameters(
                rows_at, space.to_unit(theta), iterations=8, step=DIFFERENCE_STEP, may_drift=False
            )
            self._note(parameters=found.fit)
            if found.fit.is_explained:
                self._compare(found.fit, of_held, held)
                self._found = None if self._verdict == "refuted" else self._estimate(rows_at, found)
        is_better = of_theta.is_explained or of_theta.squares < BETTER * of_held.squares
        return self._verdict if is_better else "refuted"

    def _estimate(self, rows_at: Callable[[Vector], Vector], found: ChangedParameters) -> Estimate | None:
        """Return the estimate that explains the sequence; None where no differences can be had."""
        z = np.clip(found.z, 0.0, 1.0)
        slope = forward_differences(rows_at, z, found.rows, DIFFERENCE_STEP)
        if not np.all(np.isfinite(slope)):
            return None
        known = information(slope.reshape(-1, len(z)))
        return scaled_estimate(
            self.space, z, known.std(), IDENTIFIABLE_BELOW, known, cost=found.fit.squares, n_evaluations=0,
            reason="parameters that explain the samples",
        )  # fmt: skip

    def jump(self) -> Estimate | None:
        """Return the parameters that the comparison has found to explain the sequence, once, where a search has not."""
        found, self._found = self._found, None
        return found

    def _of_lasting(self, held: Vector) -> Fit:
        """Return the fit of the parameters that lasted, where others are in force, held (d,)."""
        lasting = self._state.lasting
        if lasting is None or self.space.are_same(lasting, held):
            return NEVER
        return _fit(self._window.whitened(lasting), 0)

    def _of_rival(self, held: Vector) -> Fit:
        """Return the fit of the parameters that lasted with the disturbance that may act in place of those held (d,).

        It was found on the samples that these were written for, so that nothing is fitted here. Where it does not
        explain the sequence, it is forgotten.
        """
        state, sequence = self._state, self._window.sequence
        if state.lasting is None or state.rival is None or self.space.are_same(state.lasting, held):
            return NEVER
        if self._of_rivals[0] is not sequence:
            self._of_rivals = sequence, _fit(self._window.with_inputs(state.lasting, state.rival), 0)
        fit = self._of_rivals[1]
        if fit.is_explained:
            return fit
        state.rival = None
        return NEVER

    def _compare(self, parameters: Fit, nothing: Fit, held: Vector) -> None:
        noise = larger_noise(np.nan_to_num(self._rows(held))) if nothing is not NEVER else NEVER
        state, disturbed = self._state, self._disturbed(held)
        weighing = Weighing(parameters, disturbed.fit, nothing, noise=noise)
        self._note(**weighing.fits)
        if weighing.are_parameters_possible:
            if state.lasting is not None and self.space.are_same(state.lasting, held):
                state.rival = disturbed.inputs if disturbed.fit.is_explained else None
            self._verdict = "warranted" if weighing.are_parameters_proven else "possible"
            self._is_certain = weighing.are_parameters_certain

    def _rows(self, theta: Vector) -> Vector:
        """Return the residuals (n, c) of theta (d,) at the sequence's samples, in standard deviations; NaN: missing."""
        return self._window.rows(theta, len(self._outputs))

    def _note(self, **fits: Fit) -> None:
        if self._window.sequence is not None:
            self.evidence.note(self._window.sequence.n_steps, **fits)

    def is_at_unseen_bound(self, theta: Vector, std: Vector, held: Vector) -> bool:
        """Return whether a parameter would move to a bound although its standard deviation is as wide as the bounds."""
        return is_at_unseen_bound(self.space, theta, std, held)

    def if_noise(self, held: Vector) -> Vector | None:
        """Return the parameters held (d,) where noise of ten times the known size explains the sequence with them.

        None where it does not, or the changed parameters that were judged last are certain.
        """
        if self._is_certain or not _fit(self._window.whitened(held) / TOO_SMALL, 0).is_explained:
            return None
        return held

    def disturbance(self, held: Vector) -> Vector:
        """Return the disturbance (p,) of the inputs that may act in place of changed parameters."""
        return self._state.inputs + self._disturbed(held).inputs

    def accepted(self, before: Vector) -> Vector:
        """Return the parameters (d,) to go back to from a failed search: those before it, or those that lasted.

        The latter where they explain the sequence better: a search has followed something that came and went.
        """
        lasting, self._is_undoing = self._state.lasting, False
        if lasting is None or self.space.are_same(lasting, before):
            return before
        of_lasting, of_before = (_fit(self._window.whitened(theta), 0).score for theta in (lasting, before))
        of_rival = self._of_rival(before).score
        self._is_undoing = of_rival + MARGIN <= of_before
        return lasting if self._is_undoing or of_lasting + MARGIN <= of_before else before

    def in_rest(self, before: Vector) -> Vector:
        """Return the parameters (d,) to rest at where a rest has just begun, else those before it."""
        return self._rest.parameters(before)

    def reverted(self, theta: Vector) -> None:
        """Take a revert of the guard's to theta (d,): nothing returns to others from then on."""
        self._state.lasting, self._state.rival = theta, None

    def fail(self, t: float, theta: Vector | None, held: Vector) -> tuple[Event, ...]:
        """Take the end of a search that has found no parameters, theta (d,) being the best; return the events.

        There is none where the noise is larger than was known, and nothing has happened.
        """
        state = self._state
        if not self._is_undoing and self._adopt_noise(theta, held):
            state.unexplained = None
            return ()
        disturbed, nothing = self._disturbed(held), _fit(self._window.whitened(held), 0)
        self._note(disturbance=disturbed.fit)
        if nothing.is_explained and nothing.score <= disturbed.fit.score + MARGIN:  # a false alarm
            return ()
        state.n_failures += 1
        if disturbed.fit.is_explained:
            state.unexplained = state.rival = None
            now = state.inputs + disturbed.inputs
            is_over = bool(np.any(state.inputs)) and _fit(self._window.with_inputs(held, -state.inputs), 0).is_explained
            before, state.inputs = state.inputs, np.zeros(len(now)) if is_over else now
            self._window.move_inputs(state.inputs - before)
            size = {} if is_over else self._sizes(now)
            reason = "the disturbance is over" if is_over else (
                "a constant disturbance of the inputs explains the samples, changed parameters do not"
            )  # fmt: skip
            event = self._disturbance(t, size, reason, is_known=True)
        else:
            state.unexplained = self._left(disturbed.inputs, held)
            reason = f"no parameters explain {', '.join(self._outputs)}"
            event = Event(t, "unexplained", {"channels": list(self._outputs), "reason": reason})
            state.counts[event.kind] += 1
        if state.n_failures < PATIENCE:
            return (event,)
        return event, self._rest.begin(t)

    def _left(self, inputs: Vector, held: Vector) -> Unexplained | None:
        """Return what a failed search leaves; None where slightly larger noise, or no disturbance, would explain it."""
        sequence = self._window.sequence
        residual = self._window.whitened(held)
        if sequence is None or not np.any(inputs) or not np.all(np.isfinite(residual)):
            return None
        if _fit(residual / LARGER, 0).is_explained:
            return None
        rows = self._rows(held) * self._state.scale.effective
        return Unexplained(inputs, max(sequence.n_steps, QUIET), held, rows)

    def passed(self, t: float, held: Vector) -> tuple[Event, ...]:
        """Name a disturbance as the last search has failed and the parameters before it explain the samples again.

        These, held (d,), must do so for as many samples as that search had, in which it would have shown. The second
        time, soon after the first, what they had left unexplained is noise, if it is so small that it may be.
        """
        state, found = self._state, self._state.unexplained
        if found is None or state.n_calm < found.n_steps:
            return ()
        state.unexplained = None
        if np.any(state.inputs) or not self.space.are_same(found.held, held):
            return ()
        is_small = np.all(_mean_squares(found.rows) < TOO_SMALL**2)
        if state.n_failures >= _AGAIN and is_small and state.scale.admit(found.rows):
            self._window.weights = 1.0 / state.scale.effective
            return ()
        return (self._disturbance(t, self._sizes(found.inputs), PASSED, is_known=False),)

    def _disturbance(self, t: float, size: dict[str, float], reason: str, *, is_known: bool) -> Event:
        """Return the event of a disturbance of this size, or of the end of a known one, which has none."""
        state = self._state
        state.counts["disturbance"] += 1
        state.named = [*state.named, *([{"t": t, "size": size}] if size else [])][-MOST_NAMED:]
        return Event(t, "disturbance", {"size": size, "is_known": is_known, "reason": reason})

    def _sizes(self, inputs: Vector) -> dict[str, float]:
        return dict(zip(self._inputs, inputs.tolist(), strict=True))

    def _adopt_noise(self, theta: Vector | None, held: Vector) -> bool:
        """Adopt a larger noise where that explains the sequence, with the parameters in force or the best ones.

        Noise is what differs from sample to sample by as much as in the whole: what a model lacks is smooth.
        """
        for candidate, least in ((held, MUCH_LARGER), (theta, LARGER)):
            if candidate is None or not np.all(np.isfinite(self._window.whitened(candidate))):
                continue
            rows = self._rows(candidate)
            channels = [column[np.isfinite(column)] for column in rows.T]  # they may be measured at different rates
            if max(map(len, channels)) < NOISY or not is_rough(channels):
                continue
            larger = np.array([max(spread_of(c), 1.0) if len(c) >= NOISY else 1.0 for c in channels])
            if least <= larger.max() < LARGEST and plain_fit(np.nan_to_num(rows / larger), 0).is_explained:
                self._state.scale.enlarge(larger)
                self._window.weights = 1.0 / self._state.scale.effective
                return True
        return False

    def adopt_unexplained(self, theta: Vector, held: Vector) -> bool:
        """Adopt what parameters theta (d,) leave unexplained of the sequence as noise, where it is little.

        It is no more than ten times the known noise, and may be correlated: a hundredth of what those in force, held
        (d,), leave, and a tenth of what is left beside any constant disturbance.
        """
        if not np.all(np.isfinite(self._window.whitened(theta))):  # its simulation has failed
            return False
        rows = self._rows(theta)
        squares = _mean_squares(rows)
        largest = _LITTLE * min(
            _LITTLE * _fit(self._window.whitened(held), 0).squares, self._disturbed(held).fit.squares
        )
        if np.nansum(rows**2) >= largest or squares.max() >= TOO_SMALL**2:
            return False
        self._state.is_provisional = True
        self._known = None  # what is left beside a disturbance is smaller, too
        self._state.scale.enlarge(np.maximum(np.sqrt(squares), 1.0))
        self._window.weights = 1.0 / self._state.scale.effective
        return True

    def wait(self) -> bool:
        """Wait for more samples, on which the next episode begins; return False where there are many already."""
        return self._window.extend()

    def succeed(self) -> None:
        """Take the end of a search that has found parameters: earlier failures count less."""
        self._state.n_failures = max(self._state.n_failures - 1, 0)

    def _quiet(self, newest: Vector) -> None:
        if not np.any(np.isfinite(newest)):  # nothing was measured
            return
        state = self._state
        state.n_quiet, state.n_calm = state.n_quiet + 1, state.n_calm + 1
        if state.n_quiet >= FORGOTTEN:
            state.n_quiet, state.n_failures = 0, max(state.n_failures - 1, 0)
        if state.scale.learn(newest):
            self._window.weights = 1.0 / state.scale.effective

    def _disturbed(self, held: Vector) -> DisturbedInputs:
        """Return the disturbance of the inputs that explains the sequence best with parameters held (d,)."""
        key = (self._window.sequence, held.tobytes())
        if self._known is None or self._known[0] is not key[0] or self._known[1] != key[1]:
            self._known = (*key, disturbed_inputs(self._window, held, self._driven, len(self._inputs)))
        return self._known[2]


def _mean_squares(rows: Vector) -> Vector:
    """Return the mean square (c,) of each channel of rows (n, c); NaN: missing."""
    return np.nansum(rows**2, axis=0) / np.maximum(np.count_nonzero(np.isfinite(rows), axis=0), 1)


def _fit(residual: Vector, n_free: int) -> Fit:
    return plain_fit(residual, n_free, len(residual))
