"""Objects of a run, by what a checkpoint holds of them.

| | at the start of the run | later |
| --- | --- | --- |
| numbers, texts, bytes | written out | written out |
| lists, mappings, sets, arrays, random generators | content | made anew |
| instances of Python classes | attributes | made anew, of classes that a checkpoint may make |
| tuples, frozen dataclasses, bound methods, closures, partials | content of what is in them | tuples and frozen ones |
| functions, classes, modules, paths, scenarios, locks, loggers | nothing: they are the resumed run's own | refused |
| live parts (see `cosim.runs.checkpoint.Alive`) | what they save themselves | refused |

Refused are also files, generators and whatever else keeps its state out of sight.
"""

import logging
import re
import sys
import threading
from array import array
from collections import Counter, OrderedDict, deque
from collections.abc import Collection, Mapping
from dataclasses import is_dataclass
from enum import Enum
from functools import cache, cached_property, partial
from pathlib import PurePath
from types import CellType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any, Final, cast
from weakref import ReferenceType

import numpy as np
from pydantic import BaseModel

INLINE: Final = (type(None), bool, int, str)
"""Types that JSON has, big integers and texts with any character among them."""
_ATOMS: Final = (*INLINE, float, bytes)
NUMBERS: Final = "biufc"
"""Kinds of NumPy's numbers."""
_WORD: Final = tuple.__itemsize__
_HEAP_TYPE: Final = 1 << 9
"""Flag of a class made by a `class` statement or its like."""
_KINDS: Final[dict[type, str]] = {
    tuple: "tuple", list: "list", dict: "dict", OrderedDict: "OrderedDict", Counter: "Counter", deque: "deque",
    set: "set", frozenset: "frozenset", array: "array.array", np.random.Generator: "Generator",
    MethodType: "method", partial: "partial", np.ndarray: "ndarray", FunctionType: "function",
}  # fmt: skip
_FIXED: Final = (
    str, int, float, bytes, type, ModuleType, CodeType, PurePath, BaseModel, Enum, np.dtype, slice, range, re.Pattern,
    logging.Logger, ReferenceType, type(threading.Lock()), type(threading.RLock()),
)  # fmt: skip


def kind_of(thing: object) -> str | None:
    """Return the kind of an object that is not written out; None for one whose state is out of sight."""
    kind = _kind_of_all(type(thing))
    if kind == "ndarray":
        return kind if cast(np.ndarray[Any, Any], thing).dtype.kind in NUMBERS else None
    if kind in ("set", "frozenset"):  # of others the order changes from one Python to the next
        items = cast(frozenset[object], thing)
        return kind if all(isinstance(item, _ATOMS) or is_constant(item) for item in items) else None
    if kind == "function":
        return "closure" if cast(FunctionType, thing).__closure__ else "fixed"
    return "fixed" if kind is None and callable(thing) else kind


def is_constant(thing: object) -> bool:
    """Return whether an object is a tuple of texts and numbers, which Python may make one object with equal ones."""
    return type(thing) is tuple and all(type(item) in _ATOMS for item in cast(tuple[object, ...], thing))


def cells(function: FunctionType) -> list[CellType]:
    """Return the variables that a function has from outside, as far as they have a value yet."""
    return [cell for cell in function.__closure__ or () if _has_value(cell)]


def is_code(value: object) -> bool:
    """Return whether a value is a function, a class, a path or the like, which no checkpoint may give to a run."""
    if isinstance(value, str | int | float | bytes | np.generic):
        return False
    return kind_of(value) in ("fixed", "closure", "method", "partial")


@cache
def is_named_tuple(kind: type) -> bool:
    """Return whether a class is a NamedTuple."""
    return issubclass(kind, tuple) and hasattr(kind, "_fields")


@cache
def is_frozen(kind: type) -> bool:
    """Return whether a class is a frozen dataclass, whose attributes keep their values."""
    params: Any = getattr(kind, "__dataclass_params__", None)
    return params is not None and params.frozen


def parts(thing: Any) -> Mapping[Any, Any]:
    """Return what an object holds, by name, key or place, as far as that may change."""
    match kind_of(thing):
        case "object" | "frozen":
            return attributes(thing)
        case "dict" | "OrderedDict" | "Counter":
            return thing
        case "list" | "deque":
            return dict(enumerate(thing))
        case "closure":
            return dict(enumerate(cell.cell_contents for cell in cells(thing)))
        case _:
            return {}


def attributes(thing: object) -> dict[str, Any]:
    """Return the attributes of an instance, by name, without those that are derived or that its class makes anew."""
    kind = type(thing)
    found = {name: getattr(thing, name) for name in _slots(kind) if hasattr(thing, name)}
    found |= getattr(thing, "__dict__", {})
    return {name: value for name, value in found.items() if not is_made_anew(kind, name)}


@cache
def is_made_anew(kind: type, name: str) -> bool:
    """Return whether the resumed run's own value of an attribute stays: see `made_anew` in the class."""
    return name in getattr(kind, "made_anew", ()) or isinstance(getattr(kind, name, None), cached_property)


@cache
def is_attribute(kind: type, name: str) -> bool:
    """Return whether an instance may have an attribute of that name, which hides nothing that its class does."""
    if not name.isidentifier() or (name.startswith("__") and name.endswith("__")) or is_made_anew(kind, name):
        return False
    known = getattr(kind, name, None)
    is_declared = name in _slots(kind) or name in getattr(kind, "__dataclass_fields__", ())
    return is_declared or not (callable(known) or hasattr(known, "__get__"))


@cache
def class_name(kind: type) -> str:
    """Return the name of a class in checkpoints."""
    return f"{kind.__module__}:{kind.__qualname__}"


def value_classes(modules: Collection[str]) -> dict[str, type]:
    """Return the classes whose instances a checkpoint may make, by name, as far as imported.

    Of this program they are values: dataclasses and NamedTuples, and whatever the estimators, which open nothing, are
    made of. Of other modules than Python's own, those of a user's objects, it is any class of no more than attributes.
    """
    others = {name for name in modules if name.partition(".")[0] not in sys.stdlib_module_names}
    found = {name: m for name, m in list(sys.modules.items()) if _is_ours(name) or name in others}
    named = [(name, c) for name, m in found.items() for c in getattr(m, "__dict__", {}).values()]
    classes = [c for name, c in named if isinstance(c, type) and c.__module__ == name]
    return {class_name(c): c for c in classes if may_be_made(c) and (_is_value(c) or not _is_ours(c.__module__))}


@cache
def may_be_made(kind: type) -> bool:
    """Return whether an instance of a class can be made, and dropped, without calling anything of the class."""
    is_data = is_named_tuple(kind) or _is_open(kind)
    return is_data and not hasattr(kind, "__del__") and not hasattr(kind, "to_checkpoint")


@cache
def _kind_of_all(kind: type) -> str | None:
    """Return the kind of all instances of a class."""
    if hasattr(kind, "to_checkpoint"):
        return "alive"
    if kind in _KINDS:
        return _KINDS[kind]
    if issubclass(kind, _FIXED) or kind is object:
        return "fixed"
    if is_named_tuple(kind):
        return "NamedTuple"
    if _is_open(kind):
        return "frozen" if is_frozen(kind) else "object"
    return None


def _is_ours(module: str) -> bool:
    return module.partition(".")[0] in ("cosim", "estimator")


def _is_value(kind: type) -> bool:
    return is_dataclass(kind) or is_named_tuple(kind) or kind.__module__.partition(".")[0] == "estimator"


@cache
def _is_open(kind: type) -> bool:
    """Return whether instances have no state but attributes: a class of Python's, without a base written in C."""
    is_python = all(c is object or c.__flags__ & _HEAP_TYPE for c in kind.__mro__)
    has_attributes = kind.__dictoffset__ != 0 or any("__slots__" in vars(c) for c in kind.__mro__)
    most = object.__basicsize__ + _WORD * (len(_slots(kind)) + 2)  # with their dictionary and weak references
    return is_python and has_attributes and kind.__basicsize__ <= most


@cache
def _slots(kind: type) -> list[str]:
    declared = [vars(c).get("__slots__", ()) for c in kind.__mro__]
    names = [name for some in declared for name in ((some,) if isinstance(some, str) else some)]
    return [name for name in names if name not in ("__dict__", "__weakref__")]


def _has_value(cell: CellType) -> bool:
    try:
        return cell.cell_contents is not cell
    except ValueError:
        return False
