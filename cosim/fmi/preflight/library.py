"""Check from its headers that a shared library is valid for this machine: it is read, not loaded."""

import os
import platform
import struct
import sys
from collections.abc import Iterator, Set
from typing import Any, BinaryIO, Final

from elftools.common.exceptions import ELFError

from .elf import opened_elf

_ELF_MACHINES: Final = {"x86_64": "EM_X86_64", "aarch64": "EM_AARCH64"}  # as Linux names them
_PE_MACHINES: Final = {"amd64": 0x8664, "x86_64": 0x8664, "arm64": 0xAA64, "x86": 0x014C}
_PE_IS_DLL: Final = 0x2000
_NEEDED: Final = {
    "2.0": ("fmi2Instantiate", "fmi2FreeInstance", "fmi2SetupExperiment", "fmi2EnterInitializationMode",
            "fmi2ExitInitializationMode", "fmi2Terminate"),
    "3.0": ("fmi3FreeInstance", "fmi3EnterInitializationMode", "fmi3ExitInitializationMode", "fmi3Terminate"),
}  # fmt: skip
_NEEDED_OF: Final = {
    ("2.0", "co-simulation"): ("fmi2DoStep",),
    ("2.0", "model-exchange"): ("fmi2GetDerivatives",),
    ("3.0", "co-simulation"): ("fmi3InstantiateCoSimulation", "fmi3DoStep"),
    ("3.0", "model-exchange"): ("fmi3InstantiateModelExchange", "fmi3GetContinuousStateDerivatives"),
}


def needed_functions(version: str, interface: str) -> frozenset[str]:
    """Return the functions that an FMU of a version ("2.0", ...) and interface ("co-simulation", ...) must have."""
    return frozenset((*_NEEDED.get(version[:3], ()), *_NEEDED_OF.get((version[:3], interface), ())))


def library_problem(file: BinaryIO, needed: Set[str] = frozenset()) -> str | None:
    """Return the problem with an FMU's library for this machine, or None. needed: functions that it must have."""
    if sys.platform == "win32":
        return pe_problem(file.read(4096), platform.machine())
    if sys.platform == "linux":
        return next(elf_problems(file, file.seek(0, os.SEEK_END), platform.machine(), needed), None)
    return None


def elf_problems(file: BinaryIO, size: int, machine: str, needed: Set[str] = frozenset()) -> Iterator[str]:
    """Yield problems with a shared library for Linux of `size` bytes."""
    try:
        elf: Any = opened_elf(file)
        header = elf.header
        if elf.elfclass != 64 or not elf.little_endian or header.e_machine != _ELF_MACHINES.get(machine):
            kind = f"{elf.elfclass} bit, {elf.get_machine_arch()}"
            yield f"is a library of another machine ({kind}); this one is {machine}"
            return
        if header.e_type != "ET_DYN":
            yield f"is no shared library but of the type {header.e_type}"
            return
        segments = list(elf.iter_segments())
        if any(s.header.p_type == "PT_LOAD" and s.header.p_offset + s.header.p_filesz > size for s in segments):
            yield "is cut off: it has fewer bytes than its header says"
            return
        dynamic = next((s for s in segments if s.header.p_type == "PT_DYNAMIC"), None)
        if dynamic is None:
            yield "is no shared library: it has no dynamic section"
            return
        table = elf.get_section_by_name(".gnu.hash")  # to list all symbols would take a hundred times as long
        if table is not None:
            lacking = sorted(name for name in needed if table.get_symbol(name) is None)
            if lacking:
                yield f"lacks the function {', '.join(lacking)}"
    except (ELFError, ValueError, KeyError, AttributeError, TypeError, IndexError, struct.error, ArithmeticError):
        yield "is not a valid shared library for Linux (ELF)"  # a damaged file surprises the parser


def pe_problem(head: bytes, machine: str) -> str | None:
    """Return the problem with a shared library for Windows that begins with head, or None."""
    try:
        (offset,) = struct.unpack_from("<I", head, 0x3C)
        signature, its_machine = struct.unpack_from("<4sH", head, offset)
        (flags,) = struct.unpack_from("<H", head, offset + 22)
    except struct.error:
        return "is not a valid library for Windows (PE)"
    if head[:2] != b"MZ" or signature != b"PE\0\0":
        return "is not a valid library for Windows (PE)"
    if its_machine != _PE_MACHINES.get(machine.lower()):
        return f"is a library of another machine (PE machine {its_machine:#x}); this one is {machine}"
    return None if flags & _PE_IS_DLL else "is a program, not a library"
