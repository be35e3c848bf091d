"""State of a run as data: numbers, texts, arrays and the references between them; no code, and nothing to import.

A run is a graph of objects. Those that it has at its start are numbered in the order in which a walk from the run finds
them. A run made anew from the same scenario has the same ones, which get their content back in place; so functions,
FMUs and whatever else is no data stay the new run's own. Objects from later are made anew, of classes that
`cosim.runs.run_objects` allows. What two parts share stays shared.

The state is a line of JSON, and a block of bytes after it:

    {"start": digest of the graph at the start, "contents": [[number, content], ...], "new": [content, ...],
     "alive": [[number, value], ...]}

A value is null, a boolean, a number, a text, or a list whose first item says what the rest is: ["s", number] an object
of the start, ["n", number] a new one, ["float", bytes] a NaN or an infinity, and so on. Bytes are {"b": length}:
the next so many of the block.
"""

import json
import struct
from array import array
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from hashlib import sha256
from math import isfinite
from typing import Any, Final

import numpy as np

from ..errors import NotResumableError
from .run_objects import (
    INLINE,
    NUMBERS,
    cells,
    class_name,
    is_attribute,
    is_code,
    is_constant,
    kind_of,
    may_be_made,
    parts,
    value_classes,
)

DOUBLE: Final = struct.Struct("<d")
COMPLEX: Final = struct.Struct("<dd")
KEPT: Final = ("tuple", "NamedTuple", "frozen", "method", "partial", "fixed")
"""Kinds of objects at the start that themselves stay as they are."""
_NEVER_NEW: Final = ("fixed", "method", "partial", "closure", "alive", None)


class StartObjects:
    """Objects that a run has at its start, in the order in which they are found."""

    def __init__(self, run: object) -> None:
        walk = _Walk(None)
        walk.value(run, None, "")
        for thing, kind, number in walk.pending_objects():
            if kind not in (None, "alive"):
                walk.content(thing, kind, number)
        self.objects = walk.found
        """The objects, by number."""
        self.numbers = walk.numbers
        """Number of each, by id."""
        self.digest = walk.digest.hexdigest()
        self.code: dict[int, dict[Any, object]] = {
            number: {name: value for name, value in parts(thing).items() if is_code(value)}
            for number, thing in enumerate(self.objects)
        }
        """Functions, paths and the like, by the number of the object that holds them, and by name or place there."""
        classes = {type(thing) for thing in self.objects if kind_of(thing) in ("object", "frozen", "NamedTuple")}
        self._classes = {class_name(c): c for c in classes if may_be_made(c)}

    def made(self, name: str) -> type | None:
        """Return the class of that name, if a checkpoint may make instances of it."""
        if name not in self._classes:
            self._classes = value_classes({c.__module__ for c in self._classes.values()}) | self._classes
        return self._classes.get(name)


def encoded(start: StartObjects) -> bytes:
    """Return the present state of the run. Raises NotResumableError where a part of it is no data."""
    walk = _Walk(start)
    walk.value(start.objects[0], None, "")
    contents: list[Any] = []
    new: list[Any] = []
    alive: list[Any] = []
    for thing, kind, number in walk.pending_objects():
        if kind == "alive":
            live: Any = thing
            alive.append([number, walk.value(live.to_checkpoint(), thing, "to_checkpoint()")])
            continue
        content = walk.content(thing, kind, number)
        if number is None:
            new.append(content)
        elif kind not in KEPT:
            contents.append([number, content])
    blocks: list[bytes] = []

    def placed(block: bytes) -> dict[str, int]:
        blocks.append(block)
        return {"b": len(block)}

    state = {"start": start.digest, "contents": contents, "new": new, "alive": alive}
    text = json.dumps(state, separators=(",", ":"), allow_nan=False, default=placed)
    return b"\n".join([text.encode(), b"".join(blocks)])


class _Walk:
    """Walk through the objects of a run, each once; without a start it numbers them, otherwise it says what is new."""

    def __init__(self, start: StartObjects | None) -> None:
        self._start = start
        self.found: list[object] = []
        self.numbers: dict[int, int] = {}
        self.digest = sha256()
        self._seen: set[int] = set()
        self._pending: deque[tuple[object, str | None, int | None]] = deque()

    def pending_objects(self) -> Iterable[tuple[object, str | None, int | None]]:
        """Yield each object with its kind and its number at the start, or None, while the walk goes on."""
        while self._pending:
            yield self._pending.popleft()

    def value(self, value: Any, owner: object, name: object) -> Any:
        """Return a value of an owner's as JSON, with bytes left in it."""
        kind = type(value)
        if kind in INLINE:
            return value
        if kind is float:
            return value if isfinite(value) else ["float", DOUBLE.pack(value)]
        if kind is bytes:
            return ["bytes", value]
        if kind is complex:
            return ["complex", COMPLEX.pack(value.real, value.imag)]
        if isinstance(value, np.generic) and value.dtype.kind in NUMBERS:
            return ["scalar", value.dtype.str, value.tobytes()]
        return self._reference(value, owner, name)

    def _reference(self, thing: object, owner: object, name: object) -> Any:
        kind = kind_of(thing)
        if self._start is None:
            if kind == "tuple" and is_constant(thing):
                return None
            if id(thing) not in self.numbers:
                self.digest.update(f"{self.numbers.get(id(owner))} {name} {class_name(type(thing))}\n".encode())
                self._add(thing, kind, len(self.found))
            return None
        if (number := self._start.numbers.get(id(thing))) is not None and kind is not None:
            if number not in self._seen:
                self._seen.add(number)
                self._pending.append((thing, kind, number))
            return ["s", number]
        if id(thing) not in self.numbers:
            is_named = kind in ("object", "frozen", "NamedTuple")
            if kind in _NEVER_NEW or (is_named and self._start.made(class_name(type(thing))) is None):
                raise NotResumableError(f"its state cannot be saved: {_place(owner, name)} is {_named(thing)}")
            self._add(thing, kind, None)
        return ["n", self.numbers[id(thing)]]

    def _add(self, thing: object, kind: str | None, number: int | None) -> None:
        self.numbers[id(thing)] = len(self.found)
        self.found.append(thing)  # so that its id stays its own
        self._pending.append((thing, kind, number))

    def content(self, thing: Any, kind: str | None, number: int | None) -> list[Any]:
        """Return the content of an object as JSON, with bytes left in it."""
        if self._start is not None and number is not None and kind not in KEPT:
            self._check_code(thing, self._start.code[number])
        match kind:
            case "object" | "frozen":
                return [kind, class_name(type(thing)), self._attributes(thing, kind, number)]
            case "NamedTuple":
                return [kind, class_name(type(thing)), self._items(thing, thing)]
            case "ndarray":
                return [kind, *_numbers(thing)]
            case "array.array":
                return [kind, thing.typecode, thing.tobytes()]
            case "Generator":
                return [kind, *self._generator(thing)]
            case "deque":
                return [kind, self._items(thing, thing), thing.maxlen]
            case _:
                return [kind, self._items(thing, self._parts(thing, kind))]

    def _parts(self, thing: Any, kind: str | None) -> Sequence[Any]:
        match kind:
            case "tuple" | "list":
                return thing
            case "set" | "frozenset":
                return sorted(thing, key=repr) if self._start is None else tuple(thing)
            case "dict" | "OrderedDict" | "Counter":
                return [item for pair in thing.items() for item in pair]
            case "method":
                return (thing.__self__,)
            case "partial":
                return (thing.func, thing.args, thing.keywords)
            case "closure":
                return [cell.cell_contents for cell in cells(thing)]
            case _:
                return ()

    def _check_code(self, thing: object, code: Mapping[Any, object]) -> None:
        """Raise NotResumableError where a function or the like is not the one that was there at the start."""
        if not code:
            return
        now = parts(thing)
        for name, value in code.items():
            if now.get(name) is not value:
                where = _place(thing, name)
                raise NotResumableError(f"its state cannot be saved: {where} has changed, which is no data")

    def _items(self, owner: object, items: Sequence[Any]) -> Any:
        if len(items) > 1 and all(type(item) is float for item in items):
            return array("d", items).tobytes()
        return [self.value(item, owner, i) for i, item in enumerate(items)]

    def _attributes(self, thing: object, kind: str, number: int | None) -> list[Any]:
        is_kept = self._start is None or (kind == "frozen" and number is not None)
        code = {} if is_kept or number is None or self._start is None else self._start.code[number]
        found: list[Any] = []
        for name, value in parts(thing).items():
            saved = self.value(value, thing, name)
            if not is_kept and name not in code and not is_attribute(type(thing), name):
                raise NotResumableError(f"its state cannot be saved: {_place(thing, name)} hides what its class has")
            found += [] if name in code else [name, saved]
        return found

    def _generator(self, rng: np.random.Generator) -> list[Any]:
        bits, seed = rng.bit_generator, rng.bit_generator.seed_seq
        known = [getattr(seed, name, None) for name in ("n_children_spawned", "entropy", "spawn_key")]
        return [type(bits).__name__, *(self.value(v, rng, "state") for v in (bits.state, *known))]


def _numbers(values: np.ndarray[Any, Any]) -> list[Any]:
    if values.ndim == 1 and values.dtype == np.float64:
        return [values.tobytes()]
    order = "F" if values.flags.f_contiguous and not values.flags.c_contiguous else "C"
    return [values.tobytes(order), values.dtype.str, values.shape, order]


def _place(owner: object, name: object) -> str:
    whose = type(owner).__name__
    return f"{whose}.{name}" if isinstance(name, str) else f"an item of a {whose}"


def _named(thing: object) -> str:
    return f"a {type(thing).__name__}, which is no data"
