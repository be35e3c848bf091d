"""The figures of docs/evaluation.md: keeps what the document shows of the runs, and puts that into the prose.

    python -m benchmarks.evaluation FOLDER      # with the runs -> docs/evaluation/, docs/evaluation.md
    python -m benchmarks.evaluation             # docs/evaluation.in.md and docs/evaluation/ -> docs/evaluation.md

In the folder are those of `evaluation`, `late` and `paper` (studies/), `frozen-*.json` and `figures` that there are;
`make evaluation` makes all of them. In the prose, `{{include FILE}}` stands for a Markdown table of docs/evaluation/,
`{{FILE KEY KEY ...}}` for one number of a JSON file there (a list is searched for the element whose `estimator`,
`scenario` or `t` is the key; one at the end is counted), `{{frozen FILE}}` for the table of a frozen window, and
`{{late}}` for that of true parameters that are written late.
"""

import argparse
import json
import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import Image

from benchmarks import report
from cosim.campaigns.comparison import Comparison
from cosim.campaigns.tables import to_markdown
from cosim.errors import CosimError
from cosim.files import write_text
from cosim.runs.result import read_run
from cosim.studies.folder import RUNS, read_study
from cosim.studies.ledger import LEDGER, open_ledger
from cosim.studies.row import record_of

DOCS: Final = Path(__file__).parents[1] / "docs"
DATA: Final = DOCS / "evaluation"
JOBS: Final = 2
"""Runs at a time, as `make evaluation` has them."""
COMPARISONS: Final[Mapping[str, tuple[str, str, Sequence[str]]]] = {
    "quadrotor": ("evaluation", "quadrotor", ("target", "least-squares", "ukf", "rls")),
    "quadrotor-scalar": ("paper", "quadrotor", ("paper", "bo-scalar", "sqp", "sqp-wide-step")),
    "quadrotor-ipm": ("paper", "quadrotor", ("ipm", "ipm-wide-step", "ipm-scipy", "ipm-scipy-wide-step")),
    "pendulum": ("evaluation", "pendulum", ("target", "least-squares", "ukf", "rls")),
    "pendulum-scalar": ("paper", "pendulum", ("paper", "bo-scalar", "sqp", "sqp-wide-step")),
    "stiction": ("evaluation", "stiction", ("target", "least-squares", "multi-start", "ukf")),
    "stiction-scalar": ("paper", "stiction", ("paper", "sqp-wide-step")),
    "rigid-body": ("evaluation", "rigid-body", ("target", "least-squares", "ukf")),
    "magnetic-levitation": ("evaluation", "magnetic-levitation", ("target", "least-squares", "ukf")),
}
"""Study, scenario and estimators of each comparison of the document; `none` and `true` belong to all."""
FROZEN: Final = ("frozen-quadrotor", "frozen-stiction", "frozen-rigid-body")


def main() -> None:
    """Keep what there is of the runs, and write the document."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, help="with the runs")
    folder: Path | None = parser.parse_args().folder
    try:
        if folder is not None:
            collect(folder)
    except CosimError as e:
        parser.error(str(e))
    write_text(DOCS / "evaluation.md", render())


def collect(folder: Path) -> None:
    """Keep in docs/evaluation/ what the document shows; what has no runs stays as it is. Raises CosimError."""
    for name, (study, scenario, estimators) in COMPARISONS.items():
        if (made := comparison(folder / study, scenario, ("none", "true", *estimators))) is not None:
            _write(name, compared(json.loads(made.to_json())))
            write_text(DATA / f"{name}.md", to_markdown(made))
    if rows := late(folder / "late"):
        _write("late", {"rows": rows})
    for name in FROZEN:
        if (path := folder / f"{name}.json").exists():
            _write(name, solved(json.loads(path.read_text(encoding="utf-8"))))
    for path in (folder / "figures").glob("*.png"):
        picture = Image.open(path).convert("RGB").quantize(256, dither=Image.Dither.NONE)
        picture.save(DATA / path.name, optimize=True)
    for path in (folder / "figures").glob("table.md"):
        shutil.copy(path, DATA / path.name)


def comparison(folder: Path, scenario: str, estimators: Sequence[str]) -> Comparison | None:
    """Return the comparison of a study's runs with the seeds that all estimators have; None if there are none."""
    if not folder.exists():
        return None
    study, _ = read_study(folder)
    with open_ledger(folder / LEDGER, is_read_only=True) as ledger:
        ended = [e for e in ledger.entries() if e.result and e.point["scenario"] == scenario]
    places = {(e.point["estimator"], e.point["seed"]): folder / RUNS / e.result["run"] for e in ended}
    seeds = sorted({seed for _, seed in places if all((name, seed) in places for name in estimators)})
    if not seeds:
        return None
    records = tuple(record_of(read_run(places[name, seed])) for name in estimators for seed in seeds)
    source = study.sources[study.names.index(scenario)]
    return Comparison(source, tuple(estimators), tuple(seeds), records, JOBS)


def late(folder: Path) -> list[dict[str, Any]]:
    """Return for each scenario the mean squared errors, summed over the outputs, of true parameters written late.

    `delay` is the number of macro steps by which they are late, `ratio` the times by which the error is that of the
    floor, and `target` is as good as the truth `equivalent` steps late.
    """
    if not folder.exists():
        return []
    found: dict[str, dict[int, float]] = {}
    with open_ledger(folder / LEDGER, is_read_only=True) as ledger:
        for ended in ledger.entries():
            if ended.result and ended.result["mse"] is not None:
                found.setdefault(ended.point["scenario"], {})[ended.point["delay"]] = ended.result["mse"]
    rows: list[dict[str, Any]] = []
    for scenario, errors in found.items():
        delays = sorted(errors)
        mse = [errors[delay] for delay in delays]
        estimators = json.loads((DATA / f"{scenario}.json").read_text(encoding="utf-8"))["estimators"]
        target = sum(of["median"] for of in _below(estimators, "target")["mse"].values())
        ratio = {f"{delay}": error / mse[0] if mse[0] else None for delay, error in zip(delays, mse, strict=True)}
        equivalent = float(np.interp(target, mse, delays))
        rows.append(
            {"scenario": scenario, "delay": delays, "mse": mse, "ratio": ratio}
            | {"target": target, "equivalent": equivalent}
        )
    return rows


def compared(comparison: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of a comparison over its seeds, and the result of each run of the first seed."""
    kept = {key: comparison[key] for key in ("scenario", "seeds", "jobs", "cpus", "deadline_ms", "versions")}
    runs = [
        {
            **{key: run[key] for key in ("estimator", "status", "mse", "evaluations")},
            "errors": [[p["estimated"] - p["true"] for p in at["parameters"]] for at in run["instants"]],
        }
        for run in comparison["runs"]
        if run["seed"] == comparison["seeds"][0]
    ]
    return {**kept, "estimators": comparison["estimators"], "first_seed": runs}


def solved(frozen: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of a frozen window without the errors of the single seeds."""
    return {**frozen, "rows": [{k: v for k, v in row.items() if k != "errors"} for row in frozen["rows"]]}


def _write(name: str, content: Mapping[str, Any]) -> None:
    write_text(DATA / f"{name}.json", report.to_lines(content))


def render() -> str:
    """Return the text of the document. Raises KeyError for a number that no file has."""
    prose = (DOCS / "evaluation.in.md").read_text(encoding="utf-8")
    return re.sub(r"\{\{([^}]+)\}\}", lambda match: _value(match[1].split()), prose)


def _value(words: list[str]) -> str:
    if words[0] == "include":
        text = (DATA / words[1]).read_text(encoding="utf-8").split("\n", 2)[2]
        return re.sub(r"^## (.*)$", r"*\1*", text, flags=re.MULTILINE).strip()
    if words[0] == "frozen":
        return _frozen(json.loads((DATA / f"{words[1]}.json").read_text(encoding="utf-8"))["rows"])
    if words == ["late"]:
        return _late(json.loads((DATA / "late.json").read_text(encoding="utf-8"))["rows"])
    found: Any = json.loads((DATA / f"{words[0]}.json").read_text(encoding="utf-8"))
    for key in words[1:]:
        found = _below(found, key)
    if isinstance(found, list):
        return str(len(found))
    if isinstance(found, float):
        return f"{found:.0f}" if found >= 1000.0 else f"{found:.3g}"
    return str(found)


def _below(tree: Any, key: str) -> Any:
    if isinstance(tree, dict):
        return tree[key.replace("_", " ") if key not in tree else key]
    for element in tree:
        if key in (element.get("estimator"), element.get("scenario"), f"{element.get('t')}"):
            return element
    raise KeyError(key)


def _late(rows: list[dict[str, Any]]) -> str:
    """Return a table of squared errors: scenarios down, macro steps by which the true parameters are late across."""
    across = [*(f"{delay} late" for delay in rows[0]["delay"]), "`target`", "is as late as"]
    lines = ["| scenario | " + " | ".join(across) + " |", "| --- |" + " ---: |" * len(across)]
    for row in rows:
        cells = [*(f"{mse:.3g}" for mse in row["mse"]), f"{row['target']:.3g}", f"{row['equivalent']:.2g}"]
        lines.append(f"| {row['scenario']} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _frozen(rows: list[dict[str, Any]]) -> str:
    """Return a table, estimators down and numbers of evaluations across, of median / worst relative errors."""
    counts = list(dict.fromkeys(r["evaluations"] for r in rows))
    names = list(dict.fromkeys(r["estimator"] for r in rows))
    cell = {
        (r["estimator"], r["evaluations"]): f"{r['median']:.2g} / {r['worst']:.2g} ({r['within_5_percent']:.0%})"
        for r in rows
    }
    lines = ["| estimator | " + " | ".join(f"N = {n}" for n in counts) + " |", "| --- |" + " ---: |" * len(counts)]
    return "\n".join([*lines, *(f"| {n} | " + " | ".join(cell[n, c] for c in counts) + " |" for n in names)])


if __name__ == "__main__":
    main()
