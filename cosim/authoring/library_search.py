"""The search of ld.so for the libraries of a library (man 8 ld.so), by reading files: nothing is loaded or run.

`ldd` starts the loader, which runs code of the library: its audit libraries, or a loader of its own.
"""

import os
import platform
import re
import struct
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from time import monotonic
from typing import Final

from .shared_library import SharedLibrary, read_shared_library

LONGEST_S: Final = 10.0
"""Time after which a search is given up: a library can name any number of others, and of folders."""

_CACHE: Final = Path("/etc/ld.so.cache")
_CACHE_MAGIC: Final = b"glibc-ld.so.cache1.1"
_CACHE_HEADER: Final = 48  # bytes
_MULTIARCH: Final = {"EM_X86_64": "x86_64-linux-gnu", "EM_AARCH64": "aarch64-linux-gnu", "EM_386": "i386-linux-gnu"}
_TOKEN: Final = re.compile(r"\$(?:(ORIGIN|LIB|PLATFORM)\b|\{(ORIGIN|LIB|PLATFORM)\})")


@dataclass(frozen=True)
class _Found:
    """A library that would be loaded."""

    path: str
    library: SharedLibrary
    loader: "_Found | None"
    """The library that needs it; None for the first."""


def missing_libraries(path: Path, library: SharedLibrary) -> list[str]:
    """Return what a library needs and ld.so would not find here: libraries, and versions of their symbols."""
    return list(dict.fromkeys(_LibrarySearch(library.kind).missing(_Found(os.path.abspath(path), library, None))))


class _LibrarySearch:
    """One search; libraries are looked for in the loader's order, breadth first, each name once."""

    def __init__(self, kind: tuple[int, str]) -> None:
        """kind: that of the libraries which can be loaded together."""
        self._kind = kind
        self._multiarch = _MULTIARCH.get(kind[1], "")
        self._deadline = monotonic() + LONGEST_S
        self._by_name: dict[str, _Found | None] = {}

    def missing(self, first: _Found) -> Iterator[str]:
        """Yield the problems, in ldd's words."""
        queue = deque([first])
        try:
            while queue:
                one = queue.popleft()
                for name in one.library.needed:
                    if name in self._by_name:
                        continue
                    found = self._by_name[name] = self._find(name, one)
                    if found is None:
                        yield f"{name} => not found"
                    else:
                        self._by_name.setdefault(found.library.soname, found)
                        queue.append(found)
                yield from self._missing_versions(one)
        except (TimeoutError, ValueError) as error:
            yield str(error)

    def _missing_versions(self, one: _Found) -> Iterator[str]:
        for name, versions in one.library.versions_needed.items():
            of = self._by_name.get(name)
            if of is not None and of.library.versions:  # one without any has each, but for a warning
                yield from (f"{of.path}: version `{v}' not found" for v in versions if v not in of.library.versions)

    def _find(self, name: str, loader: _Found) -> _Found | None:
        """Return the library of a name. Raises ValueError for a file that ends the loader's search, TimeoutError."""
        for path in self._places(name, loader):
            if monotonic() > self._deadline:
                raise TimeoutError(f"not all looked for: the search was given up after {LONGEST_S:g} s")
            try:
                if not os.path.isfile(path):  # nothing that blocks when it is opened
                    continue
                library = read_shared_library(Path(path))
            except (OSError, ValueError):
                continue
            if library is None:
                raise ValueError(f"{path}: invalid ELF header")
            if library.kind == self._kind:
                return _Found(path, library, loader)
        return None

    def _places(self, name: str, loader: _Found) -> Iterator[str]:
        """Yield the files that a name may mean, in order."""
        if "/" in name:
            yield from self._expanded(name, loader)
            return
        if not loader.library.runpath:
            one: _Found | None = loader
            while one is not None:
                if not one.library.runpath:
                    yield from self._below(one.library.rpath, name, one)
                one = one.loader
        own = os.environ.get("LD_LIBRARY_PATH", "")
        yield from self._below(tuple(re.split("[:;]", own)) if own else (), name, loader)
        yield from self._below(loader.library.runpath, name, loader)
        yield from self._cached.get(name, ())
        for folder in ("/lib", "/usr/lib"):
            yield from (f"{folder}{more}/{name}" for more in (f"/{self._multiarch}", "64", ""))

    def _below(self, folders: tuple[str, ...], name: str, owner: _Found) -> Iterator[str]:
        for folder in folders:
            for path in self._expanded(folder, owner):
                yield os.path.join(path or ".", name)

    def _expanded(self, text: str, owner: _Found) -> Iterator[str]:
        """Yield a path with the loader's tokens replaced; LIB is another folder on each distribution."""
        for lib in (f"lib/{self._multiarch}", "lib64", "lib") if "LIB" in text else ("lib",):
            values = {"ORIGIN": os.path.dirname(owner.path), "LIB": lib, "PLATFORM": platform.machine()}
            yield _TOKEN.sub(lambda match: values[match[1] or match[2]], text)  # noqa: B023

    @cached_property
    def _cached(self) -> Mapping[str, list[str]]:
        try:
            return _entries(_CACHE.read_bytes())
        except (OSError, ValueError, struct.error):  # a system without a cache, or with another
            return {}


def _entries(cache: bytes) -> dict[str, list[str]]:
    """Return the files of the loader's cache by name (glibc, dl-cache.h). Raises ValueError, struct.error."""
    cache = cache[cache.index(_CACHE_MAGIC) :]
    (n,) = struct.unpack_from("<I", cache, len(_CACHE_MAGIC))
    found: dict[str, list[str]] = {}
    for i in range(n):
        _, name, path = struct.unpack_from("<III", cache, _CACHE_HEADER + 24 * i)
        found.setdefault(_text(cache, name), []).append(_text(cache, path))
    return found


def _text(cache: bytes, start: int) -> str:
    return os.fsdecode(cache[start : cache.index(b"\0", start)])
