"""A shared library for Linux as its headers describe it: the file is read, not loaded."""

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from elftools.elf.dynamic import Dynamic

from ..fmi.preflight.elf import DAMAGED, opened_elf

_LARGEST_TABLE: Final = 64 << 20  # bytes: a million symbols take 24 MB
_WEAK: Final = 0x2  # VER_FLG_WEAK: a version that may be absent
_PYTHON: Final = re.compile(rb"_?Py[A-Z_]")


@dataclass(frozen=True)
class SharedLibrary:
    """A shared library for Linux."""

    kind: tuple[int, str]
    """Bits and machine, such as (64, "EM_X86_64"); a library loads others of its own kind only."""
    soname: str
    """Name that it gives itself; empty without one."""
    needed: tuple[str, ...]
    """Names of the libraries that it is linked to."""
    rpath: tuple[str, ...]
    """Folders of its DT_RPATH, for its own libraries and those of its libraries."""
    runpath: tuple[str, ...]
    """Folders of its DT_RUNPATH, for its own libraries only."""
    versions_needed: Mapping[str, tuple[str, ...]]
    """Versions of symbols that it needs, by the library that has them."""
    versions: frozenset[str]
    """Versions of symbols that it has."""
    uses_python: bool
    """True where it uses functions of Python's that it does not have itself."""

    @property
    def glibc(self) -> tuple[int, ...]:
        """Least version of glibc; empty where none is asked for."""
        asked = [name for names in self.versions_needed.values() for name in names]
        numbers = [
            match[1].split(".") for name in asked if (match := re.fullmatch(r"GLIBC_(\d{1,9}(\.\d{1,9})*)", name))
        ]
        return max((tuple(map(int, parts)) for parts in numbers), default=())


def read_shared_library(path: Path) -> SharedLibrary | None:
    """Return the description of an ELF file; None for any other file. Raises OSError."""
    with path.open("rb") as file:
        try:
            elf: Any = opened_elf(file)
            tags = _dynamic_tags(elf)
            return SharedLibrary(
                (elf.elfclass, str(elf.header.e_machine)),
                next(iter(tags.get("soname", ())), ""),
                tags.get("needed", ()),
                _folders(tags.get("rpath", ())),
                _folders(tags.get("runpath", ())),
                _versions_needed(elf),
                _versions(elf),
                _uses_python(elf),
            )
        except DAMAGED:
            return None


def _dynamic_tags(elf: Any) -> dict[str, tuple[str, ...]]:
    """Return the texts of the dynamic section, by the kind of tag; of the segment, which is what a loader reads."""
    found: dict[str, tuple[str, ...]] = {}
    segment = next((s for s in elf.iter_segments() if s.header.p_type == "PT_DYNAMIC"), None)
    if segment is None:
        return found
    for tag in Dynamic(elf.stream, elf, None, segment.header.p_offset, segment.header.p_filesz == 0).iter_tags():
        for kind in ("needed", "rpath", "runpath", "soname"):
            if tag.entry.d_tag == f"DT_{kind.upper()}":
                found[kind] = (*found.get(kind, ()), getattr(tag, kind))
    return found


def _folders(paths: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(folder for path in paths for folder in path.split(":"))


def _versions_needed(elf: Any) -> dict[str, tuple[str, ...]]:
    section = elf.get_section_by_name(".gnu.version_r")
    if section is None:
        return {}
    return {
        library.name: tuple(v.name for v in versions if not v.entry.vna_flags & _WEAK)
        for library, versions in section.iter_versions()
    }


def _versions(elf: Any) -> frozenset[str]:
    section = elf.get_section_by_name(".gnu.version_d")
    return frozenset() if section is None else frozenset(next(names).name for _, names in section.iter_versions())


def _uses_python(elf: Any) -> bool:
    """Return whether an undefined symbol is one of Python's; not by pyelftools, which takes seconds for a large one."""
    symbols, strings = elf.get_section_by_name(".dynsym"), elf.get_section_by_name(".dynstr")
    if symbols is None or strings is None or elf.elfclass != 64:
        return False
    order, texts = "<" if elf.little_endian else ">", _content(elf, strings)
    for name, _, _, section, _, _ in struct.iter_unpack(f"{order}IBBHQQ", _content(elf, symbols)):
        if section == 0 and _PYTHON.match(texts, name):
            return True
    return False


def _content(elf: Any, section: Any) -> bytes:
    """Return the bytes of a section as they are: packed ones are not unpacked. Raises ValueError for too many."""
    if section.header.sh_size > _LARGEST_TABLE:
        raise ValueError(f"a table of {section.header.sh_size} bytes")
    elf.stream.seek(section.header.sh_offset)
    return elf.stream.read(section.header.sh_size)
