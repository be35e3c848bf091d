"""Plants that no scenario of the package has, with what their models do not know: is a loop worse for being re-tuned?

    python -m benchmarks.foreign [--plants ball ...] [--cases gust ...] [--seeds N] [--first-seed K] [--jobs J]
                                 [--estimator target] [--objective filtered] [--out FILE.json] [--keep DIR] [--quick]

Twenty-two plants (foreign_plants) in twenty-four cases (foreign_cases), as `retune run` runs a scenario file.
A run is compared with the nominal controller's in the same case and, where parameters change, with that of a controller
which is told the true ones at once: the floor. These two do not depend on the seed, for the controller has the exact
states, and are run once. A run is lost when it is not done. A parameter's error is relative, the largest at the end
counts. Candidates are compared with derivatives, or, by --objective, with what `foreign_cases.OBJECTIVES` says.

The table has the mean squared error over the nominal controller's: the median and the worst of the seeds, and how many
runs were lost, `*` where the nominal controller's is lost as well. --keep leaves FMUs, scenarios and run folders in a
folder, for `retune run DIR/ball-gust.toml --seed 3` in the working directory of the benchmark.
"""

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import product
from math import isfinite, nan
from pathlib import Path
from shutil import rmtree
from statistics import median
from traceback import format_exc
from typing import Final

import cosim
from benchmarks import report
from benchmarks.foreign_cases import CASES, OBJECTIVES, write_reference, write_scenario
from benchmarks.foreign_fmus import PLANTS, build, plant_named
from benchmarks.report import Row
from cosim.files import write_text

KINDS: Final = ("disturbance", "lag", "friction", "unexplained", "rest", "undo", "revert", "stop")
"""Kinds of events that are counted beside episodes, writes and vetoes."""
QUICK: Final = (("ball", "servo", "boost", "ship"), ("none", "change", "gust", "lag"))


@dataclass(frozen=True)
class Task:
    """A run to make."""

    plant: str
    case: str
    seed: int
    estimator: str
    objective: str
    folder: Path
    """Folder of FMUs and scenarios."""
    is_kept: bool
    """True to leave the run's folder."""


def measured(task: Task) -> Row:
    """Return the figures of a run; one that raises an exception has its traceback as `error`."""
    begun = time.perf_counter()
    out = task.folder / "runs" / f"{task.plant}-{task.case}-{task.seed}-{task.estimator.replace(':', '.')}"
    row: Row = {"plant": task.plant, "case": task.case, "seed": task.seed, "estimator": task.estimator}
    rmtree(out, ignore_errors=True)
    try:
        run = cosim.run(_scenario(task), task.estimator, task.seed, out)
    except Exception:
        wall = time.perf_counter() - begun
        return row | {"status": "raised", "error": format_exc(), "mse": nan, "wall": wall} | _counts([])
    finally:
        events = _events(out)
        if not task.is_kept:
            rmtree(out, ignore_errors=True)
    truth = {name: float(values[-1]) for name, values in run.true_parameters.items() if len(values)}
    errors = [abs(float(run.estimates[name][-1]) / value - 1.0) for name, value in truth.items()]
    error = max(errors, default=nan)  # a run that fails at the start has none
    figures = {"status": run.status, "error": run.error, "mse": sum(run.mse), "parameter error": error}
    return row | figures | _counts(events) | {"wall": time.perf_counter() - begun}


def _scenario(task: Task) -> Path:
    return write_scenario(plant_named(task.plant), task.case, task.seed, task.objective, task.folder)


def _events(folder: Path) -> list[str]:
    """Return the kinds of the events of a run, one a time that it happened; none without a record."""
    path = folder / "events.jsonl"
    if not path.exists():
        return []
    return [json.loads(line)["kind"] for line in path.read_text(encoding="utf-8").splitlines()]


def _counts(kinds: Iterable[str]) -> Row:
    n = Counter(kinds)
    return {"episodes": n["trigger"], "writes": n["write"], "vetoes": n["veto"], **{kind: n[kind] for kind in KINDS}}


def references(plants: Sequence[str], cases: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    """Yield plant, case and estimator of the runs to compare with, once for all cases whose loops are the same."""
    for plant, case in dict.fromkeys((p, CASES[c].loop or c) for p, c in pairs(plants, cases)):
        yield plant, case, "none"
        if CASES[case].has_change:
            yield plant, case, "true"


def pairs(plants: Sequence[str], cases: Sequence[str]) -> list[tuple[str, str]]:
    """Return the plants with the cases that have a meaning for them."""
    return [(p, c) for p, c in product(plants, cases) if c not in plant_named(p).omitted]


def compared(row: Row, found: dict[tuple[str, str, str], Row]) -> Row:
    """Return a run's figures with those of the runs that it is compared with, by plant, case and estimator."""
    loop = CASES[row["case"]].loop or row["case"]
    nominal, floor = found[row["plant"], loop, "none"], found.get((row["plant"], loop, "true"))
    is_done = row["status"] == nominal["status"] == "done"
    return row | {
        "nominal mse": nominal["mse"],
        "floor mse": floor["mse"] if floor else nan,
        "ratio": row["mse"] / nominal["mse"] if is_done else nan,
        "lost": row["status"] != "done",
        "nominal lost": nominal["status"] != "done",
    }


def aggregated(runs: Sequence[Row]) -> list[Row]:
    """Return a row for each plant and case."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for run in runs:
        groups.setdefault((run["plant"], run["case"]), []).append(run)
    return [{"plant": plant, "case": case} | _figures(group) for (plant, case), group in groups.items()]


def _figures(runs: Sequence[Row]) -> Row:
    ratios = [r["ratio"] for r in runs if isfinite(r["ratio"])] or [nan]
    worst = max((r for r in runs if isfinite(r["ratio"])), key=lambda r: r["ratio"], default=None)
    errors = [r["parameter error"] for r in runs if "parameter error" in r] or [nan]
    first = runs[0]
    return {
        "runs": len(runs),
        "lost": sum(r["lost"] for r in runs),
        "nominal lost": first["nominal lost"],
        "nominal mse": first["nominal mse"],
        "floor ratio": first["floor mse"] / first["nominal mse"],
        "ratio": median(ratios),
        "worst": max(ratios),
        "worst seed": worst["seed"] if worst else None,
        "parameter error": median(errors),
        "largest parameter error": max(errors),
        **{k: sum(r[k] for r in runs) / len(runs) for k in ("episodes", "writes", "vetoes", *KINDS, "wall")},
    }


def table(rows: Sequence[Row]) -> str:
    """Return the ratios by case and plant, as text."""
    cells = {(r["case"], r["plant"]): _cell(r) for r in rows}
    plants, cases = (list(dict.fromkeys(r[key] for r in rows)) for key in ("plant", "case"))
    order = [case for case in CASES if case in cases]
    return report.table([{"case": c} | {p: cells.get((c, p), "-") for p in plants} for c in order])


def _cell(row: Row) -> str:
    figures = (row["ratio"], row["worst"])[: row["runs"]]  # of a single run they are the same
    both = " / ".join(f"{figure:.2g}" for figure in figures) if isfinite(row["ratio"]) else ""
    lost = f"{row['lost']} lost" if row["lost"] else ""
    return " ".join(filter(None, (both, lost, "*" if row["nominal lost"] else "")))


def main() -> int:
    """Make the runs, print the table, and write all of it where --out says; return 1 where one has raised."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", nargs="+", choices=PLANTS, default=None, metavar="PLANT", help=", ".join(PLANTS))
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=None, metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="number of seeds (default: 1)")
    parser.add_argument("--first-seed", type=int, default=0, metavar="K")
    parser.add_argument("--jobs", type=int, default=2, metavar="J", help="runs at a time; no figure depends on it")
    parser.add_argument("--estimator", default="target")
    parser.add_argument("--objective", choices=OBJECTIVES, default=OBJECTIVES[0])
    parser.add_argument("--out", type=Path, metavar="FILE", help="JSON file for aggregates and runs")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="folder for FMUs, scenarios and run folders")
    parser.add_argument("--quick", action="store_true", help="four plants and four cases, unless they are given")
    options = parser.parse_args()
    plants = options.plants or (QUICK[0] if options.quick else PLANTS)
    cases = options.cases or (QUICK[1] if options.quick else list(CASES))
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    with nullcontext(options.keep) if options.keep else tempfile.TemporaryDirectory() as name:
        folder = Path(name).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        for plant in map(plant_named, plants):
            build(plant, folder)
            write_reference(plant, folder)
        common = (options.objective, folder, options.keep is not None)
        firsts = [Task(p, c, 0, e, *common) for p, c, e in references(plants, cases)]
        tasks = [Task(p, c, s, options.estimator, *common) for (p, c), s in product(pairs(plants, cases), seeds)]
        with ProcessPoolExecutor(options.jobs) as pool:
            found = {(r["plant"], r["case"], r["estimator"]): r for r in pool.map(measured, firsts)}
            runs = [compared(row, found) for row in pool.map(measured, tasks)]
    rows = aggregated(runs)
    print(table(rows))
    for run in [*found.values(), *runs]:
        if run["status"] in ("raised", "faulted"):
            print(f"\n{run['plant']} {run['case']} seed {run['seed']} {run['estimator']}: {run['error']}")
    walls = [run["wall"] for run in runs]
    print(f"\n{len(runs)} runs, {median(walls):.2g} s each in the median, {max(walls):.2g} s the longest")
    if options.out:
        content = {
            "benchmark": "foreign",
            "machine": report.machine(),
            "estimator": options.estimator,
            "objective": options.objective,
        }
        write_text(
            options.out, report.to_lines(content | {"rows": rows, "references": [*found.values()], "runs": runs})
        )
    return int(any(run["status"] == "raised" for run in [*found.values(), *runs]))


if __name__ == "__main__":
    sys.exit(main())
