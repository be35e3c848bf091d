"""ELF files with an end to their reading: a made-up table may refer to itself, or have 2^64 entries of no bytes."""

import struct
from typing import Any, BinaryIO, Final

from elftools.common.exceptions import ELFError
from elftools.elf.elffile import ELFFile

MOST_READS: Final = 500_000
"""Reads of one file: a large library takes some thousands, one that would be read for ever as many as it is given."""

DAMAGED: Final = (
    ELFError,
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    MemoryError,
    RecursionError,
    TypeError,
    ValueError,
    struct.error,
)
"""Errors that pyelftools raises while it reads a damaged file."""


def opened_elf(file: BinaryIO) -> ELFFile:
    """Return an ELF file that raises ELFError once it has been read from too often, or where it is none."""
    bounded: Any = _BoundedFile(file)
    return ELFFile(bounded)


class _BoundedFile:
    """A binary file of which only so much is read; pyelftools itself follows every table to its end."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._n_reads = file, 0
        self.tell = file.tell

    def seek(self, offset: int, whence: int = 0) -> int:
        try:
            return self._file.seek(offset, whence)
        except (OSError, OverflowError, ValueError) as e:  # offsets of a damaged file
            raise ELFError("it points outside the file") from e

    def read(self, size: int = -1) -> bytes:
        self._n_reads += 1
        if self._n_reads > MOST_READS:
            raise ELFError("its tables have no end")
        return self._file.read(size)
