"""The figures of docs/evaluation.md: measures them, keeps what the document shows, and puts that into the prose.

    python -m benchmarks.evaluation measure     # 25 minutes on two cores: all below, and then the other two
    python -m benchmarks.evaluation collect     # raw runs in benchmarks/raw/evaluation/ -> docs/evaluation/
    python -m benchmarks.evaluation render      # docs/evaluation.in.md and docs/evaluation/ -> docs/evaluation.md

In the prose, `{{include FILE}}` stands for a Markdown table of docs/evaluation/, `{{FILE KEY KEY ...}}` for one number
of a JSON file there (a list is searched for the element whose `estimator` or `t` is the key; one at the end is
counted), `{{frozen FILE}}` for the table of a frozen window, and `{{commands}}` for the commands.
"""

import argparse
import json
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from PIL import Image

from benchmarks import report
from cosim.files import write_text
from cosim.studies.folder import is_study

DOCS = Path(__file__).parents[1] / "docs"
DATA = DOCS / "evaluation"
RAW = report.RAW / "evaluation"
UNGUARDED = {"guard.enabled": "false", "observations.enabled": "false", "diagnosis.enabled": "false"}
"""Settings that leave the estimators by themselves; docs/safety.md has what guard and screen prevent and cost."""
_UNGUARDED = "".join(f" --set {key}={value}" for key, value in UNGUARDED.items())
COMPARISONS = {
    "quadrotor": "quadrotor --estimators target,least-squares,ukf,rls --seeds 20 --jobs 2",
    "quadrotor-scalar": "quadrotor --estimators paper,bo-scalar,sqp,sqp-wide-step --seeds 10 --jobs 2",
    "quadrotor-ipm": "quadrotor --estimators ipm,ipm-wide-step,ipm-scipy,ipm-scipy-wide-step --seeds 2 --jobs 2",
    "pendulum": "pendulum --estimators target,least-squares,ukf,rls,paper,bo-scalar,sqp,sqp-wide-step "
    "--seeds 4 --jobs 2",
    "stiction": "stiction --estimators target,least-squares,multi-start,ukf,paper,sqp-wide-step --seeds 4 --jobs 2",
    "rigid-body": "rigid-body --estimators target,least-squares,ukf --seeds 10 --jobs 2",
}
_SOLVERS = "--seeds 20 --estimators target least-squares multi-start bo-scalar"
FROZEN = {
    "frozen-quadrotor": "quadrotor --at 5.0 --window 10 --stride 5 --evaluations 30 --seeds 20 "
    "--estimators target least-squares closed-form bo-scalar",
    "frozen-stiction": f"stiction --at 4.0 --window 100 --evaluations 30 45 60 120 {_SOLVERS}",
    "frozen-rigid-body": f"rigid-body --at 2.6 --window 10 --stride 5 --evaluations 30 45 60 100 {_SOLVERS}",
}


def main() -> None:
    """Measure, collect or render, including the steps that follow."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = [*COMPARISONS, *FROZEN, "figures"]
    parser.add_argument("what", choices=["measure", "collect", "render"])
    parser.add_argument("--only", nargs="+", default=names, choices=names, metavar="NAME", help=", ".join(names))
    options = parser.parse_args()
    if options.what == "measure":
        measure(options.only)
    if options.what != "render":
        collect(options.only)
    write_text(DOCS / "evaluation.md", render())


def commands() -> list[str]:
    """Return the commands that `measure` runs, as one types them."""
    return [
        *(f"retune compare {arguments}{_UNGUARDED} --out {name}" for name, arguments in COMPARISONS.items()),
        *(f"python -m benchmarks.frozen {arguments} --out {name}.json" for name, arguments in FROZEN.items()),
        "retune figures --jobs 1 --out figures",
    ]


def measure(names: Iterable[str]) -> None:
    """Run the commands of these names, one after the other, into benchmarks/raw/evaluation/."""
    RAW.mkdir(parents=True, exist_ok=True)
    for name in names:
        out = RAW / name
        if name in COMPARISONS and is_study(out) and not _run(f"cosim.cli resume {shlex.quote(str(out))}").returncode:
            continue  # what was interrupted has gone on; what is of other sources is refused, and measured anew
        shutil.rmtree(out, ignore_errors=True)
        if name in COMPARISONS:
            arguments = f"cosim.cli compare {COMPARISONS[name]}{_UNGUARDED}"
        elif name in FROZEN:
            arguments, out = f"benchmarks.frozen {FROZEN[name]}", RAW / f"{name}.json"
        else:
            arguments = "cosim.cli figures --jobs 1"
        _run(f"{arguments} --out {shlex.quote(str(out))}").check_returncode()


def _run(arguments: str) -> "subprocess.CompletedProcess[bytes]":
    return subprocess.run([sys.executable, "-m", *shlex.split(arguments)], cwd=DOCS.parent)


def collect(names: Iterable[str]) -> None:
    """Keep in docs/evaluation/ what the document shows of the raw runs; names without raw runs stay as they are."""
    for name in names:
        if (path := RAW / f"{name}.json").exists():
            _write(name, solved(json.loads(path.read_text(encoding="utf-8"))))
        if (path := RAW / name / "comparison.json").exists():
            _write(name, compared(json.loads(path.read_text(encoding="utf-8"))))
            shutil.copy(path.with_suffix(".md"), DATA / f"{name}.md")
        if name == "figures":
            for path in (RAW / name).glob("*.png"):
                picture = Image.open(path).convert("RGB").quantize(256, dither=Image.Dither.NONE)
                picture.save(DATA / path.name, optimize=True)
            for path in (RAW / name).glob("table.md"):
                shutil.copy(path, DATA / path.name)


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
    if words == ["commands"]:
        return "\n".join(commands())
    if words[0] == "include":
        text = (DATA / words[1]).read_text(encoding="utf-8").split("\n", 2)[2]
        return re.sub(r"^## (.*)$", r"*\1*", text, flags=re.MULTILINE).strip()
    if words[0] == "frozen":
        return _frozen(json.loads((DATA / f"{words[1]}.json").read_text(encoding="utf-8"))["rows"])
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
        if key in (element.get("estimator"), f"{element.get('t')}"):
            return element
    raise KeyError(key)


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
