"""Every figure of the paper and its table, from runs of our own.

Khan and Chatterjee (2020), figures 1 to 5 and table I.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from estimator import METHODS

from . import paper_table
from .canvas import save_png, save_svg
from .illustrate import Stage, global_minimum, optimise
from .panels import Event
from .paper_figures import LABELS, draw_altitude, draw_illustration, draw_mse, draw_pendulum
from .plots import read_events
from .record import new_run_folder, write_json, write_text
from .response import draw_response
from .result import Run
from .scenario import Scenario
from .simulation import run as simulate
from .system import fmu_paths

Runs = Mapping[str, Run]
"""Runs of one scenario by estimator."""
Job = tuple[str, str]
"""Scenario and estimator."""

PENDULUM: Final = ("none", "paper", "target", "true")
QUADROTOR: Final = ("paper", "ipm", "ipm-scipy", "sqp", "target", "none", "true")
"""The longest first."""


def figures(out: Path, seed: int = 0, jobs: int | None = None) -> list[Path]:
    """Run what the paper shows, and draw it as PNG and SVG in `out`, absent or empty; returns the files written.

    Besides, `table.md`, `figures.json` with the numbers of what is drawn, and the run folders in `out`/runs. jobs:
    processes at once, by default as many as there are cores, though times are good for quoting with 1 only; with more,
    the calling program's main module must be importable (`if __name__ == "__main__":`).
    Raises FolderError, ScenarioError; KeyboardInterrupt when interrupted, the finished runs kept.
    """
    new_run_folder("figures", out)
    jobs = jobs or os.cpu_count() or 1
    todo = [("quadrotor", name) for name in estimators()] + [("pendulum", name) for name in PENDULUM]
    for scenario in ("pendulum", "quadrotor"):
        fmu_paths(Scenario.load(scenario))  # built here: several processes at once would each build them
    runs = dict(zip(todo, _run_all(out / "runs", todo, seed, jobs), strict=True))
    by_scenario = {s: {e: r for (of, e), r in runs.items() if of == s} for s in ("pendulum", "quadrotor")}
    return draw_figures(out, by_scenario["pendulum"], by_scenario["quadrotor"], seed, jobs)


def estimators(known: Sequence[str] = (*METHODS, "none", "true"), has_ipopt: bool | None = None) -> list[str]:
    """Estimators that the quadrotor is run with: of the interior-point methods Ipopt, where it is installed."""
    if has_ipopt is None:
        has_ipopt = find_spec("cyipopt") is not None
    spare = "ipm-scipy" if has_ipopt and "ipm" in known else "ipm"
    return [name for name in QUADROTOR if name in known and name != spare]


def draw_figures(out: Path, pendulum: Runs, quadrotor: Runs, seed: int, jobs: int = 1) -> list[Path]:
    """Figures, table and numbers of these runs into the folder; returns the files written. Raises FolderError."""
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


def _run_all(folder: Path, todo: Sequence[Job], seed: int, jobs: int) -> Iterator[Run]:
    """The runs, in order, each recorded in a folder of its own."""
    folders = [folder / f"{scenario}-{estimator}" for scenario, estimator in todo]
    if jobs == 1:
        yield from (_run(job, seed, place) for job, place in zip(todo, folders, strict=True))
        return
    # Spawned: a forked child would inherit threads' locks.
    with ProcessPoolExecutor(min(jobs, len(todo)), mp_context=get_context("spawn")) as pool:
        try:
            started: list[Future[Run]] = [
                pool.submit(_run, job, seed, place) for job, place in zip(todo, folders, strict=True)
            ]
            yield from (future.result() for future in started)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _run(job: Job, seed: int, folder: Path) -> Run:
    scenario, estimator = job
    folder.mkdir(parents=True)
    return simulate(Scenario.load(scenario), estimator, seed, folder)


def _events(runs: Runs) -> dict[str, list[Event]]:
    return {name: read_events(run.folder) if run.folder else [] for name, run in runs.items()}


def _solution(runs: Runs, events: Mapping[str, Sequence[Event]], name: str) -> Figure | None:
    """Figure 2: what the first episode searched; None without such a run or an episode of its."""
    if name not in runs or not len(runs[name].time):
        return None
    figure = draw_response(runs[name], events[name])
    if figure is not None:
        (axes, *_) = figure.axes
        axes.set_title(f"{LABELS[name]}; {axes.get_title()}", fontsize=9)
    return figure


def _numbers(run: Run, out: Path) -> dict[str, Any]:
    """The run's summary, its folder as seen from `out`."""
    folder = str(run.folder.relative_to(out)) if run.folder and run.folder.is_relative_to(out) else None
    label = LABELS.get(run.estimator, run.estimator)
    return run.summary() | {"label": label, "run": folder, "tracking": list(run.scenario.tracking)}


def _episode(events: Sequence[Event]) -> dict[str, Any]:
    """Candidates of the first episode, in order."""
    ends = [i for i, e in enumerate(events) if e.get("kind") == "end"]
    first = events[: ends[0]] if ends else events
    found = [e for e in first if e.get("kind") == "candidate"]
    return {"first_episode": [{"t": e["t"], "theta": e.get("theta"), "cost": e.get("cost")} for e in found]}


def _altitude(run: Run) -> dict[str, Any]:
    """Root mean square and largest of the altitude error [m], over the rows there are."""
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
