"""Assembly of a retuner: an estimator, its window, its trigger and, where wanted, a diagnosis."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from ..contract import AskTell, Solver
from ..diagnosis.episode_diagnosis import EpisodeDiagnosis
from ..diagnosis.sample_diagnosis import Diagnosis
from ..episode_window import EpisodeWindow
from ..objective import LinearForm
from ..samples import DerivativeResidual
from ..sliding_window import ResidualWindow
from ..triggers import TriggerSettings
from .diagnosing import DiagnosingRetuner, SuspicionTrigger
from .diagnosing_episodes import DiagnosingEpisodes, EpisodeTrigger
from .retuner import Retuner
from .search import Budget

AnyRetuner = Retuner | DiagnosingRetuner | DiagnosingEpisodes
"""Retuner with or without a diagnosis."""


def make_episodes(
    estimator: AskTell | Solver,
    window: EpisodeWindow,
    trigger: TriggerSettings,
    budget: Budget,
    describe: Callable[[], str],
    linear: LinearForm | None = None,
    diagnosis: EpisodeDiagnosis | None = None,
    jumps: bool = True,
) -> AnyRetuner:
    """Return the loop for an estimator that works on sequences of samples.

    describe: returns how the window scores candidates, in a line. diagnosis: on this window; None to write whatever
    is proposed. jumps: whether parameters that the diagnosis has found are written in place of an estimate that lags
    behind.
    """
    begins = trigger.trigger(window.innovation if diagnosis is None else diagnosis.innovation)
    if diagnosis is None:
        return Retuner(estimator, window, begins, budget, linear, describe)
    retuner = Retuner(estimator, window, EpisodeTrigger(begins, diagnosis), budget, linear, describe, closes=False)
    return DiagnosingEpisodes(retuner, diagnosis, jumps)


def make_retuner(
    estimator: AskTell | Solver,
    whitened: DerivativeResidual,
    trigger: TriggerSettings,
    budget: Budget,
    max_length: int,
    linear: LinearForm | None = None,
    text: str = "",
    diagnosis: Diagnosis | None = None,
    jumps: bool = True,
) -> AnyRetuner:
    """Return the loop for an estimator that works with derivatives, on windows of at most max_length samples.

    whitened: the residual in standard deviations of its noise; an estimator in physical units gets those.
    text: description of the residual, for the report. diagnosis: None to write whatever is proposed. jumps: whether
    parameters that the diagnosis has found are written in place of an estimate that lags behind.
    """
    n = len(whitened.noise)
    residual = innovation = whitened
    rows, slopes = whitened.rows, whitened.slope_rows
    if diagnosis is not None:
        known = diagnosis.residuals
        residual, innovation, rows, slopes = known.scaled, known.innovation, known.scaled_rows, known.scaled_slopes
    if not estimator.is_whitened:
        residual = replace(whitened, noise=(1.0,) * n)
        rows, slopes = residual.rows, residual.slope_rows
    begins = trigger.trigger(innovation)
    if trigger.is_endless:
        budget = replace(budget, evaluations=math.inf)
    elif diagnosis is not None:
        begins = SuspicionTrigger(begins, diagnosis)
    window = ResidualWindow(residual, n, max_length, rows, slopes)
    if diagnosis is None:
        return Retuner(estimator, window, begins, budget, linear, partial(str, text))
    retuner = Retuner(estimator, window, begins, budget, linear, partial(str, text), judged=diagnosis.judged_drift)
    return DiagnosingRetuner(retuner, diagnosis, trigger.is_endless, jumps)
