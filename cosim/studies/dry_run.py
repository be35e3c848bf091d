"""The dry run of a study: how many runs it has, how long they take and how much disk, from a few that are made."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Final

from ..errors import one_line
from ..files import to_json
from ..runs.simulation import run
from ..text_table import counted
from .engines import jobs_here
from .plan import PlannedRun, Study
from .row import row_of

LONGEST_S: Final = 60.0
"""Time after which no other run is begun."""
_OF_A_ROW: Final = 3
"""Ratio of what a run takes in ledger and table to the text of its row: keys, point, index, free pages."""


def dry_run(study: Study, runs: Mapping[str, PlannedRun], jobs: int | None) -> str:
    """Return in words how many runs a study has, how long they would take here and how much disk.

    One run of each scenario and estimator is made, in this process, until that takes a minute.
    """
    jobs = jobs_here(jobs, len(runs))
    first: dict[tuple[int, str], PlannedRun] = {}
    for planned in runs.values():
        first.setdefault((planned.source, planned.estimator), planned)
    n_like = Counter((planned.source, planned.estimator) for planned in runs.values())
    begun, times, sizes = perf_counter(), list[float](), list[int]()
    failed = list[str]()
    with TemporaryDirectory() as folder:
        for k, planned in enumerate(first.values()):
            if times and perf_counter() - begun > LONGEST_S:
                break
            place = Path(folder) / str(k) if study.definition.study.keep else None
            before = perf_counter()
            made = run(study.scenario_at(planned.source, planned.point), planned.estimator, planned.seed, place)
            times.append(perf_counter() - before)
            if made.status != "done":
                failed.append(
                    f"one with {planned.estimator}: {made.status}{', ' if made.error else ''}{made.error or ''}"
                )
            kept = sum(p.stat().st_size for p in place.iterdir()) if place is not None else 0
            sizes.append(kept + _OF_A_ROW * len(to_json(study.point_of(planned) | row_of(made))))
    seconds, size = (of_all(made, [n_like[of] for of in first]) for made in (times, sizes))
    n_points = len({planned.place for planned in runs.values()})
    return "\n".join(
        [
            f"{counted(len(runs), 'run')}: {counted(n_points, 'point')}, "
            f"{counted(len(study.definition.estimators), 'estimator')}, "
            f"{counted(len(study.definition.seed_numbers), 'seed')}",
            f"about {_duration(seconds / jobs)} with {counted(jobs, 'run')} at a time: "
            f"{min(times):.2g} to {max(times):.2g} s each, by {counted(len(times), 'run')} made now",
            f"about {_size(size)} on the disk" + (", run folders included" if study.definition.study.keep else ""),
            *map(one_line, failed),
        ]
    )


def of_all(made: Sequence[float], numbers: Sequence[int]) -> float:
    """Return the sum over all runs, from that of the runs made and the numbers of runs like each.

    Those of which none was made count as the mean of the others.
    """
    known = [value * n for value, n in zip(made, numbers, strict=False)]
    return sum(known) + sum(made) / len(made) * sum(numbers[len(made) :])


def _duration(seconds: float) -> str:
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.2g} {unit}"
    return f"{seconds:.2g} seconds"


def _size(n_bytes: float) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6)):
        if n_bytes >= size:
            return f"{n_bytes / size:.2g} {unit}"
    return f"{n_bytes / 1e3:.2g} kB"
