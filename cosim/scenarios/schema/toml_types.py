"""Types of TOML in a scenario file: a number is no text that looks like one, and no truth value."""

from collections.abc import Mapping
from dataclasses import is_dataclass
from math import inf
from types import UnionType
from typing import Annotated, Any, Final, Union, get_args, get_origin, get_type_hints

_WORDS: Final[Mapping[type, str]] = {float: "a number", int: "a whole number", bool: "true or false"}
LARGEST: Final = 1e100
"""Largest size of a number: squares and products stay finite."""


def check_types(types: Mapping[str, Any], table: Mapping[str, Any], place: str = "") -> None:
    """Raise ValueError for a value that is no number or truth value of TOML's where one is due, or out of all range.

    types: of the table's keys; place: names the table in messages. Tables that are dataclasses are looked into.
    """
    for key, value in table.items():
        kinds = list(_kinds(types.get(key)))
        scalars = [kind for kind in kinds if kind in _WORDS]
        if scalars == kinds and kinds and _is_other(value, kinds):
            raise ValueError(f"{place}{key}: must be {' or '.join(_WORDS[kind] for kind in kinds)}, got {value!r}")
        if float in kinds and isinstance(value, float) and LARGEST < abs(value) < inf:
            raise ValueError(f"{place}{key}: must be at most {LARGEST:g} in size, got {value!r}")
        if isinstance(value, Mapping):
            for kind in kinds:
                if is_dataclass(kind) and _is_meant(kind, value):
                    check_types(get_type_hints(kind), value, f"{place}{key}.")


def _is_other(value: object, kinds: list[type]) -> bool:
    """Return whether a text or a truth value, which pydantic would convert, stands for something else."""
    return isinstance(value, str) or (isinstance(value, bool) != (kinds == [bool]) and isinstance(value, bool | int))


def _is_meant(kind: Any, table: Mapping[str, Any]) -> bool:
    """Return whether a table is of this class, where `kind` in it says which."""
    tags = get_args(get_type_hints(kind).get("kind"))
    return not tags or table.get("kind") in tags


def _kinds(annotation: Any) -> list[Any]:
    """Return the types in an annotation, without None."""
    if get_origin(annotation) is Annotated:
        return _kinds(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [kind for part in get_args(annotation) for kind in _kinds(part)]
    return [] if annotation in (None, type(None)) else [annotation]
