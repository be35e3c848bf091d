"""Limit of linear algebra to one thread: a second one is slower here, and their number changes bits."""

import os
from collections.abc import Generator
from contextlib import contextmanager
from importlib import import_module
from typing import Final

_OPENBLAS: Final = "OPENBLAS_NUM_THREADS"
ONE_THREAD: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", _OPENBLAS, "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)
"""Environment variables to be set before NumPy is loaded."""


@contextmanager
def one_thread() -> Generator[None]:
    """Yield while linear algebra has one thread; also a decorator."""
    from threadpoolctl import threadpool_limits  # here: an FMU's process needs the variables alone

    if os.environ.get(_OPENBLAS) != "1":
        import_module("scipy.linalg")  # with a library of its own, which would not be limited if it came later
    with threadpool_limits(1):
        yield
