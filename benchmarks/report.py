"""Tables and JSON files of the benchmarks, with the facts of the machine on which they ran.

Every benchmark prints a table and keeps its rows in results/, which are tracked. What they were made from, where it is
large or a measurement goes on from it, is in raw/, which is not.
"""

import json
import math
import os
import platform
import re
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import distributions, requires
from pathlib import Path
from typing import Any

import numpy as np

from cosim.files import to_json, write_text

RESULTS = Path(__file__).parent / "results"
RAW = Path(__file__).parent / "raw"

Row = dict[str, Any]


def write(name: str, rows: Sequence[Row], notes: str = "") -> None:
    """Print the rows as a table and keep them in results/NAME.json."""
    print(table(rows))
    if notes:
        print(f"\n{notes}")
    keep(RESULTS, name, rows, notes)


def keep(folder: Path, name: str, rows: Sequence[Row], notes: str = "") -> None:
    """Write NAME.json, whole or not at all, to six digits; not-a-number and infinities become null."""
    folder.mkdir(parents=True, exist_ok=True)
    content = {"benchmark": name, "machine": machine(), "notes": notes, "rows": [_rounded(row) for row in rows]}
    write_text(folder / f"{name}.json", to_lines(content))


def _rounded(value: Any) -> Any:
    """Return a JSON value with each number to six digits."""
    if isinstance(value, Mapping):
        return {key: _rounded(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(v) for v in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def stored(folder: Path, name: str) -> list[Row]:
    """Return the rows of NAME.json, none if there is no such file."""
    path = folder / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8"))["rows"] if path.exists() else []


def updated(name: str, rows: Iterable[Row], *keys: str) -> list[Row]:
    """Return the rows of results/NAME.json with these in place of those that have the same keys, or after them."""
    found = {tuple(row[key] for key in keys): row for row in stored(RESULTS, name)}
    return list((found | {tuple(row[key] for key in keys): row for row in rows}).values())


def to_lines(content: Mapping[str, Any]) -> str:
    """Return a JSON object with a line for each key, and for each element of a list of objects."""

    def text(value: Any) -> str:
        if isinstance(value, list | tuple) and value and all(isinstance(v, Mapping) for v in value):
            return "[\n" + ",\n".join(map(to_json, value)) + "\n]"
        return to_json(value)

    return "{\n" + ",\n".join(f"{to_json(key)}: {text(value)}" for key, value in content.items()) + "\n}\n"


def spread(values: Iterable[float]) -> Row:
    """Return median, quartiles and number of values; NaN and 0 if there are none."""
    data = np.array(list(values), dtype=float)
    if not len(data):
        return {"median": math.nan, "q1": math.nan, "q3": math.nan, "n": 0}
    q1, median, q3 = np.quantile(data, [0.25, 0.5, 0.75]).tolist()
    return {"median": median, "q1": q1, "q3": q3, "n": len(data)}


def table(rows: Sequence[Row]) -> str:
    """Return the rows under their keys, in order of first appearance: text left, numbers right.

    A value made by `spread` is shown as median [q1, q3].
    """
    columns = list(dict.fromkeys(key for row in rows for key in row))
    cells = [[cell(row.get(column, "")) for column in columns] for row in rows]
    width = [max(map(len, column)) for column in zip(columns, *cells, strict=True)]
    is_text = [all(isinstance(row.get(column, ""), str) for row in rows) for column in columns]
    lines = [
        "  ".join(c.ljust(w) if t else c.rjust(w) for c, w, t in zip(line, width, is_text, strict=True)).rstrip()
        for line in [columns, *cells]
    ]
    return "\n".join(lines)


def cell(value: object) -> str:
    """Return a value as text of three digits; one made by `spread` as median [q1, q3]."""
    if isinstance(value, dict):
        if not {"median", "q1", "q3"} <= value.keys():
            return "..."
        return f"{cell(value['median'])} [{cell(value['q1'])}, {cell(value['q3'])}]" if value.get("n", 1) else "-"
    if isinstance(value, bool) or not isinstance(value, float):
        return "" if value is None else str(value)
    return "-" if math.isnan(value) else f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"


def replaced(text: str, name: str, table: str) -> str:
    """Return a document with a table between its mark `<!-- NAME -->` and the end's. Raises ValueError without them."""
    head, begin, rest = text.partition(f"<!-- {name} -->\n")
    _, end, tail = rest.partition("\n<!-- end -->")
    if not end:
        raise ValueError(f"the document has no <!-- {name} --> with <!-- end --> after it.")
    return f"{head}{begin}{table}{end}{tail}"


def machine() -> Row:
    """Return processor, cores, memory, and versions of the system, of Python and of the packages that count."""
    return {
        "cpu": _processor(),
        "cores": os.cpu_count(),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "system": platform.platform(),
        "python": platform.python_version(),
        "packages": _packages(),
    }


def _packages() -> dict[str, str]:
    """Return the versions of this package, of those that it needs, and of the peers."""
    named_all = requires("fmu-retune") or ()
    needed = [line for line in named_all if "extra ==" not in line or re.search(r"extra == .(peers|ipopt)", line)]
    named = {_normal(re.split(r"[\s\[<>=!~;]", required, maxsplit=1)[0]) for required in needed}
    found = {d.metadata["Name"]: d.version for d in distributions()}
    return {name: found[name] for name in sorted(found) if _normal(name) in named | {"fmu-retune"}}


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


if __name__ == "__main__":
    print(to_json(machine(), indent=1))
