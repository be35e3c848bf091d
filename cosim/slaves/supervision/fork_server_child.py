"""The program of a fork server: it imports what serves an FMU, and copies itself for each process that is asked for."""

import ctypes
import gc
import importlib
import json
import os
import socket
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final, NoReturn

from .descendants import VARIABLE

GO: Final = b"g"
"""Byte on its standard input that a copy waits for before it serves."""
_IMPORTED: Final = "cosim.slaves.child"
"""Program that is imported in the server; the others, which import the most of it too, in their copies."""
_OF_PYTHONFMU: Final = (
    "argparse", "ctypes", "datetime", "hashlib", "inspect", "logging", "tempfile", "uuid", "xml.dom.minidom",
    "xml.etree.ElementTree", "zipfile",
)  # fmt: skip
"""Modules of the standard library that an FMU made by pythonfmu imports; nothing else of an FMU's is loaded here."""


def main(control: str) -> NoReturn:
    """Serve the process at the other end of a socket until that is closed.

    A request has the program, the mark and the working folder of a new process, and its standard input, channel and
    standard error; the answer is its process id.
    """
    for name in (_IMPORTED, *_OF_PYTHONFMU):
        importlib.import_module(name)
    place = _place_of_mark()
    gc.freeze()  # a collection in a copy would copy every page
    with socket.socket(fileno=int(control)) as requests:
        while True:
            order, descriptors, _, _ = socket.recv_fds(requests, 1 << 16, 3)
            if not order:
                os._exit(0)
            program, mark, folder = json.loads(order)
            requests.send(str(_copy(requests, place, program, mark, folder, descriptors)).encode())
            for descriptor in descriptors:
                os.close(descriptor)


def _copy(
    requests: socket.socket,
    place: int,
    program: str,
    mark: str,
    folder: str | None,
    descriptors: Sequence[int],
) -> int:
    """Return the process id of a copy, whose parent has ended: it is a child of the process that has asked for it."""
    reading, writing = os.pipe()
    if (parent := os.fork()) == 0:
        try:
            if (copy := os.fork()) == 0:
                os.setpgid(0, 0)
                os.close(reading)
                os.close(writing)
                requests.close()
                _become(place, program, mark, folder, *descriptors)
            with suppress(OSError):  # both do, whichever comes first
                os.setpgid(copy, copy)
            os.write(writing, str(copy).encode())
        finally:
            os._exit(0)
    os.close(writing)
    try:
        os.waitpid(parent, 0)
        return int(os.read(reading, 64))
    finally:
        os.close(reading)


def _become(place: int, program: str, mark: str, folder: str | None, stdin: int, channel: int, stderr: int) -> NoReturn:
    """Take over the standard streams, and serve a program."""
    try:
        os.dup2(stdin, 0)
        os.dup2(stderr, 2)
        os.close(stdin)
        os.close(stderr)
        ctypes.memmove(place, mark.encode(), len(mark))
        os.environ[VARIABLE] = mark
        serve: Callable[[str], NoReturn] = importlib.import_module(program).main
        if folder is not None:
            os.chdir(folder)
        if os.read(0, len(GO)) == GO:
            serve(f"packet:{channel}")
        os._exit(0)  # whoever has asked for it does not know it
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
    os._exit(1)


def _place_of_mark() -> int:
    """Return the address of the mark that /proc shows of this process and of its copies."""
    libc: Any = ctypes.CDLL(None)
    libc.getenv.restype = ctypes.c_void_p
    return int(libc.getenv(VARIABLE.encode()))
