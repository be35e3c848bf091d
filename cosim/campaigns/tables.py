"""Tables of a comparison: for a terminal, as Markdown, as CSV."""

import csv
import io
import math
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from ..runs.diagnosis_report import resting
from ..text_table import aligned, counted
from .figures import ComparisonFigures

WIDTH: Final = 120
"""Characters of a line on the terminal."""

Cell = Callable[[Mapping[str, Any]], str]
"""Text of one column, from an estimator's figures."""


@dataclass(frozen=True)
class Block:
    """A table: a title, a header, and rows that begin with a name."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def to_terminal(comparison: ComparisonFigures) -> str:
    """Return the tables as text at most 120 characters wide."""
    parts = [_wrapped(_title(comparison)) + "\n" + _wrapped(_subtitle(comparison))]
    parts += [_aligned(piece) for block in blocks(comparison) for piece in _folded(block)]
    parts += ["\n".join(map(_wrapped, notes(comparison)))]
    return "\n\n".join(parts + ([f"written to {comparison.folder}"] if comparison.folder else []))


def to_markdown(comparison: ComparisonFigures) -> str:
    """Return the tables as a Markdown document."""
    parts = [f"# {_title(comparison)}", _subtitle(comparison)]
    for block in blocks(comparison):
        rule = ["---", *["---:"] * (len(block.header) - 1)]
        parts.append("\n".join([f"## {block.title}", "", *map(_piped, (block.header, rule, *block.rows))]))
    return "\n\n".join([*parts, "\n".join(f"- {note}" for note in notes(comparison))]) + "\n"


def to_csv(rows: Iterable[Mapping[str, Any]]) -> str:
    """Return rows of equal keys as CSV under a header, with empty cells for missing values."""
    text = io.StringIO(newline="")
    table = list(rows)
    writer = csv.writer(text)
    writer.writerow(table[0])
    writer.writerows([_cell(v) for v in row.values()] for row in table)
    return text.getvalue()


def estimator_columns(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return an estimator's figures as flat columns."""
    figures = {f"mse {output}": f for output, f in row["mse"].items()} | {"ratio": row["ratio"]}
    for at in row["parameter_errors"]:
        figures |= {f"error {label} at {at['t']:g} s": f for label, f in at["errors"].items()}
    figures |= {key: row[key] for key in ("evaluations", "model_calls")}
    columns = {key: row[key] for key in ("estimator", "runs")}
    columns |= {f"{name} {key}": f[key] for name, f in figures.items() for key in ("median", "worst", "n")}
    columns |= {f"latency_ms {key}": row["latency_ms"][key] for key in ("p50", "p99", "n")}
    columns |= {key: row[key] for key in ("missed_deadlines", "steps_with_evaluations")}
    for status in ("diverged", "faulted"):
        times = (f"{r['seed']}: {_time(r['t'])}" for r in row[status])
        columns |= {status: len(row[status]), f"{status} seeds and times": "; ".join(times) or None}
    return columns


def run_columns(comparison: ComparisonFigures, record: Mapping[str, Any]) -> dict[str, Any]:
    """Return a run's figures as flat columns."""
    columns = {key: record[key] for key in ("estimator", "seed", "status", "end", "error")}
    columns |= {f"mse {output}": mse for output, mse in zip(comparison.scenario.tracking, record["mse"], strict=True)}
    columns |= {"max_error": record["max_error"], "ratio": comparison.ratio(record)}
    for t in comparison.instants:
        for label, names in comparison.groups.items():
            columns[f"error {label} at {t:g} s"] = comparison.parameter_error(record, t, names)
    columns |= {key: record[key] for key in ("evaluations", "model_calls", "episodes")}
    columns |= {f"latency_ms {key}": record["latency_ms"][key] for key in ("p50", "p99", "max")}
    return columns | {key: record[key] for key in ("missed_deadlines", "wall_s")}


def blocks(comparison: ComparisonFigures) -> list[Block]:
    """Return the tables of tracking errors (not for a replay), parameter errors at the instants, and cost."""
    rows, n = comparison.rows(), len(comparison.seeds)

    def block(title: str, columns: Mapping[str, Cell]) -> Block:
        cells = tuple((row["estimator"], *(cell(row) for cell in columns.values())) for row in rows)
        return Block(title, ("estimator", *columns), cells)

    def error_of(label: str) -> dict[str, Cell]:
        return {
            f"t = {t:g} s": lambda r, i=i: _told(r["parameter_errors"][i]["errors"][label], n)
            for i, t in enumerate(comparison.instants)
        }

    tracking: dict[str, Cell] = {
        name: lambda r, name=name: _told(r["mse"][name], n) for name in comparison.scenario.tracking
    }
    ratio: dict[str, Cell] = {"times the floor": lambda r: _told(r["ratio"], n)}
    cost: dict[str, Cell] = {
        "evaluations, median": lambda r: _number(r["evaluations"]["median"], ".0f"),
        "model calls": lambda r: _number(r["model_calls"]["median"], ".0f"),
        "latency p50 [ms]": lambda r: _number(r["latency_ms"]["p50"]),
        "p99 [ms]": lambda r: _number(r["latency_ms"]["p99"]),
        "missed deadlines": lambda r: f"{r['missed_deadlines']} of {r['steps_with_evaluations']}",
    }
    endings: dict[str, Cell] = {
        "diverged": lambda r: str(len(r["diverged"])),
        "faulted": lambda r: str(len(r["faulted"])),
    }
    deadline = f"deadline {1e3 * comparison.scenario.scenario.macro_step:g} ms"
    errors = [block(f"error of {label}, median / worst", error_of(label)) for label in comparison.groups]
    if comparison.is_open_loop:
        return [*errors, block(f"cost; {deadline}", cost)]
    closed = block("mean squared tracking error, median / worst", tracking | ratio)
    return [closed, *errors, block(f"cost; {deadline}", cost | endings)]


def notes(comparison: ComparisonFigures) -> list[str]:
    """Return notes to the tables, a line each: runs that did not finish, and the effect of jobs on latencies."""
    runs, cpus = comparison.runs, comparison.cpus
    notes = [f"{r['estimator']}, seed {r['seed']}: {_ending(r)}" for r in runs if r["status"] != "done"]
    if notes:
        notes.append(
            "A run that did not finish counts with the rows it has; (k) is the number of runs behind a cell, where "
            "that is not all of them."
        )
    if comparison.is_open_loop:
        notes += [*dict.fromkeys(f"Candidates are judged by {r['objective']}." for r in runs if r["objective"])]
        notes += [f"{r['estimator']}: {'; '.join(lines)}." for r in runs if (lines := _in_vain(r))]
    if not comparison.is_open_loop and any(comparison.ratio(r) is None for r in runs if r["estimator"] == "true"):
        notes.append(
            "With some seeds the floor is zero to within rounding, or has no rows: there is no ratio to it then."
        )
    if comparison.jobs == 1:
        return [*notes, f"Latencies are those of one run at a time, on {counted(cpus, 'processor')}."]
    return [
        *notes,
        f"With {comparison.jobs} runs at a time on {counted(cpus, 'processor')}, latencies and missed deadlines are "
        "greater than those of a single run; measure them with --jobs 1.",
    ]


def _in_vain(record: Mapping[str, Any]) -> list[str]:
    """Return what a replay's diagnosis has found no explanation for, and which channels rest for it at the end."""
    found = record["diagnosis"]
    if not found or not found["unexplained"]:
        return []
    return [f"failed searches: {found['unexplained']}, no parameters explain the samples", *resting(found)]


def _title(comparison: ComparisonFigures) -> str:
    return comparison.scenario.scenario.title


def _subtitle(comparison: ComparisonFigures) -> str:
    settings, numbers = comparison.scenario.scenario, comparison.seeds
    seeds = ", ".join(map(str, numbers))
    if comparison.is_open_loop:
        return f"samples recorded up to t = {comparison.runs[0]['end']:g} s, replayed; search with seed {seeds}"
    if numbers == tuple(range(len(numbers))) and len(numbers) > 2:
        seeds = f"0 to {len(numbers) - 1}"
    plural = "s" if len(numbers) > 1 else ""
    return f"{settings.stop_time - settings.start_time:g} s simulated with each estimator and seed{plural} {seeds}"


def _ending(record: Mapping[str, Any]) -> str:
    """Return the status, time and reason of a run that did not finish."""
    when = f" at t = {record['end']:.3f} s" if record["end"] is not None else " before its first row"
    return record["status"] + when + (f": {record['error']}" if record["error"] else "")


def _number(value: float | None, form: str = ".3g") -> str:
    return "-" if value is None else f"{value:{form}}"


def _told(figure: Mapping[str, Any], n_runs: int) -> str:
    """Return `median / worst`, followed by the number of runs in brackets where it is not all."""
    if not figure["n"]:
        return "-"
    of = f" ({figure['n']})" if figure["n"] < n_runs else ""
    return f"{_number(figure['median'])} / {_number(figure['worst'])}{of}"


def _time(t: float | None) -> str:
    return "no rows" if t is None else f"{t:.3f} s"


def _cell(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _piped(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _wrapped(text: str) -> str:
    return "\n".join(textwrap.wrap(text, WIDTH, subsequent_indent="  "))


def _widths(block: Block) -> list[int]:
    return [max(map(len, column)) for column in zip(block.header, *block.rows, strict=True)]


def _folded(block: Block) -> Iterator[Block]:
    """Yield the block in pieces that fit the terminal, each with the first column."""
    first, *others = _widths(block)
    pieces: list[list[int]] = [[]]
    room = WIDTH - first
    for i, width in enumerate(others, start=1):
        if pieces[-1] and room < width + 2:
            pieces.append([])
            room = WIDTH - first
        pieces[-1].append(i)
        room -= width + 2
    for number, columns in enumerate(pieces):
        chosen = [0, *columns]
        rows = tuple(tuple(row[i] for i in chosen) for row in block.rows)
        title = block.title if not number else f"{block.title} (continued)"
        yield Block(title, tuple(block.header[i] for i in chosen), rows)


def _aligned(block: Block) -> str:
    return "\n".join([block.title, *aligned((block.header, *block.rows))])
