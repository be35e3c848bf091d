"""Errors of a scenario file, in one line each. Known keys come from the schema's types."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from types import UnionType
from typing import Annotated, Any, Final, Union, get_args, get_origin, get_type_hints

from pydantic import ValidationError

from ..names import did_you_mean
from .schema.estimation import FORMULAS, NAME
from .schema.table import Table, Value

_JARGON: Final = (
    (re.compile(r"(?:Dictionary|Tuple|List) should have at least (\d+) items? after validation, not (\d+)"),
     r"must have \1 at least, got \2"),
    (re.compile(r"Input should be a valid (?:tuple|list)"), "must be a list"),
    (re.compile(r"Input should be a (?:valid )?dictionary.*"), "must be a table"),
    (re.compile(r"Unable to extract tag using discriminator '(\w+)'"), r"\1 is missing"),
    (re.compile(r"Field required"), "is missing"),
    (re.compile(r"Input tag ('.*') found using '(\w+)' does not match any of the expected tags: (.*)"),
     r"\2 must be one of \3, got \1"),
)  # fmt: skip
"""What pydantic says of containers, and how a TOML file's author would."""
_CONTAINERS: Final = {tuple: "tuple[", dict: "dict[", list: "list["}
"""How pydantic's path names these types."""
_UNKNOWN: Final = ("extra_forbidden", "unexpected_keyword_argument")
"""Pydantic's types of an unknown key: of a table, of a dataclass."""


def first_error(error: ValidationError, root: type[Table]) -> str:
    """Return key and rule of the first error, in one line; root: the table that was validated."""
    first, *others = _by_place(error, root)
    text = _text(first, root)
    more = f" (and {len(others)} more)" if others else ""
    return f"{text}{more}{'' if text.endswith('?') else '.'}"


def error_texts(error: ValidationError, root: type[Table]) -> list[str]:
    """Return key and rule of each error, in one line; root: the table that was validated."""
    return [_text(details, root) for details in _by_place(error, root)]


def _by_place(error: ValidationError, root: type[Table]) -> list[Mapping[str, Any]]:
    """Return pydantic's errors, one for each place, unknown keys first: what is missing is misspelt.

    Of a value of several types there is an error for each: the one that reaches deepest fits best.
    """
    found: list[tuple[list[str], Mapping[str, Any]]] = []
    for details in sorted(error.errors(), key=lambda one: one["type"] not in _UNKNOWN):
        place = _place(details["loc"], root)[0]
        i = next((i for i, (above, _) in enumerate(found) if place[: len(above)] == above), len(found))
        above = found[i] if i < len(found) else None
        if above is None or len(details["loc"]) > len(above[1]["loc"]):
            found[i : i + 1] = [(place if above is None else above[0], details)]
    return [details for _, details in found]


def _text(first: Mapping[str, Any], root: type[Table]) -> str:
    keys, _ = _place(first["loc"], root)
    key = ".".join(keys)
    if first["type"] in _UNKNOWN:
        _, table = _place(first["loc"][:-1], root)
        known = _known_keys(table) if table is not None else set[str]()
        name = str(first["loc"][-1])
        return f"{key}: unknown key{did_you_mean(name, known) or _elsewhere(name, keys, root)}"
    message = first["msg"].removeprefix("Value error, ").rstrip(".")
    for jargon, plain in _JARGON:
        message = jargon.sub(plain, message)
    value = first["input"]
    got = f", got {value!r}" if isinstance(value, Value) and "got" not in message else ""
    if key and message.startswith(f"{key}."):  # the place is in the message already, and more closely
        key = ""
    if key and (inner := re.match(r"[\w.]+(?=: must be )", message)):  # a key of that table
        key, message = f"{key}.{inner[0]}", message[inner.end() + 2 :]
    return f"{key + ': ' if key else ''}{message[:1].lower()}{message[1:]}{got}"


def _place(path: Sequence[int | str], root: type[Table]) -> tuple[list[str], type[Any] | None]:
    """Return the keys of pydantic's path, without pydantic's own additions, and the table there, if it is one."""
    keys: list[str] = []
    kind: Any = root
    for part in path:
        types = _alternatives(kind)
        if types:
            kind = next((one for one in types if str(part).startswith(_CONTAINERS.get(get_origin(one), "-"))), None)
            continue
        tagged = next((table for table in _tables(kind) if part in _tags(table)), None)
        if tagged is not None:
            kind = tagged
        elif part not in ("[key]", NAME, FORMULAS):
            keys.append(str(part))
            kind = _item(kind, part)
    tables = _tables(kind)
    return keys, tables[0] if len(tables) == 1 else None


def _alternatives(kind: Any) -> list[Any]:
    """Return the types that a value may have where there are several and none is a table: pydantic's path names one."""
    if get_origin(kind) is Annotated:
        return _alternatives(get_args(kind)[0])
    if get_origin(kind) not in (Union, UnionType) or _tables(kind):
        return []
    types = [one for one in get_args(kind) if one is not type(None)]
    return types if len(types) > 1 else []


def _tables(kind: Any) -> list[type[Any]]:
    """Return the tables, and dataclasses read as tables, that a value of this type can be."""
    if get_origin(kind) is Annotated:
        return _tables(get_args(kind)[0])
    if get_origin(kind) in (Union, UnionType):
        return [table for member in get_args(kind) for table in _tables(member)]
    is_table = isinstance(kind, type) and (issubclass(kind, Table) or is_dataclass(kind))
    return [kind] if is_table else []


def _types(table: type[Any]) -> dict[str, Any]:
    """Return the types of a table's fields by name."""
    if issubclass(table, Table):
        return {name: field.annotation for name, field in table.model_fields.items()}
    hints = get_type_hints(table)
    return {field.name: hints[field.name] for field in fields(table)}


def _elsewhere(name: str, keys: Sequence[str], root: type[Table]) -> str:
    """Return a hint at the tables that have a key which the file's first level, where it is given, has not."""
    below = {key: _tables(kind) for key, kind in _types(root).items()} if len(keys) == 1 else {}
    found = [f"{key}.{name}" for key, tables in below.items() if len(tables) == 1 and name in _known_keys(tables[0])]
    return f"; there is {' and '.join(found)}" if found else ""


def _known_keys(table: type[Any]) -> set[str]:
    """Return the keys that a table may have."""
    return table.known_keys() if issubclass(table, Table) else set(_types(table))


def _tags(table: type[Any]) -> tuple[Any, ...]:
    """Return the values of `kind` that distinguish this table from others in a union."""
    return get_args(_types(table).get("kind"))


def _item(kind: Any, key: int | str) -> Any:
    """Return the type of the value under a key of a table, a dictionary or a row; None for an unknown key."""
    if get_origin(kind) is dict:
        return get_args(kind)[1]
    if get_origin(kind) is tuple:
        types = get_args(kind)
        return types[0] if types[-1] is Ellipsis else types[int(key)]
    found = [types[str(key)] for table in _tables(kind) if str(key) in (types := _types(table))]
    return found[0] if len(found) == 1 else None
