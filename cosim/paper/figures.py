"""All figures of the paper and its table, from our own runs.

Khan and Chatterjee (2020), figures 1 to 5 and table I.
"""

import os
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import BrokenExecutor, as_completed
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from ..campaigns.compare import usable
from ..files import write_json, write_text
from ..plots.canvas import save_png, save_svg
from ..plots.response import draw_response
from ..runs.lock import new_locked_folder
from ..runs.manifest import versions
from ..runs.recorded_events import RecordedEvent, read_events
from ..runs.result import Run, read_run
from ..scenarios.scenario import Scenario
from ..studies.head import StudyError, StudyProgress, UnfinishedStudyError
from ..studies.processes import LocalProcesses
from ..studies.recipe import Recipe
from ..studies.worker import make_run
from ..system.fmu_cache import fmu_paths
from . import table as paper_table
from .illustration import Stage, draw_illustration, global_minimum, optimise
from .pictures import LABELS, draw_altitude, draw_mse, draw_pendulum

Runs = Mapping[str, Run]
"""Runs of one scenario by estimator."""

PENDULUM: Final = ("paper", "target", "none", "true")
QUADROTOR: Final = ("paper", "ipm", "ipm-scipy", "sqp", "target", "none", "true")
"""The longest first."""


def figures(
    out: Path,
    seed: int = 0,
    jobs: int | None = None,
    progress: StudyProgress | None = None,
    scenarios: tuple[Scenario, Scenario] | None = None,
) -> list[Path]:
    """Repeat the paper's experiments and draw them as PNG and SVG in `out`, absent or empty; return the files written.

    The paper's methods run without guard, screen and diagnosis, as there; `target` with them. Also writes `table.md`,
    `figures.json` with the numbers drawn, and the run folders in `out`/runs. jobs: number of
    concurrent runs, each in its own process, by default one per processor; times are fit to quote with 1 only.
    scenarios: those of the pendulum and of the quadrotor, by default the package's.
    Raises ValueError for less than one job; FolderError, ScenarioError; StudyError if a run was refused or its
    process has died; KeyboardInterrupt when interrupted, the finished runs kept.
    """
    if jobs is not None and jobs < 1:
        raise ValueError(f"jobs must be at least 1, got {jobs}.")
    pendulum, quadrotor = scenarios or (Scenario.load("pendulum"), Scenario.load("quadrotor"))
    todo = {"quadrotor": (quadrotor, chosen(usable(quadrotor))), "pendulum": (pendulum, PENDULUM)}
    for scenario, _ in todo.values():
        fmu_paths(scenario)  # built here: several processes at once would each build them
    jobs = min(jobs or os.cpu_count() or 1, sum(len(names) for _, names in todo.values()))
    with new_locked_folder("figures", out):
        runs = _runs(out, todo, seed, jobs, progress)
        return draw_figures(out, runs["pendulum"], runs["quadrotor"], seed, jobs)


def _runs(
    out: Path,
    todo: Mapping[str, tuple[Scenario, Sequence[str]]],
    seed: int,
    jobs: int,
    progress: StudyProgress | None,
) -> dict[str, dict[str, Run]]:
    """Return the runs of each scenario by estimator, in folders in `out`/runs. Raises StudyError, FolderError."""
    (out / "runs").mkdir()
    recipes = {
        (key, name): Recipe(
            unguarded(scenario) if name in paper_table.IN_PAPER else scenario,
            name,
            seed,
            versions(),
            folder=str(out / "runs" / f"{key}-{name}"),
        )
        for key, (scenario, names) in todo.items()
        for name in names
    }
    with LocalProcesses(jobs) as processes:
        futures = {processes.submit(make_run, recipe): key for key, recipe in recipes.items()}
        for n_ended, future in enumerate(as_completed(futures), 1):
            key, name = futures[future]
            told = f"{key}, estimator {name}, seed {seed}"
            try:
                answer = future.result()
            except BrokenExecutor as e:
                raise UnfinishedStudyError(f"{told}: {e}.") from e
            if answer.kind != "result":
                raise (StudyError if answer.kind == "refused" else UnfinishedStudyError)(f"{told}: {answer.why}")
            if progress is not None:
                progress({"scenario": key, "estimator": name, "seed": seed, **answer.row}, n_ended, len(recipes))
    return {key: {name: read_run(out / "runs" / f"{key}-{name}") for name in names} for key, (_, names) in todo.items()}


def unguarded(scenario: Scenario) -> Scenario:
    """Return the scenario without guard, screen and diagnosis, as the paper's methods were run there."""
    off = {"guard.enabled": "false", "observations.enabled": "false", "diagnosis.enabled": "false"}
    label = Path(scenario.scenario.name)
    return Scenario.from_tables(scenario.model_dump(mode="json"), off, scenario.folder, label, scenario.origin)


def chosen(names: Collection[str]) -> list[str]:
    """Return the usable estimators for the quadrotor; of the interior-point methods Ipopt, if it is available."""
    spare = "ipm-scipy" if "ipm" in names else "ipm"
    return [name for name in QUADROTOR if name in (*names, "none", "true") and name != spare]


def draw_figures(out: Path, pendulum: Runs, quadrotor: Runs, seed: int, jobs: int = 1) -> list[Path]:
    """Write figures, table and numbers of these runs into the folder; return the files written. Raises FolderError."""
    events = {key: _events(runs) for key, runs in (("pendulum", pendulum), ("quadrotor", quadrotor))}
    stages = optimise(seed)
    drawn: dict[str, Figure | None] = {
        "illustration": draw_illustration(stages),
        "pendulum-solution": _solution(pendulum, events["pendulum"], "target"),
        "pendulum-solution-paper": _solution(pendulum, events["pendulum"], "paper"),
        "pendulum-tracking": draw_pendulum(pendulum, events["pendulum"].get("target", [])),
        "quadrotor-mse": draw_mse(quadrotor) if quadrotor else None,
        "quadrotor-altitude": draw_altitude(quadrotor) if quadrotor else None,
    }
    paths = [
        save(figure, out / f"{name}.{save.__name__[-3:]}")
        for name, figure in drawn.items()
        if figure is not None
        for save in (save_png, save_svg)
    ]
    table = paper_table.rows(quadrotor, events["quadrotor"])
    numbers = {
        "seed": seed,
        "jobs": jobs,
        "illustration": _illustration_numbers(stages),
        "pendulum": {name: _numbers(r, out) | _episode(events["pendulum"][name]) for name, r in pendulum.items()},
        "quadrotor": {name: _numbers(r, out) | _altitude(r) for name, r in quadrotor.items()},
        "table": table,
    }
    write_text(out / "table.md", paper_table.markdown(quadrotor, table, LABELS, jobs))
    write_json(out / "figures.json", numbers)
    return [*paths, out / "table.md", out / "figures.json"]


def _events(runs: Runs) -> dict[str, list[RecordedEvent]]:
    return {name: read_events(run.folder) if run.folder else [] for name, run in runs.items()}


def _solution(runs: Runs, events: Mapping[str, Sequence[RecordedEvent]], name: str) -> Figure | None:
    """Draw figure 2, the search of the first episode; return None without such a run or an episode in it."""
    if name not in runs or not len(runs[name].time):
        return None
    figure = draw_response(runs[name], events[name])
    if figure is not None:
        (axes, *_) = figure.axes
        axes.set_title(f"{LABELS[name]}; {axes.get_title()}", fontsize=9)
    return figure


def _numbers(run: Run, out: Path) -> dict[str, Any]:
    """Return the run's summary, with its folder relative to `out`."""
    folder = str(run.folder.relative_to(out)) if run.folder and run.folder.is_relative_to(out) else None
    label = LABELS.get(run.estimator, run.estimator)
    return run.summary() | {"label": label, "run": folder, "tracking": list(run.scenario.tracking)}


def _episode(events: Sequence[RecordedEvent]) -> dict[str, Any]:
    """Return the candidates of the first episode, in order."""
    ends = [i for i, e in enumerate(events) if e.get("kind") == "end"]
    first = events[: ends[0]] if ends else events
    found = [e for e in first if e.get("kind") == "candidate"]
    return {"first_episode": [{"t": e["t"], "theta": e.get("theta"), "cost": e.get("cost")} for e in found]}


def _altitude(run: Run) -> dict[str, Any]:
    """Return root mean square and maximum of the altitude error [m], over the rows recorded."""
    error = run.errors["plant.r_z"]
    if not len(error):
        return {"altitude_error": None}
    rms, largest = np.sqrt(np.mean(error * error)), np.max(np.abs(error))
    return {"altitude_error": {"rms": float(rms), "largest": float(largest)}}


def _illustration_numbers(stages: Sequence[Stage]) -> dict[str, Any]:
    place, value = global_minimum()
    return {
        "global_minimum": {"x": place, "value": value},
        "stages": [{"x": s.x.tolist(), "y": s.y.tolist(), "next": s.next_place, "best": s.best_place} for s in stages],
    }
