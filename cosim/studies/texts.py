"""A study's summary as text: for a terminal and in Markdown, with the line that repeats each of the worst runs."""

import shlex
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from ..text_table import aligned, counted
from .design import StudyPoint
from .plan import Study
from .sensitivity import allows_sensitivity, has_salib, sensitivities
from .summary import ALIKE, StudySummary

WIDTH: Final = 120
"""Characters of a line on the terminal, but for those that are to be copied."""
_HEADER: Final = (
    "estimator", "runs", "done", "diverged", "faulted", "mse: median", "95 %", "worst", "times nominal", "better",
    "worse",
)  # fmt: skip


def to_terminal(study: Study, summary: StudySummary) -> str:
    """Return the summary as text for a terminal."""
    parts = [_title(study, summary)]
    for scenario, rows in _tables(summary):
        parts.append("\n".join([scenario, *aligned((_HEADER, *rows))]))
    notes = "\n".join(textwrap.fill(note, WIDTH, subsequent_indent="  ") for note in _notes(summary))
    return "\n\n".join([*parts, notes, *map("\n".join, _sensitivity_texts(study, summary)), *_worst(study, summary)])


def to_markdown(study: Study, summary: StudySummary, pictures: Sequence[str] = ()) -> str:
    """Return the summary as a Markdown document; pictures: file names."""
    parts = [f"# {study.definition.study.name}", _title(study, summary)]
    for scenario, rows in _tables(summary):
        rule = ("---", *["---:"] * (len(_HEADER) - 1))
        parts += [f"## {scenario}", "\n".join("| " + " | ".join(row) + " |" for row in (_HEADER, rule, *rows))]
    parts += ["\n".join(f"- {note}" for note in _notes(summary))]
    for title, *lines in _sensitivity_texts(study, summary):
        parts += [f"## {title}", "```\n" + "\n".join(lines) + "\n```"] if lines else [title]
    parts += [f"![{name.removesuffix('.png')}]({name})" for name in pictures]
    if worst := _worst(study, summary):
        heading, *lines = worst[0].splitlines()
        parts += [f"## {heading}", "```sh\n" + "\n".join(line.strip() for line in lines) + "\n```"]
    return "\n\n".join(parts) + "\n"


def repeating_lines(study: Study, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the command that repeats the run of each row: its scenario, settings, estimator and seed."""
    wanted = {int(row["point"]) for row in rows}
    found = {place: at for place, at in enumerate(study.places()) if place in wanted}
    return [_line(study, *found[int(row["point"])], row) for row in rows]


def _line(study: Study, source: int, point: StudyPoint, row: Mapping[str, Any]) -> str:
    settings = [word for key, value in point.settings.items() for word in ("--set", f"{key}={value}")]
    words = ["retune", "run", study.labels[source], "--only", "--estimator", row["estimator"], "--seed", row["seed"]]
    return shlex.join([*map(str, words), *settings])


def _title(study: Study, summary: StudySummary) -> str:
    n = len(summary.columns["status"])
    waiting = int(np.isin(summary.columns["status"], ("queued", "leased")).sum())
    factors = ", ".join(study.definition.factor_names) or "no factor"
    left = f"; {waiting} of them still to be made" if waiting else ""
    return f"{counted(n, 'run')} over {factors} and {counted(len(study.definition.seed_numbers), 'seed')}{left}"


def _tables(summary: StudySummary) -> list[tuple[str, list[tuple[str, ...]]]]:
    tables: dict[str, list[tuple[str, ...]]] = {}
    for row in summary.rows():
        counts = [str(row.statuses.get(status, 0)) for status in ("done", "diverged", "faulted")]
        figures = [_number(value) for value in (*row.mse, row.ratio)]
        cells = (row.estimator, str(sum(row.statuses.values())), *counts, *figures, str(row.better), str(row.worse))
        tables.setdefault(row.scenario, []).append(cells)
    return list(tables.items())


def _notes(summary: StudySummary) -> list[str]:
    notes = [
        "mse: mean squared tracking error of the runs that are done, summed over the outputs.",
        f"better, worse: runs whose mse is more than {ALIKE:.0%} below or above that of the nominal controller at the "
        "same point with the same seed, or of which only one is done; in brackets 95 % intervals (Clopper-Pearson).",
    ]
    for status, text in (("refused", "refused"), ("lost", "lost: each time the worker died")):
        if n := int((summary.columns["status"] == status).sum()):
            runs = f"{counted(n, 'run')} {'was' if n == 1 else 'were'}"
            notes.append(f"{runs} {text}; the column error of results.parquet says why.")
    return notes


def _sensitivity_texts(study: Study, summary: StudySummary) -> list[list[str]]:
    """Return a title and lines on the sensitivity to the factors; nothing where the design does not allow it."""
    if not allows_sensitivity(study.definition):
        return []
    if not has_salib():
        return [["Sensitivities to the factors: pip install 'fmu-retune[sensitivity]'."]]
    found = sensitivities(study.definition, summary)
    rows = [(f"{s.scenario}, {s.estimator}", s.factor, f"{s.first_order:.2f} ± {s.half_width:.2f}") for s in found]
    title = "part of the variance of log(times nominal) that a factor explains alone"
    return [[title, *aligned(rows)]] if rows else []


def _worst(study: Study, summary: StudySummary) -> list[str]:
    worst = summary.worst()
    if not worst:
        return []
    rows = [{name: column[k] for name, column in summary.columns.items()} for k in worst]
    lines = [f"  {line}" for line in repeating_lines(study, rows)]
    return ["\n".join(["the worst runs, each with the line that repeats it", *lines])]


def _number(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.3g}"
