"""Tables of benchmarks/README.md, from the figures that the benchmarks have kept in results/.

python -m benchmarks.readme      # after a benchmark: puts its figures in place of those in the README
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

from benchmarks.report import RESULTS, Row, cell, replaced, stored
from cosim.files import write_text

README: Final = Path(__file__).parent / "README.md"
_ESTIMATORS: Final = ("target", "least-squares", "ukf", "rls")
_HOW: Final = ("frozen", "end of episode", "instants")


def written(text: str, folder: Path = RESULTS) -> str:
    """Return the README with all tables made of a folder's results."""
    for name, made in TABLES.items():
        text = replaced(text, name, made(stored(folder, name)))
    return text


def _estimators(rows: Sequence[Row]) -> str:
    """Return a line for each method: time of a search and its errors, problem by problem."""

    def of(row: Row) -> str:
        errors = (row["m error [kg]"], row["J error [kg.m2]"] or row["l error [m]"])
        return f"{cell(row['time [ms]'])}, " + " / ".join(f"{error['median']:.2g}" for error in errors)

    problems = ("quadrotor-sample", "quadrotor-window", "pendulum")
    header = (
        "method",
        *("one sample: time, m [kg] / J [kg m²]", "window: time, m / J", "pendulum: time, m [kg] / l [m]"),
    )
    names = {row["method"]: row["method"] if row["version"] == _own(rows) else f"{row['method']} {row['version']}"
             for row in rows}  # fmt: skip
    known = {(row["method"], row["problem"]): of(row) for row in rows}
    return _table(header, ([name, *(known[method, p] for p in problems)] for method, name in names.items()))


def _own(rows: Sequence[Row]) -> str:
    return next(row["version"] for row in rows if row["method"] == "target")


def _horizon(rows: Sequence[Row]) -> str:
    """Return a line for each estimator: errors and times at both spreads, stream by stream."""
    known = {(r["estimator"], r["stream"], r["spread"]): r for r in rows}
    spreads = sorted({r["spread"] for r in rows})

    def of(estimator: str, stream: str) -> list[str]:
        of_spreads = [known[estimator, stream, spread] for spread in spreads if (estimator, stream, spread) in known]
        errors = " / ".join(f"{r['median error']:.2g}" for r in of_spreads)
        return [errors, ", ".join(f"{r['ms a sample']['median']:.2g}" for r in of_spreads)]

    text = " / ".join(f"{spread:g}" for spread in spreads)
    header = ("estimator", f"pendulum, spread {text}: error", "ms a sample", f"quadrotor, {text}: error", "ms a sample")
    estimators = dict.fromkeys(r["estimator"] for r in rows)
    return _table(header, ([name, *of(name, "pendulum"), *of(name, "quadrotor")] for name in estimators))


def _masses(rows: Sequence[Row]) -> str:
    lines = ([r["estimator"], cell(r["error"]), f"{r['worst']:.2g}", cell(r["ms a sample"])] for r in rows)
    return _table(("estimator", "error", "worst", "ms a sample"), lines)


def _coverage(rows: Sequence[Row]) -> str:
    rows = sorted(rows, key=lambda r: (_ESTIMATORS.index(r["estimator"]), _HOW.index(r["how"])))
    counts = ("seeds", "intervals", "not identifiable")
    shares = ("covered", "rms", "least", "nothing held")
    lines = (
        [r["estimator"], r["how"].replace("end of episode", "episodes"), r["scenario"],
         *(f"{r[key]:,}" for key in counts), *(f"{r[k]:.2g}" if k == "rms" else r[k] for k in shares)]
        for r in rows
    )  # fmt: skip
    return _table(("estimator", "how", "scenario", *counts, *shares), lines)


def _limit(rows: Sequence[Row]) -> str:
    """Return a line for each scenario: `target` at its instants after a change."""
    found = {
        scenario: ", ".join(
            f"{r['instant']}: {r['rms error / bound']:.2f} ({r['median']:.2f}, {r['worst']:.1f})"
            for r in rows
            if (r["scenario"], r["estimator"]) == (scenario, "target") and r["instant"] != "all" and r["worst"] > 0.0
        )
        for scenario in dict.fromkeys(r["scenario"] for r in rows)
    }
    header = ("scenario", "at the instants after a change: error by bound (median, largest)")
    return _table(header, [*found.items()])


def _writes(rows: Sequence[Row]) -> str:
    counts = ("moves", "worse by a fifth", "by 0.001 of the truth", "by 0.01", "by 0.2")
    lines = (
        [r["scenario"], r["estimator"], str(r["seeds"]), *(f"{r[key]:,}" for key in counts), f"{r['largest']:.2g}"]
        for r in rows
    )
    return _table(("scenario", "estimator", "seeds", *counts, "largest"), lines)


def _master(rows: Sequence[Row]) -> str:
    masters = tuple(dict.fromkeys(r["master"] for r in rows))
    known = {(r["system"], r["master"]): cell(r.get("us a macro step")) or "-" for r in rows}
    systems = dict.fromkeys(r["system"] for r in rows)
    return _table(("us a macro step", *masters), ([s, *(known[s, m] for m in masters)] for s in systems))


def _fmus(rows: Sequence[Row]) -> str:
    return _table(("quadrotor, a step of 10 ms", "us"), ([r["way"], cell(r["us a step"])] for r in rows))


def _run(rows: Sequence[Row]) -> str:
    lines = ([r["part"], cell(r["s"]), cell(r["times real time"])] for r in rows)
    return _table(("part of a run of 16 s", "s", "times real time"), lines)


def _real_time(rows: Sequence[Row]) -> str:
    figures = ("target, times real time", "reach", "none, times real time", "target by none", "at most")
    header = ("run", figures[0], "asked for", *figures[2:4], "asked for")
    return _table(header, ([r["run"], *(cell(r.get(key, "")) for key in figures)] for r in rows))


def _parts(rows: Sequence[Row]) -> str:
    """Return a line for each part, with its share of each run, the largest of the first run first."""
    shares = {(r["part"], r["run"]): f"{r['share']:.1%}".replace("%", " %") for r in rows}
    runs, names = (tuple(dict.fromkeys(r[key] for r in rows)) for key in ("run", "part"))
    return _table(("part of a guarded run", *runs), ([n, *(shares.get((n, run), "") for run in runs)] for n in names))


def _startup(rows: Sequence[Row]) -> str:
    lines = ([r["from process start to"], cell(r["s"]), cell(r["reach"])] for r in rows)
    return _table(("from the start of the process to", "s", "asked for"), lines)


TABLES: Final[Mapping[str, Callable[[Sequence[Row]], str]]] = {
    "estimators": _estimators, "horizon": _horizon, "oscillating_masses": _masses, "coverage": _coverage,
    "limit": _limit, "writes": _writes, "master": _master, "fmus": _fmus, "run": _run, "real_time": _real_time,
    "real_time_parts": _parts, "startup": _startup,
}  # fmt: skip
"""Function that makes the table of each benchmark's rows, by the name of both."""


def _table(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    rows = [header, ["---"] * len(header), *lines]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


if __name__ == "__main__":
    write_text(README, written(README.read_text(encoding="utf-8")))
