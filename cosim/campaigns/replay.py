"""Open-loop replay of a recorded run with other estimators: all get identical samples."""

from collections.abc import Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import replace
from math import hypot, nan
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from estimator import Vector

from ..blas_threads import one_thread
from ..errors import FolderError, ScenarioError
from ..retuning.assembly import make_supervisor, try_model
from ..retuning.decision import Point
from ..retuning.estimators import find_method
from ..runs.latencies import Latencies
from ..runs.lock import new_locked_folder
from ..runs.record import recording
from ..runs.result import Run, read_run
from ..sampling.sampler import recorded_measurements, recorded_samples
from ..scenarios.scenario import Scenario
from ..scenarios.schema.guard import GuardSettings
from ..scenarios.trust import check_trust, trusted, with_own
from ..studies.row import record_of
from ..system.tuning import tuning_rule
from .comparison import Comparison


def replay(
    folder: Path, estimators: Sequence[str], seed: int | None = None, out: Path | None = None, trust: bool = False
) -> Comparison:
    """Return the estimates of each estimator from a run's samples; plant and controller move as recorded.

    Samples are screened as in a run, but there is no guard: a prediction or a revert has no consequences here. A
    tracking error that an estimator would have reduced stays, so one that is triggered by it is triggered repeatedly.
    Each starts from the controller's first parameters. seed: of the search, by default the run's. With `out`, an absent
    or empty folder, the tables are written there. trust: run the Python code that the folder names even if the run was
    not made by this user, or the code is not as it was.
    Raises FolderError for a folder without a run; ScenarioError for `none` and `true`, which estimate nothing, and for
    what `run` refuses of an estimator.
    """
    recorded = read_run(folder)
    scenario = trusted(recorded.scenario) if trust else with_own(recorded.scenario, *estimators)
    check_trust(scenario)
    recorded = replace(recorded, scenario=scenario)
    for name in estimators:
        if name in ("none", "true"):
            raise ScenarioError(f"'{name}' estimates nothing; replay an estimator, such as 'target'.")
        find_method(name, recorded.scenario)
    seed = recorded.seed if seed is None else seed
    with new_locked_folder(recorded.scenario.scenario.name, out) if out is not None else nullcontext():
        runs = [replayed(recorded, name, seed) for name in dict.fromkeys(estimators)]
        records = tuple(record_of(run) for run in runs)
        names = tuple(run.estimator for run in runs)
        comparison = Comparison(recorded.scenario, names, (seed,), records, 1, folder=out, is_open_loop=True)
        if out is not None:
            with recording(out):
                comparison.write(out)
    return comparison


@one_thread()  # the number of BLAS threads changes bits
def replayed(recorded: Run, estimator: str, seed: int) -> Run:
    """Return the recorded run with this estimator's estimates from its samples; its tracking errors stay.

    Raises FolderError where the record lacks a column or a row; ScenarioError.
    """
    scenario = recorded.scenario
    columns = [scenario.held_column(p) for p in scenario.estimation.parameters]
    try:
        errors = np.array(list(recorded.errors.values())).T
        _ = recorded.true_parameters
        samples = recorded_samples(scenario, recorded.plant, recorded.series, range(len(recorded.time)))
        measured = recorded_measurements(scenario, recorded.plant, recorded.series)
        held = np.array([recorded.series[name] for name in columns]).T
    except KeyError as e:
        raise FolderError(f"{recorded.folder} lacks the column {e}: it was recorded by another version.") from e
    if not samples:
        raise FolderError(f"{recorded.folder} has no rows.")
    # As `run` spawns them: the noise's stream, which is on record already, and the search's.
    rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[1])
    begun = perf_counter()
    latencies = Latencies()
    theta, thetas = held[0], [held[0]]
    with ExitStack() as stack:
        unguarded = scenario.model_copy(update={"guard": GuardSettings(enabled=False)})
        supervisor = make_supervisor(unguarded, estimator, recorded.plant, theta, rng, stack)
        first = next((sample for sample in samples if sample is not None), None)
        if first is not None:
            try_model(scenario, estimator, recorded.plant, theta, first)
        points = zip(recorded.time.tolist(), samples, errors, measured, strict=True)
        for k, (t, sample, error, measurement) in enumerate(points):
            if k:
                decision = supervisor.step(Point(k, t, sample, hypot(*error), measurement), theta)
                latencies.append(k, decision.latencies)
                theta = theta if decision.write is None else decision.write
                thetas.append(theta)
    estimates = dict(zip(columns, np.array(thetas).T, strict=True)) | _gains(scenario, thetas)
    return replace(
        recorded, estimator=estimator, seed=seed, series={**recorded.series, **estimates}, status="done", error=None,
        n_evaluations=supervisor.n_evaluations, n_episodes=supervisor.n_episodes,
        n_model_calls=supervisor.n_model_calls, latencies=latencies.by_step(),
        latency_steps=latencies.stretches(), objective=supervisor.describe(),
        wall=perf_counter() - begun, folder=None, final_estimate=None, **supervisor.summary(),
    )  # fmt: skip


def _gains(scenario: Scenario, thetas: Sequence[Vector]) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    """Return the controller's parameters by the tuning rule, by name; NaN where it has no values."""
    rule = tuning_rule(scenario)

    def values(theta: Vector) -> list[float]:
        try:
            return rule(theta)
        except ValueError:
            return [nan] * len(rule.names)

    return {} if rule.is_plain else dict(zip(rule.names, np.array([values(theta) for theta in thetas]).T, strict=True))
