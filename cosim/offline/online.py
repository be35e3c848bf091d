"""Re-tuning replayed on a log, sample by sample: when it triggers, and what it would have written.

Nothing is written into a controller, and the measurements stay as they are: this shows when the loop would have
written, and what, but not how well the controller would then have tracked.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any, Final

import numpy as np

from estimator import METHODS, EpisodeWindow, ParameterSpace, Sample, Vector
from estimator.contract import Rescoring
from estimator.diagnosis.episode_diagnosis import EpisodeDiagnosis
from estimator.diagnosis.settings import DiagnosisSettings
from estimator.events import Event
from estimator.retuning.factory import make_episodes
from estimator.retuning.search import Budget
from estimator.triggers import InnovationSettings

from ..errors import ScenarioError, WiringError
from ..fmi.archive import capabilities, has_fixed_step
from ..fmi.component import Component
from ..fmi.ports import Catalogue
from ..fmi.types import is_real
from ..objectives.hidden_states import Suspect, hidden_states
from ..objectives.rollout import RolloutObjective
from ..objectives.rollout_check import PROOF_STEPS
from ..objectives.rollout_fmu import START_METHODS, Shadow, StartMethod, obstacles_in_words
from ..objectives.rollout_start import NoisyStartObjective
from ..retuning.data_support import NoDataSupport
from ..retuning.decision import Point
from ..retuning.supervisor import Supervisor
from ..sampling.screen import OutputScreen
from ..scenarios.schema.sampling import ObservationSettings
from .log_windows import LogWindow
from .one_by_one import OneByOne
from .request import EstimateError, Request
from .rollout import Grid, grid_of, noise_of
from .understood import Understood, out_of_bounds, understand

_MOVING: Final = ("output", "local")
"""Causalities of variables that change while the FMU runs: with a start value, they are states."""
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
    is_even = has_fixed_step(understood.component.description)
    n_points = max(len(_grid(window, request.step, is_even).times) for window in understood.windows)
    if n_samples >= n_points:
        points = f"{n_points} {'rows' if request.step is None else 'communication points'}"
        raise EstimateError(f"--samples must be less than the {points} of the longest window, got {n_samples}.")
    obstacles = _obstacles(request, understood)
    rngs = np.random.default_rng(request.seed).spawn(len(understood.windows))
    n_before, n_all = 0, sum(len(w.time) for w in understood.windows)
    watched: list[Watched] = []
    theta = understood.nominal
    for window, rng in zip(understood.windows, rngs, strict=True):
        report_progress = partial(_told, progress, n_before, n_all)
        counts = n_samples, n_per_sample
        theta = understood.nominal if window.part == 1 else theta
        watched.append(_watched(request, understood, obstacles, window, theta, counts, rng, report_progress))
        theta = watched[-1].theta
        n_before += len(window.time)
    return Online(request, understood, n_samples, tuple(watched), perf_counter() - began)


def _told(progress: SampleProgress, n_before: int, n_all: int, n: int) -> None:
    progress(n_before + n, n_all)


def _watched(
    request: Request,
    understood: Understood,
    obstacles: Mapping[StartMethod, str],
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
    start_theta, space = theta, understood.space
    interface: Any = capabilities(understood.component.description)
    others = _other_inputs(request, understood.component)
    inputs = (*request.inputs, *others)
    is_even = has_fixed_step(understood.component.description)
    samples, u0 = _samples(window, request.step, is_even, tuple(others.values()))
    names, states, outputs = set(space.names), _states(request), tuple(request.measured)
    start = dict(zip(inputs, u0, strict=True)) | request.constants | dict(window.start)
    shadow = Shadow(
        request.fmu, inputs, states, tuple(request.measured), tuple(understood.noise.tolist()),
        space.names, {name: value for name, value in start.items() if name not in names}, samples[0].t, samples[-1].t,
        not interface.canBeInstantiatedOnlyOncePerProcess, obstacles, request.timeout,
        request.environment, told_by=_told_by(request, understood),
    )  # fmt: skip
    suspects = _suspects(understood.component, shadow)
    if "measured" not in obstacles and suspects:
        hidden = hidden_states(shadow, samples, theta, suspects, 2 * counts[0])
        shadow = shadow if hidden is None else replace(shadow, obstacles={**obstacles, "measured": hidden})
    noise = noise_of([replace(w, measured=w.states) for w in understood.windows]).tolist()
    events: list[Event] = []
    with NoisyStartObjective(partial(RolloutObjective, shadow, theta, None, None, request.jobs), noise) as objective:
        n_samples, n_per_sample = counts
        stretch = EpisodeWindow(objective, n_samples)
        diagnosis = EpisodeDiagnosis(stretch, outputs, inputs, DiagnosisSettings(), space)
        budget = Budget(request.evaluations, n_per_sample)
        retuner = make_episodes(
            _search(request, space, theta, rng), stretch, InnovationSettings(), budget,
            objective.describe, diagnosis=diagnosis,
        )  # fmt: skip
        macro_step = samples[1].t - samples[0].t
        of_outputs, of_states = zip(outputs, understood.noise.tolist(), strict=True), zip(states, noise, strict=True)
        screen = OutputScreen(ObservationSettings(), dict(of_outputs), dict(of_states), macro_step, may_be_missing=True)
        supervisor = Supervisor(request.method, retuner, NoDataSupport(), screen)
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


def _grid(window: LogWindow, step: float | None, is_even: bool) -> Grid:
    """Return the communication points within the window. Raises EstimateError, LogError."""
    distance = float(np.median(np.diff(window.time)))
    if step is not None and step < 0.99 * distance:
        raise EstimateError(f"--online takes samples {distance:g} s apart: --step must be so long at least.")
    grid = grid_of(window, step, is_even)
    is_beyond = grid.rows is not None and grid.times[-1] > grid.rows[-1] + 1e-9 * distance
    return grid if not is_beyond else grid._replace(times=grid.times[:-1], inputs=grid.inputs[:-1])


def _samples(
    window: LogWindow, step: float | None, is_even: bool, others: tuple[float, ...]
) -> tuple[list[Sample], list[float]]:
    """Return a sample for each row, or communication point, in the FMU's time; and the inputs in the first row.

    others: values of the inputs that have no column, which come last.
    """
    times, inputs, rows = _grid(window, step, is_even)
    table = np.column_stack([window.states, window.measured])
    if rows is not None:
        table = np.column_stack([np.interp(times, rows, column, right=np.nan) for column in table.T])
    held, n = [inputs[0], *inputs], window.states.shape[1]
    return [
        Sample(t, tuple(row[:n]), (*u, *others), (), tuple(row[n:]))
        for t, u, row in zip(times, held, table.tolist(), strict=True)
    ], [*held[0], *others]


def _other_inputs(request: Request, component: Component) -> dict[str, float]:
    """Return the values of the inputs without a column: what the log does not show may act on them all the same."""
    taken = {*request.inputs, *request.start_columns}
    others = [v for v in component.having("input") if is_real(v.type) and v.name not in taken]
    start = {v.name: request.constants.get(v.name, v.start) for v in others}
    return {name: float(value) for name, value in start.items() if value is not None}


def _states(request: Request) -> tuple[str, ...]:
    """Return the variables that start as their column does: the states; that none is missing is tested later."""
    return tuple(request.start_columns)


def _suspects(component: Component, shadow: Shadow) -> list[Suspect]:
    """Return the variables that may be states without a column: with a start value, or a declared derivative."""
    known = {*shadow.states, *shadow.told_by.values()}
    moving = [v for v in component.variables.values() if v.causality in _MOVING and is_real(v.type)]
    return [
        Suspect(v.name, float(v.start or 0.0))
        for v in moving
        if v.name not in known
        and v.variability in ("continuous", "discrete")
        and (v.start is not None or v.name in component.derivatives)
    ]


def _told_by(request: Request, understood: Understood) -> dict[str, str]:
    """Return the output with the column, and the unit, of each parameter that a state starts as."""
    variables, unit = understood.component.variables, understood.component.unit
    outputs = [(column, unit(name), name) for name, column in request.measured.items()]
    found: dict[str, str] = {}
    for name in _states(request):
        same = [output for column, of, output in outputs if (column, of) == (request.start[name], unit(name))]
        if same and variables[name].causality == "parameter":
            found[name] = same[0]
    return found


def _obstacles(request: Request, understood: Understood) -> dict[StartMethod, str]:
    """Return the ways of beginning a roll-out that do not work, with reasons. Raises EstimateError if none is left."""
    component = understood.component
    obstacles: dict[StartMethod, str] = {"state": "there is only the log"}
    if not _states(request):
        obstacles["measured"] = "no --start names the columns of the states"
    elif numbers := [name for name in request.constants if component.variables[name].causality in _MOVING]:
        obstacles["measured"] = f"--start gives {numbers[0]} a number, which is no measurement"
    elif any(np.isnan(w.states[0]).any() for w in understood.windows):
        obstacles["measured"] = "values are missing in the first row of the states' columns"
    if unknown := [p.name for p in understood.space if component.variables[p.name].causality != "parameter"]:
        raise EstimateError(f"--online estimates parameters, and '{unknown[0]}' is none: leave out --online.")
    try:
        Catalogue(request.fmu.name, component.description.modelVariables).ports(
            "tunable parameter", understood.space.names
        )
    except WiringError as e:
        obstacles["replay"] = str(e).rstrip(".")
    if len(obstacles) == len(START_METHODS):
        raise EstimateError(f"--online has no way to begin a roll-out: {obstacles_in_words(obstacles)}.")
    return obstacles
