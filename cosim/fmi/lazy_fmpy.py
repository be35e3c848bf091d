"""FMPy for a process that needs its interfaces to the FMI only: the rest of it is loaded when somebody asks for it.

FMPy loads NumPy, its XML model and its solvers with itself: two thirds of the time in which an FMU's process starts.
"""

import sys
from collections.abc import Generator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType
from typing import Final, NamedTuple

_LATER: Final = ("fmpy.model_description", "fmpy.simulation", "fmpy.util")
"""Modules that FMPy imports names from, and that need most of the time."""


class _Promise(NamedTuple):
    """A name of FMPy's whose module is not loaded yet."""

    module: str


def load_fmpy_lazily() -> None:
    """Import FMPy without those modules, unless it is imported already; their names load them on first use."""
    if "fmpy" in sys.modules:
        return
    for name in _LATER:
        sys.modules[name] = _stand_in(name)
    try:
        fmpy = import_module("fmpy")
    finally:
        for name in _LATER:
            del sys.modules[name]
    promised = {name: value.module for name, value in vars(fmpy).items() if isinstance(value, _Promise)}
    for name in promised:
        delattr(fmpy, name)

    def kept(name: str) -> object:
        if name not in promised:
            raise AttributeError(f"module 'fmpy' has no attribute {name!r}")
        value = getattr(import_module(promised[name]), name)
        setattr(fmpy, name, value)
        return value

    setattr(fmpy, "__getattr__", kept)  # noqa: B010  PEP 562: a module may have one


@contextmanager
def lazy_numpy() -> Generator[None]:
    """Load NumPy within the block only when a name of it is used: FMPy's reader imports it, for sizes in FMI 3.0."""
    if "numpy" in sys.modules:
        yield
        return
    stand_in = sys.modules["numpy"] = ModuleType("numpy")

    def used(name: str) -> object:
        if sys.modules.get("numpy") is stand_in:
            del sys.modules["numpy"]
        return getattr(import_module("numpy"), name)

    setattr(stand_in, "__getattr__", used)  # noqa: B010
    try:
        yield
    finally:
        if sys.modules.get("numpy") is stand_in:
            del sys.modules["numpy"]


def _stand_in(name: str) -> ModuleType:
    """Return a module that promises every name."""
    module = ModuleType(name)
    setattr(module, "__getattr__", lambda _: _Promise(name))  # noqa: B010
    return module
