"""Comparison of estimators on the same plant, noise and seeds: many runs, in processes of their own, and one table."""

import os
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Final

from estimator import METHODS

from ..errors import FolderError, ScenarioError
from ..files import to_json
from ..retuning.estimators import check_estimator
from ..runs.lock import new_locked_folder
from ..scenarios.scenario import Scenario
from ..scenarios.trust import check_trust, with_own
from ..system.fmu_cache import fmu_paths
from .comparison import Comparison
from .executor import Executor, ExecutorError, RunsProgress, Task

RUNS: Final = "runs.jsonl"
"""File with a line for each finished run, in the order in which they ended."""


def compare(
    scenario: Scenario | Path | str,
    estimators: Sequence[str] | None = None,
    seeds: int | Sequence[int] = 10,
    jobs: int | None = None,
    out: Path | str | None = None,
    keep: bool = False,
    progress: RunsProgress | None = None,
) -> Comparison:
    """Run each of `none`, `true` and the estimators with each seed; a count of seeds means 0, 1, ..., seeds - 1.

    scenario: a Scenario, the name of one, or a TOML file. estimators: by default all that this scenario and the
    installed packages allow.

    Up to `jobs` runs (default: one per processor) are simulated at a time, each in a process of its own; their number
    affects wall times only. With `out`, an absent or empty folder, each run is recorded in runs.jsonl as it ends, and
    the tables are written at the end; with `keep` each run has its folder there, too. Diverged and faulted runs count.
    Raises ValueError for seeds or jobs that make no sense; CosimError for what `run` refuses.
    """
    scenario = with_own(scenario if isinstance(scenario, Scenario) else Scenario.load(scenario), *(estimators or ()))
    check_trust(scenario)
    out = None if out is None else Path(out)
    names = tuple(dict.fromkeys(("none", "true", *(usable(scenario) if estimators is None else estimators))))
    for name in names:
        check_estimator(name, scenario)
    numbers = _numbers(seeds)
    if jobs is not None and jobs < 1:
        raise ValueError(f"jobs must be at least 1, got {jobs}.")
    if keep and out is None:
        raise ValueError("keep needs a folder: give out.")
    fmu_paths(scenario)  # built here once, not by several processes at the same time
    tasks = [
        Task(name, seed, str(out / f"{name.replace(':', '.')}-{seed}") if keep and out is not None else None)
        for seed in numbers
        for name in names
    ]
    jobs = min(jobs or os.cpu_count() or 1, len(tasks))
    with new_locked_folder(scenario.scenario.name, out) if out is not None else nullcontext():
        records = _all_records(scenario, tasks, jobs, out, progress)
        ordered = tuple(records[name, seed] for name in names for seed in numbers)
        comparison = Comparison(scenario, names, numbers, ordered, jobs, folder=out)
        if out is not None:
            comparison.write(out)
    return comparison


def usable(scenario: Scenario) -> list[str]:
    """Return the estimators of the package that this scenario and the installed packages allow."""

    def is_usable(name: str) -> bool:
        try:
            check_estimator(name, scenario)
        except ScenarioError:
            return False
        return True

    return [name for name in METHODS if is_usable(name)]


def _numbers(seeds: int | Sequence[int]) -> tuple[int, ...]:
    numbers = tuple(range(seeds)) if isinstance(seeds, int) else tuple(seeds)
    if not numbers or min(numbers) < 0 or len(set(numbers)) < len(numbers):
        raise ValueError(f"seeds must be a count from 1 on, or different whole numbers from 0 on, got {seeds!r}.")
    return numbers


def _all_records(
    scenario: Scenario, tasks: Sequence[Task], jobs: int, out: Path | None, progress: RunsProgress | None
) -> dict[tuple[str, int], dict[str, Any]]:
    """Return the record of each task; each is appended to the file as its run ends."""
    records: dict[tuple[str, int], dict[str, Any]] = {}
    with Executor(scenario, tasks, jobs) as executor:
        for _ in tasks:
            try:
                task, record = executor.next()
            except ExecutorError as e:
                if out is None or not records:
                    raise
                raise type(e)(
                    f"{e} {len(records)} of {len(tasks)} runs have ended and are told in {out / RUNS}."
                ) from e
            records[task.estimator, task.seed] = record
            if out is not None:
                _append(out / RUNS, record)
            if progress is not None:
                progress(record, len(records), len(tasks))
    return records


def _append(path: Path, record: Mapping[str, Any]) -> None:
    try:
        with open(path, "a", encoding="utf-8") as file:
            file.write(to_json(record) + "\n")
    except OSError as e:
        raise FolderError(f"cannot write {path}: {e.strerror or e}.") from e
