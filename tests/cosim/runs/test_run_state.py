"""The state of a run is data: whatever it holds comes back to the bit, and nothing in it can be anything else."""

import json
import math
import random
import struct
import sys
import threading
from array import array
from collections import Counter, OrderedDict, deque
from dataclasses import dataclass, field
from functools import cached_property, partial
from io import StringIO
from pathlib import Path
from textwrap import TextWrapper
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.errors import NotResumableError
from cosim.retuning.lookahead import Lookahead
from cosim.runs.run_restoration import restore_state
from cosim.runs.run_state import StartObjects, encoded
from estimator import Sample
from estimator.sliding_window import ResidualWindow


class Box:
    """A run with one attribute, `content`, and whatever else is given at its start."""

    def __init__(self, content: Any = None, **others: Any) -> None:
        self.content = content
        vars(self).update(others)


def back(content: Any, old: Box | None = None, new: Box | None = None) -> Any:
    """The content that a run got after its start, once it is restored in another."""
    old, new = old or Box(), new or Box()
    start = StartObjects(old)
    old.content = content
    begun = StartObjects(new)
    restore_state(begun, encoded(start))
    return new.content


def bits(value: Any) -> Any:
    """A value that is equal only for equal types and bits."""
    if isinstance(value, float):
        return type(value), struct.pack("<d", value)
    if isinstance(value, complex):
        return type(value), struct.pack("<dd", value.real, value.imag)
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape, value.ndim > 1 and value.flags.f_contiguous, value.tobytes()
    if isinstance(value, tuple | list | deque):
        return type(value), [bits(item) for item in value]
    if isinstance(value, dict):
        return type(value), [(bits(k), bits(v)) for k, v in value.items()]
    return type(value), value


SCALARS = (
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=True) | st.text() | st.binary()
    | st.complex_numbers(allow_nan=True)
)  # fmt: skip
KEYS = st.text() | st.binary() | st.integers() | st.tuples(st.floats(allow_nan=False), st.text())
DATA = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner).flatmap(lambda a: st.sampled_from([a, tuple(a), deque(a)])) | st.dictionaries(KEYS, inner)
    ),
    max_leaves=20,
)


@given(DATA)
def test_data_come_back_to_the_bit(value):
    assert bits(back(value)) == bits(value)


class Pair(NamedTuple):
    a: Any
    b: Any


PECULIAR = {
    "a NaN with a payload": struct.unpack("<d", bytes.fromhex("010000000000f8ff"))[0],
    "minus zero in a list": [-0.0, math.inf, math.nan],
    "an integer of 128 bits": 2**127 + 1,
    "half of a surrogate pair": "\ud800",
    "a number of NumPy's": np.float64(0.1),
    "a flag of NumPy's": np.bool_(True),
    "an empty array": np.empty((0, 3)),
    "an array of one number": np.array(3.0),
    "an array in Fortran's order": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "an array of integers": np.arange(4, dtype=np.uint8),
    "a part of an array": np.arange(12.0)[::3],
    "the newest three": deque([1, 2, 3], maxlen=3),
    "a mapping in its order": OrderedDict([("b", 1), ("a", 2)]),
    "a mapping of tuples": {(1.0, 2.0): [np.zeros(2)]},
    "one of bytes": {b"\0\xff": 1},
    "counts": Counter("abca"),
    "a set": {1, "b", (2.0, 3.0)},
    "a frozen set": frozenset("ab"),
    "compact numbers": array("d", [1.0, 2.5]),
    "a sample": Sample(0.1, (1.0, 2.0), (), (math.nan,)),
    "tuples in tuples": ((1, (2, (3.0,))), [((),)]),
}


@pytest.mark.parametrize("value", PECULIAR.values(), ids=PECULIAR)
def test_peculiar_data_come_back_to_the_bit(value):
    found = back(value)
    if isinstance(value, Sample):
        assert bits(tuple(vars(found).values())) == bits(tuple(vars(value).values()))
    elif isinstance(value, OrderedDict):
        assert list(found.items()) == list(value.items())
        assert list(reversed(found)) == list(reversed(value))
    else:
        assert bits(found) == bits(value)
    assert getattr(found, "maxlen", None) == getattr(value, "maxlen", None)


def test_what_was_shared_is_shared_and_what_holds_itself_does_so_again():
    row: list[Any] = [np.zeros(2)]
    row += [row, (row,), {"row": row}]
    found = back([row, row[0]])
    row = found[0]
    assert row[1] is row
    assert row[2][0] is row
    assert row[3]["row"] is row
    assert found[1] is row[0]


@pytest.mark.parametrize("bits_of", [np.random.PCG64, np.random.MT19937, np.random.Philox, np.random.SFC64])
def test_a_random_generator_goes_on_with_its_numbers_and_its_children(bits_of):
    def rng():
        return np.random.Generator(bits_of(7))

    old, new = Box(rng=rng()), Box(rng=rng())
    old.rng.standard_normal(3)
    old.rng.spawn(2)
    later = np.random.Generator(bits_of(8))
    later.spawn(1)
    later.random()
    found = back(later, old, new)
    for was, now in ((old.rng, new.rng), (later, found)):
        assert now.random(3).tolist() == was.random(3).tolist()
        assert now.spawn(1)[0].random() == was.spawn(1)[0].random()


@dataclass
class Part:
    """A part of a user's, with things that are no data."""

    made_anew: ClassVar = ("cache",)
    function: Any
    names: list[str] = field(default_factory=list)
    lock: Any = field(default_factory=threading.Lock)
    path: Path = Path("x")
    cache: dict[str, int] = field(default_factory=dict)

    @cached_property
    def n(self) -> int:
        return len(self.names)

    def work(self) -> None: ...

    @property
    def is_long(self) -> bool:
        return self.n > 3


def box() -> Box:
    values, count = [1.0], 0

    def function():
        nonlocal count
        count += 1
        return count, sum(values)

    def outer():
        return function()

    files = {"model": Path("model.fmu")}
    first = Sample(0.0, (), (), ())
    held = {"values": values, "files": files, "outer": outer, "first": first}
    return Box(part=Part(function), method=values.append, some=partial(max, values), **held)


def test_what_is_no_data_stays_the_new_runs_own():
    old, new = box(), box()
    start, begun, own = StartObjects(old), StartObjects(new), {**vars(new), **vars(new.part)}
    old.method(2.0)
    old.part.function()
    old.part.names.append("a")
    old.part.cache["a"] = old.part.n
    old.part.n_starts = 1
    restore_state(begun, encoded(start))
    now = {**vars(new), **vars(new.part)}
    for name in ("function", "lock", "path", "cache", "method", "some"):
        assert now[name] is own[name]
    assert (new.part.cache, new.part.names, new.part.n_starts) == ({}, ["a"], 1)
    assert new.part.function() == (2, 3.0)  # what it holds has come back, too
    new.method(7.0)
    assert new.some() == 7.0


def test_an_attribute_that_was_removed_is_gone():
    old, new = Box(), Box()
    start, begun = StartObjects(old), StartObjects(new)
    del old.content
    restore_state(begun, encoded(start))
    assert not hasattr(new, "content")


class Own:
    """A class of a user's, from where one of the run's objects is, too."""

    def __init__(self) -> None:
        self.x = [1.0]


class OnItsWayOut:
    def __del__(self) -> None: ...


REFUSED = {
    "a generator": (lambda: (i for i in "ab"), "Box.content is a generator"),
    "hidden state": (random.Random, "Box.content is a Random"),
    "a stream": (StringIO, "Box.content is a StringIO"),
    "a new lock": (threading.Lock, "Box.content is a lock"),
    "a new function": (lambda: lambda: 1, "Box.content is a function"),
    "a class": (lambda: Own, "Box.content is a type"),
    "a path": (lambda: Path("/"), "Box.content is a PosixPath"),
    "a class of elsewhere": (lambda: [TextWrapper()], "an item of a list is a TextWrapper"),
    "a part of this program that is no value": (lambda: Lookahead.__new__(Lookahead), "Box.content is a Lookahead"),
    "an array of objects": (lambda: np.array([None]), "Box.content is a ndarray"),
    "what is called when it is dropped": (lambda: OnItsWayOut(), "Box.content is a OnItsWayOut"),
}


@pytest.mark.parametrize(("made", "told"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_data_and_not_there_at_the_start_is_refused_when_it_is_saved(made, told):
    old = Box()
    start = StartObjects(old)
    old.content = made()
    with pytest.raises(NotResumableError) as caught:
        encoded(start)
    assert str(caught.value) == f"its state cannot be saved: {told}, which is no data"


def test_an_object_of_the_users_is_made_anew():
    other = Own()
    other.x.append(math.nan)
    found = back([other])[0]
    assert type(found) is Own
    assert bits(found.x) == bits(other.x)


def test_a_function_that_is_replaced_is_refused_when_it_is_saved():
    old = box()
    start = StartObjects(old)
    old.part.function = old.some
    with pytest.raises(NotResumableError, match=r"Part\.function has changed, which is no data"):
        encoded(start)


def test_a_path_that_is_replaced_in_a_list_is_refused_when_it_is_saved():
    old = Box(paths=[Path("a")])
    start = StartObjects(old)
    old.paths[0] = "b"
    with pytest.raises(NotResumableError, match="an item of a list has changed, which is no data"):
        encoded(start)


def test_a_window_that_was_copied_keeps_the_residual_of_the_new_run():
    def made():
        return Box(window=ResidualWindow(lambda theta, sample: theta - sample.t, 1))

    old, new = made(), made()
    old_start, new_start = StartObjects(old), StartObjects(new)
    old.window.append(Sample(1.0, (), (), ()))
    old.content = old.window.copy()
    restore_state(new_start, encoded(old_start))
    assert new.content is not new.window
    assert new.content.residual(np.array([3.0])) == [2.0]


# Contents that nobody has written.


def forged(content: dict[str, Any], block: bytes = b"") -> bytes:
    return json.dumps(content).encode() + b"\n" + block


def number_of(start: StartObjects, thing: object) -> int:
    return next(i for i, known in enumerate(start.objects) if known is thing)


def part_with(name, value):
    """Another value for an attribute of the box's part."""

    def forge(content, start, run):
        content["contents"] = [[number_of(start, run.part), ["object", f"{__name__}:Part", [name, value]]]]

    return forge


def new(*nodes):
    """New objects; the first is the box's content."""

    def forge(content, start, run):
        content["new"] = list(nodes)
        content["contents"] = [[0, ["object", f"{__name__}:Box", ["content", ["n", 0]]]]]

    return forge


def at_the_start(kind, *rest):
    def forge(content, start, run):
        content["contents"] = [[number_of(start, run.values), [kind, *rest]]]

    return forge


FORGED = {
    "a class of the library's": new(["object", "subprocess:Popen", ["args", "x"]]),
    "a class of this program's that is no value": new(["object", "cosim.slaves.slave:Slave", []]),
    "a function for a class": new(["object", "os:system", []]),
    "a class that is imported elsewhere": new(["object", "cosim.runs.loop:Path", []]),
    "another class for an object": lambda content, start, run: content.update(
        contents=[[0, ["object", f"{__name__}:Part", []]]]
    ),
    "a function replaced": part_with("function", ["s", 0]),
    "a path replaced": part_with("path", "/etc"),
    "a method hidden": part_with("work", 1),
    "a property hidden": part_with("is_long", 1),
    "a class attribute hidden": part_with("made_anew", []),
    "another class": part_with("__class__", "x"),
    "no name": part_with("a b", 1),
    "what the run makes anew": part_with("cache", None),
    "no value": part_with("names", ["z", 1]),
    "bytes that are not there": part_with("names", ["bytes", {"b": 9}]),
    "a negative number of bytes": part_with("names", ["bytes", {"b": -1}]),
    "an object that is not there": part_with("names", ["s", 10**6]),
    "an object from behind": part_with("names", ["s", -1]),
    "a flag for a number": part_with("names", ["s", True]),
    "an unknown kind": new(["eval", "1"]),
    "code for a new object": new(["fixed"]),
    "a method for a new object": new(["method", ["s", 0]]),
    "objects in an array": new(["ndarray", {"b": 0}, "O", [0], "C"]),
    "fields in an array": new(["ndarray", {"b": 0}, "f8,i4", [0], "C"]),
    "another size of an array": new(["ndarray", {"b": 0}, "<f8", [7], "C"]),
    "a tuple in itself": new(["tuple", [["n", 0]]]),
    "a long way down": new(*(["tuple", [["n", i + 1]]] for i in range(10**5)), ["tuple", []]),
    "an unknown random generator": new(["Generator", "system", None, 0, 1, None]),
    "another kind for an object": at_the_start("dict", []),
    "code for an object": at_the_start("fixed"),
    "a text for a path in a mapping": lambda content, start, run: content.update(
        contents=[[number_of(start, run.files), ["dict", ["model", "/etc/passwd"]]]]
    ),
    "a number for a function in a function": lambda content, start, run: content.update(
        contents=[[number_of(start, run.outer), ["closure", [1]]]]
    ),
    "another value in a frozen object": lambda content, start, run: content.update(
        contents=[[number_of(start, run.first), ["frozen", "estimator.samples:Sample", ["t", 1.0]]]]
    ),
    "a number for a list": at_the_start("list", 3),
    "a state for what has none": lambda content, start, run: content.update(alive=[[0, 1]]),
    "another start": lambda content, start, run: content.update(start="0"),
    "no start": lambda content, start, run: content.pop("start"),
}


@pytest.mark.parametrize("forge", FORGED.values(), ids=FORGED)
def test_a_forged_state_is_refused(forge):
    run = box()
    start = StartObjects(run)
    content = {"start": start.digest, "contents": [], "new": [], "alive": []}
    restore_state(start, forged(content))  # as it is, it fits
    forge(content, start, run)
    with pytest.raises((ValueError, TypeError, KeyError, RecursionError)):
        restore_state(start, forged(content))


def mutated(value: Any, rng: random.Random, pool: list[Any]) -> Any:
    """A copy of JSON values, a few of which are others."""
    if rng.random() < 0.008:
        return rng.choice(pool)
    if isinstance(value, list):
        items = [mutated(item, rng, pool) for item in value]
        if items and rng.random() < 0.008:
            items[rng.randrange(len(items)) :] = rng.sample(items, rng.randrange(len(items)))
        return items
    if isinstance(value, dict):
        return {key: mutated(item, rng, pool) for key, item in value.items()}
    return value


EVENTS = (
    "import",
    "exec",
    "compile",
    "open",
    "os.",
    "subprocess.",
    "pickle.",
    "socket.",
    "ctypes.",
    "code.",
    "marshal.",
)
"""Events of `sys.audit` that restoring data has no part in."""
heard: list[str] | None = None


def listen(event, _):
    if heard is not None and event.startswith(EVENTS):
        heard.append(event)


@pytest.mark.parametrize("seed", range(10))
def test_whatever_is_in_a_state_nothing_is_called(seed):
    """It fits, or it is refused; meanwhile Python imports, opens, compiles and starts nothing."""
    global heard
    old = box()
    start = StartObjects(old)
    old.content = [Sample(0.1, (1.0, math.nan), (), ()), {b"k": deque([np.zeros((2, 2))], 3)}, np.random.default_rng(3)]
    text, _, block = encoded(start).partition(b"\n")
    whole, rng, outcomes = json.loads(text), random.Random(seed), Counter()
    pool = [None, True, -1, 0, 1, 7, 2**70, 1e308, "", "list", "object", "fixed", "os:system", "subprocess:Popen",
            "__class__", "<f8", "O", [], ["n", 0], ["n", 1], ["s", 0], ["s", 1], ["s", 2], ["bytes", {"b": 1}],
            ["tuple", [["n", 0]]], ["object", "builtins:eval", []], {"b": 3}, {"b": -1}]  # fmt: skip
    sys.addaudithook(listen)
    for _ in range(300):
        state = forged(mutated(whole, rng, pool), block)
        begun = StartObjects(box())
        heard = []
        try:
            restore_state(begun, state)
            outcomes["fits"] += 1
        except Exception as e:
            outcomes[type(e).__name__] += 1
        finally:
            found, heard = heard, None
        assert found == []
    assert 20 < outcomes["fits"] < 250
    assert len(outcomes) > 3
