"""Re-tuning replayed on a log, sample by sample: when it triggers, and what it would have written.

Nothing is written into a controller, and the measurements stay as they are: this shows when the loop would have
written, and what, but not how well the controller would then have tracked.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from estimator import METHODS, EpisodeWindow, ParameterSpace, Vector
from estimator.contract import Rescoring
from estimator.diagnosis.episode_diagnosis import EpisodeDiagnosis
from estimator.diagnosis.settings import DiagnosisSettings
from estimator.events import Event
from estimator.retuning.factory import AnyRetuner, make_episodes
from estimator.retuning.search import Budget
from estimator.triggers import InnovationSettings

from ..errors import ScenarioError
from ..objectives.rollout import RolloutObjective
from ..objectives.rollout_check import PROOF_STEPS
from ..objectives.rollout_start import NoisyStartObjective
from ..retuning.data_support import NoDataSupport
from ..retuning.decision import Point
from ..retuning.supervisor import Supervisor
from .log_windows import LogWindow
from .one_by_one import OneByOne
from .online_plant import OnlinePlant
from .request import EstimateError, Request
from .understood import Understood, out_of_bounds, understand

SampleProgress = Callable[[int, int], None]
"""Function called with the number of samples taken so far, and the number of all."""


@dataclass(frozen=True)
class Watched:
    """Result of the replay over one window of a log."""

    window: LogWindow
    start: Vector
    """Parameters (d,) in use at the start."""
    events: tuple[Event, ...]
    """Events in order, at the log's time; those of candidates left out."""
    n_candidates: int
    """Number of candidates evaluated."""
    theta: Vector
    """Parameters (d,) in use at the end."""
    how: str
    """Description of the objective."""
    failure: str | None
    """Reason why the roll-out with the parameters in use failed before the end, or None."""
    not_begun: str | None
    """Reason why no roll-out was made, and nothing judged, or None."""
    found: Mapping[str, Any]
    """Findings of screen and diagnosis, as JSON values."""


@dataclass(frozen=True)
class Online:
    """Result of the replay over all windows."""

    request: Request
    understood: Understood
    n_samples: int
    """Number of samples that a candidate is evaluated on."""
    watched: tuple[Watched, ...]
    """Results by window."""
    seconds: float
    """Wall time [s]."""

    def __repr__(self) -> str:
        """Return one line with what was done and the parameters at the end: events and series would fill pages."""
        end = self.understood.space.named(self.watched[-1].theta)
        values = ", ".join(f"{name} = {value:.5g}" for name, value in end.items())
        counts = f"triggered {self.times('trigger')}, written {self.times('write')}"
        return f"<Online of {self.request.fmu.name}: {counts if self.is_judged else 'nothing judged'}, {values}>"

    def times(self, kind: str) -> str:
        """Return, in words, how many events of that kind there were."""
        n = sum(e.kind == kind for w in self.watched for e in w.events)
        return ("never", "once", "twice")[n] if n < 3 else f"{n} times"

    @property
    def failure(self) -> str | None:
        """The first failure, with the name of its window, or why nothing was judged at all, or None."""
        named = {w.window.name: w.failure if self.is_judged else w.not_begun for w in self.watched}
        return next((f"{name}: {why}" for name, why in named.items() if why is not None), None)

    @property
    def is_judged(self) -> bool:
        """False where no roll-out was made in any window."""
        return any(w.not_begun is None for w in self.watched)

    @property
    def warnings(self) -> list[str]:
        """Warnings about what was not used of the logs, and about windows in which nothing was judged."""
        left = [f"{w.window.name}: {w.not_begun}" for w in self.watched if w.not_begun is not None]
        if not left or not self.is_judged:
            return self.understood.warnings
        n, verb, first = len(left), *(("is", "") if len(left) == 1 else ("are", "the first "))
        told = f"{n} of {len(self.watched)} windows {verb} passed over, {first}{left[0]}."
        return [*self.understood.warnings, told]


def run_online(
    request: Request, n_samples: int, progress: SampleProgress = lambda n, n_all: None, n_per_sample: int = 1
) -> Online:
    """Replay algorithm 1 on each window of the logs, sample by sample, each independently.

    The parameters are at first the FMU's start values, or the request's, and after a gap those in force before it.
    Candidates are evaluated on n_samples samples: begun in measured states, where the request names their columns, else
    simulated from the window's first row with the parameters accepted on the way. The request's evaluations are those
    of an episode, n_per_sample of them at each sample; nothing is held out.

    Raises CosimError in one line for what is refused.
    """
    began = perf_counter()
    if request.holdout or request.validation:
        raise EstimateError("--online takes all rows one after the other: leave out --holdout and --validate.")
    request = replace(request, holdout=0.0)
    understood = understand(request)
    if wrong := next(iter(out_of_bounds(request, understood.component)), None):
        raise EstimateError(f"--online begins with the values in force, and {wrong}: give wider bounds, or --start.")
    plant = OnlinePlant(request, understood)
    n_points = max(plant.n_points(window) for window in understood.windows)
    if n_samples >= n_points:
        points = f"{n_points} {'rows' if request.step is None else 'communication points'}"
        raise EstimateError(f"--samples must be less than the {points} of the longest window, got {n_samples}.")
    rngs = np.random.default_rng(request.seed).spawn(len(understood.windows))
    n_before, n_all = 0, sum(len(w.time) for w in understood.windows)
    watched: list[Watched] = []
    theta = understood.nominal
    for window, rng in zip(understood.windows, rngs, strict=True):
        report_progress = partial(_told, progress, n_before, n_all)
        counts = n_samples, n_per_sample
        theta = understood.nominal if window.part == 1 else theta
        watched.append(_watched(request, plant, window, theta, counts, rng, report_progress))
        theta = watched[-1].theta
        n_before += len(window.time)
    return Online(request, understood, n_samples, tuple(watched), perf_counter() - began)


def _told(progress: SampleProgress, n_before: int, n_all: int, n: int) -> None:
    progress(n_before + n, n_all)


def _watched(
    request: Request,
    plant: OnlinePlant,
    window: LogWindow,
    theta: Vector,
    counts: tuple[int, int],
    rng: np.random.Generator,
    progress: Callable[[int], None],
) -> Watched:
    """Replay one window, with a loop and an FMU of its own.

    theta: parameters (d,) in use at its start.
    counts: samples that a candidate is evaluated on, candidates evaluated at each sample.
    """
    start_theta = theta
    samples, shadow = plant.replayed(window, theta, 2 * counts[0])
    noise = plant.noise_of_states
    events: list[Event] = []
    with NoisyStartObjective(partial(RolloutObjective, shadow, theta, None, None, request.jobs), noise) as objective:
        search = _search(request, plant.understood.space, theta, rng)
        retuner = _retuner(request, plant, search, objective, counts)
        macro_step = samples[1].t - samples[0].t
        supervisor = Supervisor(request.method, retuner, NoDataSupport(), plant.screen(macro_step))
        for k, sample in enumerate(samples[1:], 1):
            try:
                decision = supervisor.step(Point(k, sample.t, sample, 0.0), theta)
            except ScenarioError as e:
                raise EstimateError(f"--online: {str(e).removeprefix('estimation.rollout: ')}") from e
            told = (event for event in decision.events if event.kind != "candidate")
            events += [replace(event, t=window.origin + event.t) for event in told]
            theta = theta if decision.write is None else decision.write
            progress(k + 1)
        return Watched(
            window, start_theta, tuple(events), retuner.n_evaluations, theta, objective.describe(),
            failure=objective.why_lost if objective.is_ready else None,
            not_begun=None if objective.is_ready else _not_begun(len(samples)),
            found=_in_time_of_log(supervisor.summary(), window.origin),
        )  # fmt: skip


def _retuner(
    request: Request, plant: OnlinePlant, search: Any, objective: NoisyStartObjective, counts: tuple[int, int]
) -> AnyRetuner:
    """Return the re-tuning of one window, by episodes of a search on roll-outs; counts: as in `_watched`."""
    n_samples, n_per_sample = counts
    stretch = EpisodeWindow(objective, n_samples)
    diagnosis = EpisodeDiagnosis(
        stretch, tuple(request.measured), plant.inputs, DiagnosisSettings(), plant.understood.space
    )
    budget = Budget(request.evaluations, n_per_sample)
    return make_episodes(search, stretch, InnovationSettings(), budget, objective.describe, diagnosis=diagnosis)


def _in_time_of_log(found: Mapping[str, Any], origin: float) -> Mapping[str, Any]:
    """Return the findings of screen and diagnosis with the log's times [s]."""
    diagnosis = found["diagnosis"]
    named = [{**one, "t": origin + one["t"]} for one in diagnosis["disturbances"]]
    return {**found, "diagnosis": {**diagnosis, "disturbances": named}}


def _not_begun(n_rows: int) -> str:
    """Return the reason why no roll-out was made."""
    if n_rows <= PROOF_STEPS:
        return f"{n_rows} rows are too few to begin"
    return (
        f"the FMU hardly moves beside the noise in these {n_rows} rows: nothing shows whether all states are measured; "
        "without --start COLUMN it is simulated from the first row"
    )


def _search(request: Request, space: ParameterSpace, theta: Vector, rng: np.random.Generator) -> Any:
    method = METHODS[request.method]
    of_method = {k: v for k, v in method.defaults.items() if k in method.setting_names}
    search = method.estimator(space, theta, rng, method.settings(**of_method))
    return OneByOne(search) if isinstance(search, Rescoring) else search
