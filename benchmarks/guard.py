"""Benefit and cost of the guard: the tables of docs/safety.md from the runs of three studies.

    retune study benchmarks/studies/guard.toml --out OUT/guard          # and guard-filtered, guard-roll-outs
    python -m benchmarks.guard OUT/guard ... --commit HASH

A study may still be running, or have been stopped: what its ledger has is taken. Kept in results/guard.json is a row
for each scenario, case, estimator and objective, in place of earlier ones; the tables of docs/safety.md are written,
and the targets that are missed printed, each with the line that repeats the worst run. A run counts as lost when it is
not done although the nominal controller's is. `retune study --seeds 3` is quick; a study goes on where it was stopped.
"""

import argparse
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from math import nan
from pathlib import Path
from statistics import mean, median
from typing import Final

from benchmarks import report
from benchmarks.report import Row
from cosim.errors import CosimError
from cosim.files import write_text
from cosim.studies.folder import read_study
from cosim.studies.ledger import LEDGER, open_ledger
from cosim.studies.table import row_in_table
from cosim.studies.texts import repeating_lines

SCENARIOS: Final = ("pendulum", "quadrotor", "rigid-body", "stiction", "magnetic-levitation")
CASES: Final = {
    "quiet": "nothing at all",
    "named": "what the scenario does",
    "gust": "a force for a short time, as 1 - cos, and nothing else",
    "constant": "a constant force from some time on, and nothing else",
    "both": "the scenario's change and a constant force at once",
    "lag": "actuators with a lag, and nothing else",
    "friction": "dry friction, and nothing else",
    "drag": "viscous friction or drag, and nothing else",
    "other": "a parameter that is not estimated changes",
    "bounds": "the mass's upper bound is below the truth",
    "jump": "a second change of the plant inside the episode",
    "noise-small": "the declared noise is a tenth of the true",
    "noise-large": "the declared noise is 10 times the true",
    "dropout": "30 % of the samples not a number",
    "bias": "one sensor is biased",
    "spikes": "spikes on one sensor, in 5 % of the samples",
    "delay": "sensors 10 samples old, with a fresh time stamp",
    "sign": "sensors multiplied by -1",
    "late": "samples late by 5",
    "stuck": "sensors stuck since the change",
}
ESTIMATORS: Final = ("target", "ukf", "least-squares", "rls")
OBJECTIVES: Final = {"guard": "derivatives", "guard-filtered": "filtered", "guard-roll-outs": "roll-outs"}
"""What is judged, by the name of the study."""
SAFETY: Final = Path(__file__).parents[1] / "docs" / "safety.md"
_KEYS: Final = ("scenario", "case", "estimator", "objective")
_STILL: Final = ("lag", "friction", "drag", "quiet")
"""Cases in which there is nothing to re-tune."""


def runs_of(folder: Path) -> list[Row]:
    """Return the rows of the runs that have ended in a study's folder, each with its objective. Raises CosimError."""
    study, _ = read_study(folder)
    objective = {"objective": OBJECTIVES[study.definition.study.name]}
    with open_ledger(folder / LEDGER, is_read_only=True) as ledger:
        return [row_in_table(e) | objective for e in ledger.entries() if e.state in ("done", "failed")]


def rows(runs: Iterable[Row]) -> list[Row]:
    """Return a row for each scenario, case, estimator and objective that was run as well as its nominal controller.

    Its errors are those of the runs that are done.
    """
    nominal: dict[tuple[str, ...], Row] = {}
    groups: dict[tuple[str, ...], list[Row]] = {}
    for r in runs:
        if r["estimator"] == "none":
            nominal.setdefault((r["scenario"], r["case"], r["objective"]), r)
        else:
            groups.setdefault(tuple(r[key] for key in _KEYS), []).append(r)
    return [
        dict(zip(_KEYS, key, strict=True)) | _figures(groups[key], nominal[key[0], key[1], key[3]])
        for key in product(SCENARIOS, CASES, ESTIMATORS, OBJECTIVES.values())
        if key in groups and (key[0], key[1], key[3]) in nominal
    ]


def _figures(runs: Sequence[Row], nominal: Row) -> Row:
    done = [r for r in runs if r["status"] == "done"]
    ratios = [_ratio(r["mse"], nominal["mse"]) for r in done] or [nan]
    largest = [_ratio(r["largest error"], nominal["largest error"]) for r in done]
    firsts = [r["first write [s]"] for r in runs if r["first write [s]"] is not None]
    return {
        "runs": len(runs),
        "lost": len(runs) - len(done) if nominal["status"] == "done" else 0,
        "nominal mse": _short(nominal["mse"]),
        "mse ratio": _short(median(ratios)),
        "worst": _short(max(ratios)),
        "largest ratio": _short(max(largest, default=nan), 5),
        "named": _short(mean(bool(r["disturbances"]) for r in runs)),
        "episodes": _short(mean(r["triggers"] for r in runs)),
        "writes": _short(mean(r["writes"] for r in runs)),
        "first write": _short(median(firsts)) if firsts else None,
    }


def _short(value: float, digits: int = 4) -> float:
    return float(f"{value:.{digits}g}")


def _ratio(value: float, nominal: float) -> float:
    """Return the ratio; of two errors that are nothing but rounding, 1."""
    return (value + 1e-18) / (nominal + 1e-18)


def misses(row: Row) -> list[str]:
    """Return the targets that a row misses."""
    if row["lost"] == row["runs"]:
        return [f"{row['lost']} lost"]
    case, mse = row["case"], row["mse ratio"] * row["nominal mse"]
    is_disturbed = case in ("gust", "constant")
    most = {"bounds": 0.25, "bias": 0.15}.get(case) if row["scenario"] == "quadrotor" else None
    wanted = {
        f"{row['lost']} lost": row["lost"] == 0,
        f"median mse {row['mse ratio']:.3g} > 1.1 of nominal": not is_disturbed or row["mse ratio"] <= 1.1,
        f"worst mse {row['worst']:.3g} > 1.5 of nominal": not is_disturbed or row["worst"] <= 1.5,
        f"named in {row['named']:.0%} < 90 %": not is_disturbed or row["named"] >= 0.9,
        f"{row['episodes']:.3g} > 3 episodes": case not in _STILL or row["episodes"] <= 3.0,
        f"mse {mse:.3g} > {most}": most is None or mse <= most,
        f"largest error {row['largest ratio']:.4g} of nominal": row["largest ratio"] <= 1.001,  # rounded to 5 digits
    }
    return [miss for miss, is_met in wanted.items() if not is_met]


def markdown(rows: Sequence[Row]) -> str:
    """Return the tables of docs/safety.md: `target` on derivatives case by case, and the others in a line each."""
    lines = [
        "| scenario | case | runs | lost | nominal mean squared error | ratio to it: median / worst | largest error: "
        "ratio | disturbance named | episodes | writes |",
        "| --- | --- | ---: | ---: | ---: | --- | ---: | ---: | ---: | ---: |",
    ]
    for r in rows:
        if (r["estimator"], r["objective"]) == ("target", "derivatives"):
            ratios = f"{r['mse ratio']:.3g} / {r['worst']:.3g}"
            lines.append(
                f"| {r['scenario']} | {r['case']} | {r['runs']} | {r['lost']} | {r['nominal mse']:.3g} | {ratios} | "
                f"{r['largest ratio']:.3g} | {r['named']:.0%} | {r['episodes']:.3g} | {r['writes']:.3g} |"
            )
    lines += [
        "",
        "| estimator, objective | cells | runs | lost | only a disturbance: worst ratio | named | largest error: worst "
        "ratio, and where |",
        "| --- | ---: | ---: | ---: | ---: | ---: | --- |",
    ]
    for estimator, objective in dict.fromkeys((r["estimator"], r["objective"]) for r in rows):
        mine = [r for r in rows if (r["estimator"], r["objective"]) == (estimator, objective)]
        disturbed = [r for r in mine if r["case"] in ("gust", "constant")]
        known = [r for r in mine if r["largest ratio"] == r["largest ratio"]]
        worst = max(known, key=lambda r: r["largest ratio"], default=None)
        where = "" if worst is None else f"{worst['largest ratio']:.3g}, {worst['scenario']} {worst['case']}"
        ratio = max((r["worst"] for r in disturbed), default=nan)
        named = f"{mean(r['named'] for r in disturbed):.0%}" if disturbed else ""
        counts = f"{len(mine)} | {sum(r['runs'] for r in mine)} | {sum(r['lost'] for r in mine)}"
        lines.append(f"| {estimator}, {objective} | {counts} | {ratio:.3g} | {named} | {where} |")
    return "\n".join(lines)


def worst_lines(folder: Path, runs: Sequence[Row]) -> dict[tuple[str, ...], str]:
    """Return the command that repeats the worst run of each scenario, case, estimator and objective of a study."""
    worst: dict[tuple[str, ...], Row] = {}
    for r in sorted(runs, key=lambda r: (r["status"] == "done", -(r["mse"] or 0.0))):
        worst.setdefault(tuple(r[key] for key in _KEYS), r)
    return dict(zip(worst, repeating_lines(read_study(folder)[0], list(worst.values())), strict=True))


def in_order(rows: Iterable[Row]) -> list[Row]:
    """Return the rows in the order of the tables."""
    order: Mapping[tuple[str, ...], int] = {
        key: n for n, key in enumerate(product(SCENARIOS, CASES, ESTIMATORS, OBJECTIVES.values()))
    }
    return sorted(rows, key=lambda r: order[tuple(r[key] for key in _KEYS)])


def main() -> None:
    """Keep the rows of the studies in these folders, write the tables, and print what misses its target."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="of guard.toml and its like")
    parser.add_argument("--commit", required=True, help="of the code that made the runs; kept with the rows")
    chosen = parser.parse_args()
    try:
        runs = {folder: runs_of(folder) for folder in chosen.folders}
        lines = {key: line for folder, found in runs.items() for key, line in worst_lines(folder, found).items()}
    except (CosimError, KeyError) as e:
        parser.error(f"no study of the guard: {e}")
    new = rows(r for found in runs.values() for r in found)
    kept = in_order(report.updated("guard", new, *_KEYS))
    measured = ", ".join(dict.fromkeys(f"{row['estimator']} on {row['objective']}" for row in new))
    report.keep(report.RESULTS, "guard", kept, f"of commit {chosen.commit}: {measured}")
    write_text(SAFETY, report.replaced(SAFETY.read_text(encoding="utf-8"), "guard", markdown(kept)))
    for row in new:
        if missed := misses(row):
            key = tuple(row[k] for k in _KEYS)
            print(f"{' '.join(key)}: {', '.join(missed)}\n    {lines[key]}")


if __name__ == "__main__":
    main()
