"""Tables of the documentation, made from the schema: each key's meaning is the docstring below it.

    python -m cosim.scenarios.reference docs/scenario.md docs/estimators.md

writes them anew into the pages, between `<!-- tables: NAME -->` and `<!-- end of tables -->`.
"""

import ast
import inspect
import json
import re
import sys
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass
from itertools import pairwise
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Final, Union, get_args, get_origin, get_type_hints

from pydantic import TypeAdapter

from estimator import METHODS

from ..files import write_text
from .scenario import Scenario
from .schema.estimation import EstimationSettings
from .schema.table import MOST, Table

_PLACE: Final = re.compile(r"(<!-- tables: (\w+) -->\n).*?(<!-- end of tables -->)", re.DOTALL)
_HEAD: Final = "| key | value | default | meaning |\n| --- | --- | --- | --- |\n"
_HIDDEN: Final = {(Scenario, "folder"), (Scenario, "origin"), (EstimationSettings, "methods")}
"""Fields that are no keys of a file."""


def rendered(page: str) -> str:
    """Return the page with its tables written anew. Raises KeyError for tables of an unknown name."""
    tables = {"scenario": scenario_tables, "estimators": estimator_tables}
    return _PLACE.sub(lambda place: f"{place[1]}\n{tables[place[2]]()}\n\n{place[3]}", page)


def scenario_tables() -> str:
    """Return a section for the file, and for each table in it, in the order of the schema."""
    return "\n\n".join([_section("The file", Scenario), *(_section(*found) for found in tables_in(Scenario, ""))])


def estimator_tables() -> str:
    """Return a section for each class of settings, named for the estimators that take them."""
    users: dict[type[Any], list[str]] = {}
    for name, method in METHODS.items():
        users.setdefault(method.settings, []).append(f"`{name}`")
    return "\n\n".join(_section(", ".join(names), settings) for settings, names in users.items())


def _section(title: str, table: type[Any]) -> str:
    schema = TypeAdapter(table).json_schema()
    required, texts = schema.get("required", ()), docstrings(table)
    rows = [
        f"| `{key}` | {_kind(field)} | {'required' if key in required else _default(field)} | {texts[key]} |"
        for key, field in schema.get("properties", {}).items()
        if (table, key) not in _HIDDEN and "const" not in field  # which the heading says
    ]
    text = _line(inspect.getdoc(table) or "")
    return "\n\n".join([f"### {title}", text, *([_HEAD + "\n".join(rows)] if rows else [])])


def tables_in(table: type[Any], place: str) -> Iterator[tuple[str, type[Any]]]:
    """Yield the tables below one in a file, with their headings."""
    for key, annotation in _types(table).items():
        if (table, key) in _HIDDEN:
            continue
        path, mark = f"{place}.{key}" if place else key, "[{}]"
        origin, parts = get_origin(annotation), get_args(annotation)
        if origin is dict:
            path += ".NAME" if parts[0] is str else '."COMPONENT.VARIABLE"'
        elif origin is tuple:
            mark = "[[{}]]"
        found = list(_tables(annotation))
        for inner in found:
            kind = f", kind = {json.dumps(*get_args(_types(inner)['kind']))}" if len(found) > 1 else ""
            yield f"`{mark.format(path)}`{kind}", inner
            yield from tables_in(inner, path)


def _types(table: type[Any]) -> Mapping[str, Any]:
    """Return the types of a table's fields."""
    if issubclass(table, Table):
        return {key: field.annotation for key, field in table.model_fields.items()}
    return get_type_hints(table)


def _tables(annotation: Any) -> Iterator[type[Any]]:
    """Yield the tables, or dataclasses read as tables, in an annotation."""
    if isinstance(annotation, type) and (issubclass(annotation, Table) or is_dataclass(annotation)):
        yield annotation
    elif get_origin(annotation) in (dict, tuple, Union, UnionType, Annotated):
        for part in get_args(annotation):
            yield from _tables(part)


def _kind(field: Mapping[str, Any]) -> str:
    """Return the kind of value that a key takes, from its JSON schema."""
    if "const" in field or "enum" in field:
        return ", ".join(f"`{json.dumps(value)}`" for value in field.get("enum", [field.get("const")]))
    if "anyOf" in field or "oneOf" in field:
        choices = [_kind(choice) for choice in field.get("anyOf", field.get("oneOf")) if choice.get("type") != "null"]
        return " or ".join(dict.fromkeys(choices))
    match field.get("type"):
        case "number" | "integer" as kind:
            return ("number" if kind == "number" else "whole number") + _range(field)
        case "array":
            items = field.get("items") or field["prefixItems"][0]
            return f"list of {_kind(items)}s"
        case "boolean":
            return "`true`, `false`"
        case "string":
            return "text"
        case _:  # an object, or a reference to one
            return "table"


def _range(field: Mapping[str, Any]) -> str:
    signs = (("exclusiveMinimum", ">"), ("minimum", "≥"), ("exclusiveMaximum", "<"), ("maximum", "≤"))
    limits = [f"{sign} {field[key]:g}" for key, sign in signs if key in field and field[key] != MOST]
    return "".join(f" {limit}" for limit in limits[:1]) + "".join(f", {limit}" for limit in limits[1:])


def _default(field: Mapping[str, Any]) -> str:
    value = field.get("default")
    return "" if value is None or isinstance(value, dict | list) else f"`{json.dumps(value)}`"


def docstrings(table: type[Any]) -> dict[str, str]:
    """Return the docstring of each field, those of its bases included, in one line."""
    texts: dict[str, str] = {}
    for cls in reversed(table.__mro__):
        if not (is_dataclass(cls) or issubclass(cls, Table)):
            continue
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(cls))).body
        body = tree.body if isinstance(tree, ast.ClassDef) else []
        for field, text in pairwise(body):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(text, ast.Expr):
                texts[field.target.id] = _line(str(ast.literal_eval(text.value)))
    return texts


def _line(text: str) -> str:
    """Return a docstring as a cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")


if __name__ == "__main__":
    for name in sys.argv[1:]:
        write_text(Path(name), rendered(Path(name).read_text(encoding="utf-8")))
