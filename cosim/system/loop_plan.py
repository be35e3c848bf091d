"""The plan of a closed loop of shadows in a process of its own, and the bytes in which it goes there."""

import struct
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from ..slaves.slave import OutOfRange
from ..units import Linear
from .master import Wiring

_LENGTH: Final = struct.Struct("<I")


class LoopPlan(NamedTuple):
    """FMUs and their wiring. It crosses to the loop's process as a list."""

    instance_name: str
    """Name of the loop in messages."""
    folder: str
    """Folder that the FMUs are unpacked into."""
    paths: Mapping[str, str]
    """File of each FMU or table."""
    tolerances: Mapping[str, float | None]
    """Relative tolerance for the solver of each."""
    wiring: Mapping[str, Any]
    """Wiring of each, as `listed` returns it."""
    groups: Sequence[Sequence[str]]
    """Groups in which they step."""
    tracked: Sequence[tuple[str, str]]
    """Pairs of outputs that shall be equal."""
    span: tuple[float, float]
    """Start and stop time [s]."""
    timeout: float
    """Time that each call of an FMU may take [s]."""
    out_of_range: OutOfRange
    """Whether a value outside its minimum and maximum is a fault."""
    folders: Mapping[str, str]
    """Folder of each FMU that has been unpacked already; Python keeps there what it compiles of it."""


def listed(w: Wiring) -> Any:
    """Return a wiring as JSON values."""
    conversions = {name: [linear.factor, linear.offset] for name, linear in w.conversions.items()}
    return [dict(w.sources), w.tunables, w.outputs, dict(w.start), conversions, w.disturbances]


def wiring_of(values: Any) -> Wiring:
    """Return the wiring of `listed`'s values."""
    sources, tunables, outputs, start, conversions, disturbances = values
    linear = {name: Linear(*of) for name, of in conversions.items()}
    return Wiring(sources, tuple(tunables), tuple(outputs), start, linear, tuple(disturbances))


def named_state(name: str, state: bytes) -> bytes:
    """Return an FMU's state with its name as bytes."""
    return _LENGTH.pack(len(name.encode())) + name.encode() + state


def name_and_state(message: bytes) -> tuple[str, bytes]:
    """Return name and state in the bytes of `named_state`."""
    end = _LENGTH.size + _LENGTH.unpack_from(message)[0]
    return message[_LENGTH.size : end].decode(), message[end:]


def fit_together(fmus: Sequence[Path]) -> bool:
    """Return whether FMUs may share a process: none ships another module or library by a name that one of them has.

    Python and the loader would take the first for the second, and run its code.
    """
    shipped: dict[str, int] = {}
    try:
        return all(shipped.setdefault(name, checksum) == checksum for fmu in fmus for name, checksum in _shipped(fmu))
    except (OSError, zipfile.BadZipFile):  # whoever opens them says why
        return False


def _shipped(fmu: Path) -> Iterator[tuple[str, int]]:
    """Yield name and checksum of each Python module and each library in an FMU. Raises OSError, zipfile.BadZipFile."""
    with zipfile.ZipFile(fmu) as archive:
        for entry in archive.infolist():
            if entry.filename.startswith("resources/") and entry.filename.endswith(".py"):
                yield entry.filename, entry.CRC
            elif entry.filename.startswith("binaries/"):
                yield entry.filename.rpartition("/")[2], entry.CRC
