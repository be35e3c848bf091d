"""Check from its headers that a shared library is valid for this machine: it is read, not loaded."""

import os
import platform
import struct
import sys
from collections.abc import Iterator, Set
from typing import Any, BinaryIO, Final

from fmpy import fmi2
from fmpy.model_description import ModelDescription

from ..types import TYPES

_ELF_MACHINES: Final = {"x86_64": "EM_X86_64", "aarch64": "EM_AARCH64"}  # as Linux names them
_PE_MACHINES: Final = {"amd64": 0x8664, "x86_64": 0x8664, "arm64": 0xAA64, "x86": 0x014C}
_PE_IS_DLL: Final = 0x2000
_FMPY: Final = {"co-simulation": "FMU2Slave", "model-exchange": "FMU2Model"}
_NEEDED: Final = ("fmi3FreeInstance", "fmi3EnterInitializationMode", "fmi3ExitInitializationMode", "fmi3Terminate")
_NEEDED_OF: Final = {
    "co-simulation": ("fmi3InstantiateCoSimulation", "fmi3DoStep"),
    "model-exchange": (
        "fmi3InstantiateModelExchange", "fmi3EnterEventMode", "fmi3EnterContinuousTimeMode", "fmi3UpdateDiscreteStates",
        "fmi3SetContinuousStates", "fmi3GetContinuousStateDerivatives",
    ),
}  # fmt: skip
_OF_STATES: Final = ("fmi3GetFMUState", "fmi3SetFMUState", "fmi3FreeFMUState", "fmi3SerializedFMUStateSize",
                     "fmi3SerializeFMUState", "fmi3DeserializeFMUState")  # fmt: skip


def needed_functions(description: ModelDescription, interface: str) -> frozenset[str]:
    """Return the functions that an FMU of this description must have for an interface ("co-simulation", ...).

    Of FMI 2.0 they are all that FMPy looks for as it loads an FMU; of FMI 3.0 those that will be called.
    """
    if str(description.fmiVersion) == "2.0":
        return frozenset(name for name in dir(getattr(fmi2, _FMPY[interface])) if name.startswith("fmi2"))
    if not str(description.fmiVersion).startswith("3."):
        return frozenset()
    part: Any = description.coSimulation if interface == "co-simulation" else None
    of_states = _OF_STATES if part and part.canGetAndSetFMUstate and part.canSerializeFMUstate else ()
    verbs = {"input": "Set", "output": "Get"} if interface == "co-simulation" else {}
    exchanged = [(verbs[v.causality], TYPES[v.type]) for v in description.modelVariables if v.causality in verbs]
    of_types = {f"fmi3{verb}{kind.fmi3.functions}" for verb, kind in exchanged if kind.fmi3 and kind.is_numeric}
    return frozenset((*_NEEDED, *_NEEDED_OF[interface], *of_states, *of_types))


def library_problem(file: BinaryIO, needed: Set[str] = frozenset()) -> str | None:
    """Return the problem with an FMU's library for this machine, or None. needed: functions that it must have."""
    if sys.platform == "win32":
        return pe_problem(file.read(4096), platform.machine())
    if sys.platform == "linux":
        return next(elf_problems(file, file.seek(0, os.SEEK_END), platform.machine(), needed), None)
    return None


def elf_problems(file: BinaryIO, size: int, machine: str, needed: Set[str] = frozenset()) -> Iterator[str]:
    """Yield problems with a shared library for Linux of `size` bytes."""
    from .elf import DAMAGED, opened_elf  # a process that loads a checked FMU needs none of pyelftools

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
        # To list all symbols would take a hundred times as long; older linkers write the second table.
        table = elf.get_section_by_name(".gnu.hash") or elf.get_section_by_name(".hash")
        if table is not None:
            lacking = sorted(name for name in needed if not _is_defined(table.get_symbol(name)))
            if lacking:
                yield f"lacks the function {', '.join(lacking)}"
    except DAMAGED:
        yield "is not a valid shared library for Linux (ELF)"


def _is_defined(symbol: Any) -> bool:
    return symbol is not None and symbol["st_shndx"] != "SHN_UNDEF"


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
