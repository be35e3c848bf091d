"""Restoration of a run's state in a run made anew: see `cosim.runs.run_state`.

Nothing is imported, and nothing called but what gives containers, arrays and random generators their content. The file
may hold anything: whatever does not fit the run ends in an exception.
"""

import json
from array import array
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from typing import Any, Final, Literal

import numpy as np

from .run_objects import NUMBERS, attributes, cells, class_name, is_attribute, kind_of, parts
from .run_state import COMPLEX, DOUBLE, KEPT, StartObjects

_EMPTY: Final[Mapping[str, Callable[[], Any]]] = {
    "list": list, "dict": dict, "OrderedDict": OrderedDict, "Counter": Counter, "set": set,
}  # fmt: skip
_BITS: Final[Mapping[str, Callable[..., Any]]] = {
    c.__name__: c for c in (np.random.PCG64, np.random.PCG64DXSM, np.random.MT19937, np.random.Philox, np.random.SFC64)
}
_ORDER: Final[Mapping[str, int]] = {"dict": 1, "OrderedDict": 1, "Counter": 1, "set": 1, "Generator": 2}
"""Order of filling: keys need their attributes, generators their state."""
_MOST_SPAWNED: Final = 100_000


def restore_state(start: StartObjects, encoded: bytes) -> None:
    """Give the objects of a run, as it is at its start, the content that they had. Raises whatever does not fit."""
    _Restoration(start, encoded).restore()


class _Restoration:
    def __init__(self, start: StartObjects, encoded: bytes) -> None:
        text, _, block = encoded.partition(b"\n")
        rest = BytesIO(block)

        def taken(found: dict[str, Any]) -> Any:
            return rest.read(_length(found["b"], block)) if set(found) == {"b"} else found

        content = json.loads(text, object_hook=taken)
        if content["start"] != start.digest:
            raise ValueError("another run begins otherwise")
        self._start, self._content = start, content
        self._made: dict[int, Any] = {}
        self._is_under_way: set[int] = set()

    def restore(self) -> None:
        """Make the new objects and fill them and those of the start; live parts come last."""
        objects = self._start.objects
        filled: list[tuple[Any, int | None, list[Any]]] = []
        for number, content in self._content["contents"]:
            thing = objects[_place(number, objects)]
            if kind_of(thing) != content[0] or content[0] in KEPT:
                raise ValueError(f"a {kind_of(thing)} where there was a {content[0]}")
            filled.append((thing, number, content))
        filled += [(self._new(j), None, content) for j, content in enumerate(self._content["new"])]
        for thing, number, content in sorted(filled, key=lambda part: _ORDER.get(part[2][0], 0)):
            self._fill(thing, number, content)
            code = {} if number is None else self._start.code[number]
            now = parts(thing) if code else {}
            if any(now.get(name) is not value for name, value in code.items()):
                raise ValueError("data in the place of a function or the like")
        for number, saved in self._content["alive"]:
            live: Any = objects[_place(number, objects)]
            if kind_of(live) != "alive":
                raise ValueError("a state for what has none")
            live.from_checkpoint(self._value(saved))

    def _value(self, value: Any) -> Any:
        if value is None or isinstance(value, bool | int | float | str):
            return value
        match value:
            case ["s", int(number)]:
                return self._start.objects[_place(number, self._start.objects)]
            case ["n", int(number)]:
                return self._new(number)
            case ["bytes", bytes(content)]:
                return content
            case ["float", bytes(content)]:
                return DOUBLE.unpack(content)[0]
            case ["complex", bytes(content)]:
                return complex(*COMPLEX.unpack(content))
            case ["scalar", str(kind), bytes(content)]:
                return np.frombuffer(content, _number_type(kind), 1)[0]
            case _:
                raise ValueError("no value")

    def _items(self, items: Any) -> list[Any]:
        return array("d", items).tolist() if isinstance(items, bytes) else [self._value(item) for item in items]

    def _new(self, number: int) -> Any:
        """Return a new object; but for immutable ones it is still empty."""
        if number not in self._made:
            if number in self._is_under_way:
                raise ValueError("a tuple in itself")
            self._is_under_way.add(number)
            new = self._content["new"]
            self._made[number] = self._empty(*new[_place(number, new)])
        return self._made[number]

    def _empty(self, kind: str, *content: Any) -> Any:
        match kind:
            case "tuple":
                return tuple(self._items(content[0]))
            case "frozenset":
                return frozenset(self._items(content[0]))
            case "deque":
                return deque(maxlen=content[1])
            case "NamedTuple":
                made: Any = self._class(content[0])
                items = self._items(content[1])
                if len(items) != len(made._fields):
                    raise ValueError(f"{len(items)} items")
                return tuple.__new__(made, items)
            case "object" | "frozen":
                return object.__new__(self._class(content[0]))
            case "ndarray":
                return _array(*content)
            case "array.array":
                return _compact(content[0], b"")
            case "Generator":
                seed = np.random.SeedSequence(self._value(content[3]), spawn_key=self._value(content[4]))
                return np.random.Generator(_BITS[content[0]](seed))
            case _:
                return _EMPTY[kind]()

    def _class(self, name: str) -> type:
        made = self._start.made(name)
        if made is None:
            raise ValueError(f"no objects of {name}")
        return made

    def _fill(self, thing: Any, number: int | None, content: list[Any]) -> None:
        """Give an object its content."""
        match content[0]:
            case "object" | "frozen":
                self._set_attributes(thing, number, content)
            case "ndarray" if number is not None and thing.flags.writeable:
                saved = _array(*content[1:])
                if (saved.shape, saved.dtype) != (thing.shape, thing.dtype):
                    raise ValueError(f"an array {saved.shape}, not {thing.shape}")
                thing[...] = saved
            case "array.array":
                thing[:] = _compact(thing.typecode, content[2])
            case "Generator":
                self._seed(thing, content)
            case "list" | "deque" | "set" | "dict" | "OrderedDict" | "Counter" | "closure":
                _fill_container(thing, content[0], self._items(content[1]))
            case _:
                pass

    def _set_attributes(self, thing: Any, number: int | None, content: list[Any]) -> None:
        kind, (_, name, saved) = type(thing), content
        if class_name(kind) != name:
            raise ValueError(f"a {class_name(kind)}, not a {name}")
        code = self._start.code.get(number, {}) if number is not None else {}
        values = dict(zip(saved[::2], self._items(saved[1::2]), strict=True))
        for name, value in values.items():
            if name in code or not is_attribute(kind, name):
                raise ValueError(f"{name} is no attribute of a {kind.__name__} that changes")
            object.__setattr__(thing, name, value)
        for name in attributes(thing).keys() - values.keys() - code.keys():
            object.__delattr__(thing, name)

    def _seed(self, rng: np.random.Generator, content: list[Any]) -> None:
        bits: Any = rng.bit_generator
        _, kind, state, n_spawned, *_ = content
        if type(bits).__name__ != kind:
            raise ValueError(f"{type(bits).__name__}, not {kind}")
        bits.state = self._value(state)
        missing = (n_spawned or 0) - getattr(bits.seed_seq, "n_children_spawned", 0)
        if not 0 <= missing <= _MOST_SPAWNED:
            raise ValueError(f"{n_spawned} generators spawned")
        if missing:
            bits.seed_seq.spawn(missing)


def _fill_container(container: Any, kind: str, items: list[Any]) -> None:
    if kind == "closure":
        for cell, value in zip(cells(container), items, strict=True):
            cell.cell_contents = value
        return
    container.clear()
    if kind in ("list", "deque"):
        container.extend(items)
    elif kind == "set":
        container.update(items)
    else:
        for key, value in zip(items[::2], items[1::2], strict=True):
            container[key] = value


def _place(number: object, items: list[Any]) -> int:
    """Return a place in items. Raises ValueError for one outside, negative ones too."""
    if type(number) is not int or not 0 <= number < len(items):
        raise ValueError(f"no object {number}")
    return number


def _length(length: object, block: bytes) -> int:
    if type(length) is not int or not 0 <= length <= len(block):
        raise ValueError(f"no {length} bytes")
    return length


def _number_type(name: str) -> np.dtype[Any]:
    kind = np.dtype(name)
    if kind.kind not in NUMBERS or kind.shape or kind.names:
        raise ValueError(f"no numbers: {name}")
    return kind


def _compact(typecode: Literal["d"], content: bytes) -> "array[Any]":
    if typecode not in "bBhHiIlLqQfd":  # texts are deprecated
        raise ValueError(f"no numbers: {typecode}")
    return array(typecode, content)


def _array(content: bytes, kind: str = "<f8", shape: Sequence[int] | None = None, order: Any = "C") -> Any:
    number_type = _number_type(kind)
    whole = np.frombuffer(content, number_type) if content else np.empty(0, number_type)
    return whole.reshape(-1 if shape is None else shape, order=order).copy(order)
