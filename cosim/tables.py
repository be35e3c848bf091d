"""What a comparison of estimators came to: figures over seeds, and tables for terminal, CSV, Markdown and JSON."""

import csv
import io
import math
import os.path
import platform
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np

from .record import to_json, write_text
from .result import PACKAGES
from .scenario import Scenario

WIDTH: Final = 120
"""Characters of a line on the terminal."""
ROUNDING: Final = 1e-18
"""A floor's mean squared error below this part of the reference's mean square is rounding; nothing is divided by it."""

Record = Mapping[str, Any]
"""A run's summary with `end` [s], `reference_mean_square` and `latencies_ms`, as `crew.record_of` makes it."""
Figure = Mapping[str, Any]
"""Median and worst (largest) of a number over the runs that have it, and how many those are: median, worst, n."""


@dataclass(frozen=True)
class Block:
    """A table: a title, a header, and rows that begin with a name."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Comparison:
    """Runs of several estimators with the same seeds, and their figures."""

    scenario: Scenario
    """What was run."""
    estimators: tuple[str, ...]
    """Who re-tuned, in the order of the rows: `none` and `true` first."""
    seeds: tuple[int, ...]
    """Of noise and search."""
    runs: tuple[Record, ...]
    """A record a run, by estimator, then by seed; none is left out, however it ended."""
    jobs: int
    """Runs at a time."""
    cpus: int
    """Processors of the machine."""
    folder: Path | None = None
    """Where all of it is written, if anywhere."""

    @property
    def groups(self) -> dict[str, tuple[str, ...]]:
        """Estimated parameters of the same unit, by label: `m [kg]`, `J [kg.m2]`."""
        by_unit: dict[str, list[str]] = {}
        for p in self.scenario.estimation.parameters:
            by_unit.setdefault(p.unit, []).append(p.name)
        return {f"{_common_name(names)} [{unit}]": tuple(names) for unit, names in by_unit.items()}

    @property
    def instants(self) -> tuple[float, ...]:
        """Times [s] at which parameters are compared: the scenario's, or the end where it has none in the run."""
        stop = self.scenario.scenario.stop_time
        return tuple(t for t in self.scenario.estimation.instants if t <= stop + 1e-9) or (stop,)

    def rows(self) -> list[dict[str, Any]]:
        """The figures of each estimator over all seeds, in the order of the estimators."""
        return [self._row(name, [r for r in self.runs if r["estimator"] == name]) for name in self.estimators]

    def ratio(self, record: Record) -> float | None:
        """The run's sum of mean squared errors over that of the true parameters with the same seed.

        None where either has no rows, or where the floor is zero but for rounding.
        """
        floor = next((r for r in self.runs if r["estimator"] == "true" and r["seed"] == record["seed"]), None)
        if floor is None or not _are_finite([*floor["mse"], *floor["reference_mean_square"], *record["mse"]]):
            return None
        least = sum(floor["mse"])
        return sum(record["mse"]) / least if least > ROUNDING * sum(floor["reference_mean_square"]) else None

    def parameter_error(self, record: Record, t: float, names: Sequence[str]) -> float | None:
        """Euclidean norm of estimated minus true at t [s], in the parameters' unit; None after the run's end."""
        at = {i["t"]: i["parameters"] for i in record["instants"]}
        if t == self.scenario.scenario.stop_time and record["status"] == "done":
            at.setdefault(t, record["parameters"])
        held = at.get(t)
        return math.hypot(*(p["estimated"] - p["true"] for p in held if p["name"] in names)) if held else None

    def summary(self) -> dict[str, Any]:
        """Everything as JSON values; times ending in _ms are wall times in ms, others in s."""
        settings = self.scenario.scenario
        return {
            "scenario": settings.name,
            "seeds": list(self.seeds),
            "jobs": self.jobs,
            "cpus": self.cpus,
            "deadline_ms": 1e3 * settings.macro_step,
            "estimators": self.rows(),
            "runs": [{k: v for k, v in r.items() if k != "latencies_ms"} for r in self.runs],
            "settings": self.scenario.model_dump(mode="json"),
            "versions": {"python": platform.python_version()} | {name: version(name) for name in PACKAGES},
            "folder": str(self.folder) if self.folder else None,
        }

    def to_json(self, indent: int | None = None) -> str:
        """One JSON object; null for what there is not."""
        return to_json(self.summary(), indent)

    def to_csv_rows(self) -> list[list[Any]]:
        """A header, and a row an estimator; an empty cell for what there is not."""
        rows = [dict(_flat(row)) for row in self.rows()]
        return [list(rows[0]), *([_cell(v) for v in row.values()] for row in rows)]

    def to_run_rows(self) -> list[list[Any]]:
        """A header, and a row a run, however it ended."""
        rows = [dict(self._flat_run(r)) for r in self.runs]
        return [list(rows[0]), *([_cell(v) for v in row.values()] for row in rows)]

    def to_markdown(self) -> str:
        """The tables as Markdown."""
        parts = [f"# {self._title()}", self._subtitle()]
        for block in self.blocks():
            lines = [
                f"## {block.title}",
                "",
                _piped(block.header),
                _piped(["---", *["---:"] * (len(block.header) - 1)]),
            ]
            parts.append("\n".join([*lines, *map(_piped, block.rows)]))
        notes = [f"- {note}" for note in self.notes()]
        return "\n\n".join([*parts, *(["\n".join(notes)] if notes else [])]) + "\n"

    def table(self) -> str:
        """The tables for a terminal, at most 120 characters wide."""
        parts = [_wrapped(self._title()) + "\n" + _wrapped(self._subtitle())]
        parts += [_aligned(piece) for block in self.blocks() for piece in _folded(block)]
        parts += ["\n".join(map(_wrapped, notes))] if (notes := self.notes()) else []
        return "\n\n".join(parts + ([f"written to {self.folder}"] if self.folder else []))

    def write(self, folder: Path) -> None:
        """Write comparison.json, .md and .csv, and runs.csv. Raises FolderError."""
        write_text(folder / "comparison.json", self.to_json(indent=2) + "\n")
        write_text(folder / "comparison.md", self.to_markdown())
        write_text(folder / "comparison.csv", _csv(self.to_csv_rows()))
        write_text(folder / "runs.csv", _csv(self.to_run_rows()))

    def blocks(self) -> list[Block]:
        """Tracking errors, parameter errors at the instants, and cost."""
        rows, n = self.rows(), len(self.seeds)

        def block(title: str, columns: Mapping[str, Callable[[dict[str, Any]], str]]) -> Block:
            cells = tuple((row["estimator"], *(cell(row) for cell in columns.values())) for row in rows)
            return Block(title, ("estimator", *columns), cells)

        tracking = {name: (lambda r, name=name: _told(r["mse"][name], n)) for name in self.scenario.tracking}
        ratio = {"times the floor": lambda r: _told(r["ratio"], n)}
        cost: dict[str, Callable[[dict[str, Any]], str]] = {
            "evaluations, median": lambda r: f"{r['evaluations']['median']:g}",
            "latency p50 [ms]": lambda r: _number(r["latency_ms"]["p50"]),
            "p99 [ms]": lambda r: _number(r["latency_ms"]["p99"]),
            "missed deadlines": lambda r: f"{r['missed_deadlines']} of {r['steps_with_evaluations']}",
            "diverged": lambda r: str(len(r["diverged"])),
            "faulted": lambda r: str(len(r["faulted"])),
        }
        parameters = [
            block(
                f"error of {label}, median / worst",
                {
                    f"t = {t:g} s": (lambda r, i=i, label=label: _told(r["parameter_errors"][i]["errors"][label], n))
                    for i, t in enumerate(self.instants)
                },
            )
            for label in self.groups
        ]
        return [
            block("mean squared tracking error, median / worst", tracking | ratio),
            *parameters,
            block(f"cost; deadline {1e3 * self.scenario.scenario.macro_step:g} ms", cost),
        ]

    def notes(self) -> list[str]:
        """What a reader of the tables must know, in one line each: runs that did not finish, and how jobs disturb."""
        notes = [f"{r['estimator']}, seed {r['seed']}: {_ending(r)}" for r in self.runs if r["status"] != "done"]
        if any(r["status"] != "done" for r in self.runs):
            notes.append(
                "A run that did not finish counts with the rows that it has; (k) is the number of runs that a cell is "
                "from, where it is not all of them."
            )
        if not all(self.ratio(r) is not None for r in self.runs if r["estimator"] == "true"):
            notes.append("The floor is zero but for rounding, or has no rows, with some seeds: no ratio to it there.")
        if self.jobs == 1:
            return [*notes, f"Latencies are those of one run at a time, on {self.cpus} processors."]
        return [
            *notes,
            f"{self.jobs} runs at a time on {self.cpus} processors: wall times, so latencies and missed deadlines, "
            "are longer than alone; measure them with --jobs 1.",
        ]

    def _row(self, name: str, records: Sequence[Record]) -> dict[str, Any]:
        tracked = enumerate(self.scenario.tracking)
        latencies = [ms for r in records for step in r["latencies_ms"] for ms in step]
        p50, p99 = np.percentile(latencies, [50, 99]).tolist() if latencies else (None, None)
        unfinished = {
            status: [{"seed": r["seed"], "t": r["end"], "error": r["error"]} for r in records if r["status"] == status]
            for status in ("diverged", "faulted")
        }
        return {
            "estimator": name,
            "runs": len(records),
            "mse": {output: _figure(r["mse"][i] for r in records) for i, output in tracked},
            "ratio": _figure(map(self.ratio, records)),
            "parameter_errors": [
                {
                    "t": t,
                    "errors": {
                        label: _figure(self.parameter_error(r, t, names) for r in records)
                        for label, names in self.groups.items()
                    },
                }
                for t in self.instants
            ],
            "evaluations": _figure(r["evaluations"] for r in records),
            "latency_ms": {"p50": p50, "p99": p99, "n": len(latencies)},
            "missed_deadlines": sum(r["missed_deadlines"] for r in records),
            "steps_with_evaluations": sum(len(r["latencies_ms"]) for r in records),
            **unfinished,
        }

    def _flat_run(self, record: Record) -> Iterator[tuple[str, Any]]:
        yield from ((key, record[key]) for key in ("estimator", "seed", "status", "end", "error"))
        for i, output in enumerate(self.scenario.tracking):
            yield f"mse {output}", record["mse"][i]
        yield "max_error", record["max_error"]
        yield "ratio", self.ratio(record)
        for t in self.instants:
            for label, names in self.groups.items():
                yield f"error {label} at {t:g} s", self.parameter_error(record, t, names)
        yield from ((key, record[key]) for key in ("evaluations", "episodes"))
        yield from ((f"latency_ms {key}", record["latency_ms"][key]) for key in ("p50", "p99", "max"))
        yield from ((key, record[key]) for key in ("missed_deadlines", "wall_s"))

    def _title(self) -> str:
        settings = self.scenario.scenario
        return f"{settings.name}: {settings.description}" if settings.description else settings.name

    def _subtitle(self) -> str:
        settings = self.scenario.scenario
        seeds = ", ".join(map(str, self.seeds))
        if self.seeds == tuple(range(len(self.seeds))) and len(self.seeds) > 2:
            seeds = f"0 to {len(self.seeds) - 1}"
        plural = "s" if len(self.seeds) > 1 else ""
        return f"{settings.stop_time - settings.start_time:g} s simulated with each estimator and seed{plural} {seeds}"


def _figure(values: Iterable[float | None]) -> dict[str, Any]:
    """Median and largest of those that are finite numbers, and how many they are."""
    known = [float(v) for v in values if v is not None and math.isfinite(v)]
    return {"median": median(known) if known else None, "worst": max(known, default=None), "n": len(known)}


def _are_finite(values: Sequence[float | None]) -> bool:
    return all(v is not None and math.isfinite(v) for v in values)


def _common_name(names: Sequence[str]) -> str:
    """A name for several parameters: what they begin with, or all of them."""
    if len(names) == 1:
        return names[0]
    return os.path.commonprefix(list(names)).rstrip("_.") or ", ".join(names)  # noqa: RUF071  not a path


def _ending(record: Record) -> str:
    """How and when a run ended that did not finish."""
    when = f" at t = {record['end']:.3f} s" if record["end"] is not None else " before its first row"
    return record["status"] + when + (f": {record['error']}" if record["error"] else "")


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _told(figure: Figure, n_runs: int) -> str:
    """`median / worst`, and in brackets of how many runs if not of all."""
    if not figure["n"]:
        return "-"
    of = f" ({figure['n']})" if figure["n"] < n_runs else ""
    return f"{_number(figure['median'])} / {_number(figure['worst'])}{of}"


def _flat(row: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """A row's figures as column and value."""
    figures: dict[str, Figure] = {f"mse {output}": f for output, f in row["mse"].items()} | {"ratio": row["ratio"]}
    for at in row["parameter_errors"]:
        figures |= {f"error {label} at {at['t']:g} s": f for label, f in at["errors"].items()}
    figures |= {"evaluations": row["evaluations"]}
    yield from ((key, row[key]) for key in ("estimator", "runs"))
    for name, figure in figures.items():
        yield from ((f"{name} {key}", figure[key]) for key in ("median", "worst", "n"))
    yield from ((f"latency_ms {key}", row["latency_ms"][key]) for key in ("p50", "p99", "n"))
    yield from ((key, row[key]) for key in ("missed_deadlines", "steps_with_evaluations"))
    for status in ("diverged", "faulted"):
        yield status, len(row[status])
        times = (f"{r['seed']}: {_time(r['t'])}" for r in row[status])
        yield f"{status} seeds and times", "; ".join(times) or None


def _time(t: float | None) -> str:
    return "no rows" if t is None else f"{t:.3f} s"


def _cell(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _csv(rows: Sequence[Sequence[Any]]) -> str:
    text = io.StringIO(newline="")
    csv.writer(text).writerows(rows)
    return text.getvalue()


def _piped(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _wrapped(text: str) -> str:
    return "\n".join(textwrap.wrap(text, WIDTH, subsequent_indent="  "))


def _widths(block: Block) -> list[int]:
    return [max(map(len, column)) for column in zip(block.header, *block.rows, strict=True)]


def _folded(block: Block) -> Iterator[Block]:
    """The block in pieces that fit the terminal, each with the first column."""
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
    """The block's first column to the left, the others to the right."""
    widths = _widths(block)
    lines = [
        "  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))]).rstrip()
        for row in (block.header, *block.rows)
    ]
    return "\n".join([block.title, *lines])
