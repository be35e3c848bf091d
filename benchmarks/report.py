"""What every benchmark prints and keeps: an aligned table, and JSON with the facts of the machine it ran on."""

import json
import math
import os
import platform
from collections.abc import Iterable
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import numpy as np

RESULTS = Path(__file__).parent / "results"


def write(name: str, rows: list[dict[str, object]], notes: str = "") -> None:
    """Print the rows as a table and write benchmarks/results/NAME.json.

    Columns are the keys in order of first appearance; a value that is a dict of `spread` prints as median [q1, q3].
    """
    print(table(rows))
    if notes:
        print(f"\n{notes}")
    keep(name, rows, notes)


def keep(name: str, rows: list[dict[str, object]], notes: str = "") -> None:
    """Write benchmarks/results/NAME.json, whole or not at all. Not-a-number and infinities are null there."""
    RESULTS.mkdir(exist_ok=True)
    content = {"benchmark": name, "machine": machine(), "notes": notes, "rows": _finite(rows)}
    target = RESULTS / f"{name}.json"
    temporary = target.with_suffix(f".{os.getpid()}.tmp")
    temporary.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    temporary.replace(target)


def spread(values: Iterable[float]) -> dict[str, Any]:
    """Median, quartiles and number of values; NaN and 0 of none."""
    data = np.array(list(values), dtype=float)
    if not len(data):
        return {"median": math.nan, "q1": math.nan, "q3": math.nan, "n": 0}
    q1, median, q3 = np.quantile(data, [0.25, 0.5, 0.75]).tolist()
    return {"median": median, "q1": q1, "q3": q3, "n": len(data)}


def table(rows: list[dict[str, object]]) -> str:
    """The rows under their keys: text left, numbers right."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    cells = [[_cell(row.get(column, "")) for column in columns] for row in rows]
    width = [max(map(len, column)) for column in zip(columns, *cells, strict=True)]
    is_text = [all(isinstance(row.get(column, ""), str) for row in rows) for column in columns]
    lines = [
        "  ".join(c.ljust(w) if t else c.rjust(w) for c, w, t in zip(line, width, is_text, strict=True)).rstrip()
        for line in [columns, *cells]
    ]
    return "\n".join(lines)


def machine() -> dict[str, object]:
    """Processor, cores, memory, and versions of system, Python and installed packages."""
    return {
        "cpu": _processor(),
        "cores": os.cpu_count(),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "system": platform.platform(),
        "python": platform.python_version(),
        "packages": dict(sorted((d.metadata["Name"], d.version) for d in distributions())),
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def _cell(value: object) -> str:
    if isinstance(value, dict):
        if not {"median", "q1", "q3"} <= value.keys():
            return "..."
        return f"{_cell(value['median'])} [{_cell(value['q1'])}, {_cell(value['q3'])}]" if value.get("n", 1) else "-"
    if isinstance(value, bool) or not isinstance(value, float):
        return "" if value is None else str(value)
    return "-" if math.isnan(value) else f"{value:.0f}" if 1000.0 <= abs(value) < math.inf else f"{value:.3g}"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


if __name__ == "__main__":
    print(json.dumps(machine(), indent=1))
