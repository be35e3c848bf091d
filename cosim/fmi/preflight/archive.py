"""Check from its directory that a zip archive can be unpacked safely: nothing is decompressed."""

import stat
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipInfo

from ...findings import Finding, warning

LARGEST: Final = 4 << 30
"""Largest number of bytes of all files, unpacked."""
MOST_FILES: Final = 50_000
HIGHEST_RATIO: Final = 200
"""Largest ratio of unpacked to packed bytes, for more than SMALL bytes: text and tables reach 20, zeros 1000."""
SMALL: Final = 256 << 20
"""Bytes that do no harm, however well they are packed."""
LONGEST_NAME: Final = 1000
"""Characters: with the folder before it a path must stay below 4096 bytes."""

_PLACE: Final = "archive"
_ENCRYPTED: Final = 0x1
_LOCAL_HEADER: Final = 30  # bytes before name and content of an entry


def archive_findings(entries: Sequence[ZipInfo]) -> Iterator[Finding]:
    """Yield problems with the entries of an archive."""
    unpacked, packed = sum(e.file_size for e in entries), sum(e.compress_size for e in entries)
    if len(entries) > MOST_FILES:
        yield Finding(_PLACE, f"holds {len(entries)} files; at most {MOST_FILES} are unpacked")
    if unpacked > LARGEST:
        yield Finding(_PLACE, f"unpacks to {unpacked / 1e9:.3g} GB; at most {LARGEST / 1e9:.3g} GB are unpacked")
    if unpacked > SMALL and unpacked > HIGHEST_RATIO * packed:
        yield Finding(_PLACE, f"unpacks to {unpacked / max(packed, 1):.0f} times its size, as only a zip bomb does")
    for entry in entries:
        yield from _entry_findings(entry)
    yield from _name_findings([e for e in entries if len(e.filename) <= LONGEST_NAME])
    yield from _overlaps(entries)


def _entry_findings(entry: ZipInfo) -> Iterator[Finding]:
    name, kind = entry.orig_filename, stat.S_IFMT(entry.external_attr >> 16)
    where = repr(name if len(name) <= LONGEST_NAME else f"{name[:50]}...")
    if leads_out(name):
        yield Finding(where, "would be put outside its folder; names must be relative, with '/' and without '..'")
    if len(name) > LONGEST_NAME or any(len(part.encode()) > 255 for part in name.split("/")):
        yield Finding(where, "has a name that is too long for a file")
    if not name.isprintable():
        yield Finding(where, "has a name with control characters")
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        what = "symbolic link" if kind == stat.S_IFLNK else "device or pipe"
        yield Finding(where, f"is a {what}; an FMU must hold files and folders only")
    if entry.flag_bits & _ENCRYPTED:
        yield Finding(where, "is encrypted; an FMU must not be")
    if entry.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
        yield warning(where, f"is packed by method {entry.compress_type}; FMI allows deflate (8) and stored (0) only")


def leads_out(name: str) -> bool:
    """Return whether a file of this name in an archive might be written outside the folder it is unpacked to."""
    is_odd = any(c in name for c in "\\:\0")  # Windows' separator, its drives, and what ends a name in C
    return is_odd or not name or name.startswith("/") or ".." in name.split("/")


def _name_findings(entries: Sequence[ZipInfo]) -> Iterator[Finding]:
    """Yield names that denote the same file: in the archive, once it is unpacked, or on systems that ignore case."""
    counts, folded = Counter(_unpacked(e.filename) for e in entries), dict[str, str]()
    contents: dict[str, set[tuple[str, int, int]]] = {}
    for e in entries:
        contents.setdefault(_unpacked(e.filename), set()).add((e.filename, e.CRC, e.file_size))
    for name, count in counts.items():
        if len(contents[name]) > 1:
            yield Finding(repr(name), f"is in the archive {count} times; it is not known which is meant")
        elif count > 1:  # whichever is read, it is the same
            yield warning(repr(name), f"is in the archive {count} times, with the same content; once is enough")
        if (other := folded.setdefault(name.casefold(), name)) != name:
            yield warning(repr(name), f"differs from {other!r} in case only: they are one file on Windows")
    for name in counts:
        parts = name.split("/")
        for n in range(1, len(parts)):
            if "/".join(parts[:n]) in counts:
                yield Finding(repr("/".join(parts[:n])), f"is a file, but {name!r} is in it")


def _unpacked(name: str) -> str:
    """Return a name as zipfile unpacks it."""
    return "/".join(part for part in name.split("/") if part not in ("", ".")) + "/" * name.endswith("/")


def _overlaps(entries: Sequence[ZipInfo]) -> Iterator[Finding]:
    """Yield contents that share bytes, by which some kB can be unpacked to some GB (Fifield 2019)."""
    for one, following in pairwise(sorted(entries, key=lambda e: e.header_offset)):
        if one.header_offset + _LOCAL_HEADER + one.compress_size > following.header_offset:
            yield Finding(repr(one.filename), f"overlaps {following.filename!r} in the archive, as in a zip bomb")
