"""Makes docs/evaluation.md: `measure` runs the comparisons, `render` puts their figures into the prose.

    python -m benchmarks.evaluation measure     # 25 minutes on two cores: all below, into docs/evaluation/
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
import tempfile
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[1] / "docs"
DATA = DOCS / "evaluation"
UNGUARDED = {"guard.enabled": "false", "observations.enabled": "false"}
"""Estimators are compared by themselves; docs/safety.md has what guard and screen prevent and cost."""
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
    """Parse and do."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["measure", "render"])
    parser.add_argument("--only", nargs="+", help="names of the folders or files to measure again")
    options = parser.parse_args()
    if options.what == "measure":
        measure(options.only or [*COMPARISONS, *FROZEN, "figures"])
    (DOCS / "evaluation.md").write_text(render(), encoding="utf-8")


def commands() -> list[str]:
    """What `measure` runs, as one types it."""
    return [
        *(f"retune compare {arguments}{_UNGUARDED} --out {name}" for name, arguments in COMPARISONS.items()),
        *(f"python -m benchmarks.frozen {arguments} --out {name}.json" for name, arguments in FROZEN.items()),
        "retune figures --jobs 1 --out figures",
    ]


def measure(names: list[str]) -> None:
    """Run the commands of these names, one after the other, and keep what the document needs."""
    DATA.mkdir(exist_ok=True)
    for name in names:
        with tempfile.TemporaryDirectory() as place:
            out = Path(place) / name
            if name in COMPARISONS:
                tail = f"cosim.cli compare {COMPARISONS[name]}{_UNGUARDED} --out {out}"
            elif name in FROZEN:
                tail = f"benchmarks.frozen {FROZEN[name]} --out {out}.json"
            else:
                tail = f"cosim.cli figures --jobs 1 --out {out}"
            subprocess.run([sys.executable, "-m", *shlex.split(tail)], check=True, cwd=DOCS.parent)
            for source in [*out.glob("comparison.*"), *out.glob("figures.json"), *Path(place).glob("*.json")]:
                keep(source, name)
            for source in [*out.glob("*.png"), *out.glob("table.md")]:
                shutil.copy(source, DATA / source.name)


def keep(source: Path, name: str) -> None:
    """Copy a result beside the document; of a comparison only what does not depend on where it was made."""
    content = source.read_text(encoding="utf-8")
    if source.suffix == ".json":
        tree = json.loads(content)
        tree.pop("folder", None)
        for run in tree.get("runs", []):
            run.pop("run", None)
        (DATA / f"{name}.json").write_text(json.dumps(tree, indent=1) + "\n", encoding="utf-8")
    elif source.suffix == ".md":
        shutil.copy(source, DATA / f"{name}.md")


def render() -> str:
    """The document's text. Raises KeyError for a number that no file has."""
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
    """A table: estimators down, numbers of evaluations across; median / worst relative error."""
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
