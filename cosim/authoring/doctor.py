"""Requirements of an FMU on this machine: its binary and libraries and, for one in Python, libpython and modules.

No code of the FMU is executed: its library is read, not loaded, and its scripts are searched for import statements.
"""

import platform
import re
import shlex
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import distributions, packages_distributions, version
from importlib.util import find_spec
from modulefinder import ModuleFinder
from pathlib import Path
from typing import Any

import fmpy
from find_libpython import find_libpython
from fmpy.model_description import ModelDescription

from ..errors import one_line
from ..fmi.archive import read_any, unpack
from ..fmi.folder import PrivateFolder
from ..fmi.preflight.library import library_problem
from .library_search import missing_libraries
from .shared_library import SharedLibrary, read_shared_library

_EXIT_OF_PYTHONFMU = "GLIBC_TUNABLES=glibc.malloc.tcache_count=65535"  # its library uses freed memory as it is unloaded

_REQUIRED = re.compile(r"\s*([A-Za-z][\w.-]*)[^;#]*(;?)")  # a package's name, and what begins its marker

_UNLOADABLE = "No importer can load it as it is: build the FMU anew for this platform."


@dataclass(frozen=True)
class Requirement:
    """One requirement of an FMU."""

    subject: str
    """`glibc`, `libpython`, ..."""
    is_well: bool
    """True where nothing is missing."""
    text: str
    """Requirement and what was found, in one line."""


@dataclass(frozen=True)
class Examination:
    """Requirements of an FMU, met or not. As text, a report of several lines."""

    title: str
    """File, FMI version, kind, and the tool that made it."""
    findings: tuple[Requirement, ...]
    """In the order of the report."""
    advice: str
    """Advice on how to start an importer."""

    @property
    def is_well(self) -> bool:
        """True where every requirement is met."""
        return all(finding.is_well for finding in self.findings)

    def __str__(self) -> str:
        lines = [f"  {'ok' if f.is_well else 'MISSING':7}  {f.subject:9}  {f.text}" for f in self.findings]
        return "\n".join([self.title, *lines, "", self.advice])


def diagnose(fmu: Path) -> Examination:
    """Examine an FMU of any FMI version, native or in Python.

    Raises ModelDescriptionError where the file is no FMU or has no binary for this platform.
    """
    description = read_any(fmu)
    with PrivateFolder() as folder:
        unpack(fmu, folder)
        identifiers = _identifiers(description)
        binary = _binary(Path(folder), identifiers)
        library = read_shared_library(binary) if sys.platform == "linux" else None
        script = Path(folder, "resources", "slavemodule.txt")
        is_python = script.is_file() or (library is not None and _has_open_python(library))
        findings = [_found(folder, binary, identifiers, library)]
        if library is not None:
            findings += _libraries(binary, library)
        libpython = find_libpython() if is_python else None
        if is_python:
            findings.append(_libpython(libpython))
        if script.is_file():
            findings.append(_modules(script))
    tool = one_line(description.generationTool or "") or "a tool that it does not name"
    title = f"{fmu}: FMI {description.fmiVersion} for {_kind(description)}, made by {tool}"
    advice = _advice(is_python, libpython, "pythonfmu" in tool.lower()) if findings[0].is_well else _UNLOADABLE
    return Examination(title, tuple(findings), advice)


def _kind(description: ModelDescription) -> str:
    kinds = {"co-simulation": description.coSimulation, "model exchange": description.modelExchange}
    return " and ".join(kind for kind, interface in kinds.items() if interface is not None) or "scheduled execution"


def _identifiers(description: ModelDescription) -> list[str]:
    interfaces: tuple[Any, ...] = (description.coSimulation, description.modelExchange, description.scheduledExecution)
    return [str(interface.modelIdentifier) for interface in interfaces if interface is not None]


def _binary(folder: Path, identifiers: list[str]) -> Path:
    """Return the shared library of an FMU for this platform; if none has the model's name, another one."""
    places = [folder / "binaries" / place for place in (fmpy.platform, fmpy.platform_tuple)]
    found = [path for place in places for path in sorted(place.glob(f"*{fmpy.sharedLibraryExtension}"))]
    return next((path for path in found if path.stem in identifiers), found[0])


def _found(folder: str, path: Path, identifiers: list[str], library: SharedLibrary | None) -> Requirement:
    binary = path.relative_to(folder).as_posix()
    if path.stem not in identifiers:
        return Requirement(
            "binary", False, f"{' or '.join(identifiers)} by the model description, but here is {binary}"
        )
    if library is None and sys.platform == "linux":
        return Requirement("binary", False, f"{binary} is no shared library for Linux")
    with path.open("rb") as file:
        if problem := library_problem(file):
            return Requirement("binary", False, f"{binary} {problem}")
    return Requirement("binary", True, binary if library else f"{binary}, which is not examined on this platform")


def _has_open_python(library: SharedLibrary) -> bool:
    """Return whether a library uses Python's functions and names no library that has them."""
    return library.uses_python and not any(name.startswith("libpython") for name in library.needed)


def _libraries(binary: Path, library: SharedLibrary) -> Iterator[Requirement]:
    here = platform.libc_ver()[1] or "not glibc"
    if library.glibc:
        is_enough = bool(re.match(r"\d", here)) and _numbers(here) >= library.glibc
        yield Requirement("glibc", is_enough, f"{'.'.join(map(str, library.glibc))} or newer, here {here}")
    lacking = "; ".join(missing_libraries(binary, library))
    yield Requirement("libraries", not lacking, one_line(lacking or ", ".join(library.needed) or "none", longest=4000))


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(map(int, re.findall(r"\d+", text)))


def _libpython(path: str | None) -> Requirement:
    python = f"Python {platform.python_version()} in {sys.prefix}"
    if path is None:
        return Requirement("libpython", False, f"none for {python}, which was built without a shared library")
    return Requirement("libpython", True, f"{path}, of {python}")


class _Imports(ModuleFinder):
    """Collector of absolute imports; relative ones never lead out of the FMU."""

    def import_hook(self, name: str, caller: Any = None, fromlist: Any = None, level: int = -1) -> Any:
        try:
            return super().import_hook(name, caller, fromlist, level)
        except ImportError:
            if level > 0:
                return None
            raise


def _modules(script: Path) -> Requirement:
    """Return the packages that the FMU asks for, or else the modules that it imports and does not contain.

    Modules imported by a computed name are not seen.
    """
    requirements = script.with_name("requirements.txt")
    if requirements.is_file():
        return _requirements(requirements.read_text(encoding="utf-8", errors="replace"))
    finder = _Imports(path=[str(script.parent)])
    try:
        entry = script.with_name(f"{script.read_text(encoding='utf-8').strip()}.py")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what the compiler has to say on its style
            finder.run_script(str(entry))
    except (OSError, SyntaxError, ValueError, RecursionError, MemoryError) as error:
        return Requirement("modules", False, f"its script cannot be read: {one_line(str(error))}")
    own = {name.partition(".")[0] for name in finder.modules}
    names = {name.partition(".")[0] for name in finder.any_missing()} - own - sys.stdlib_module_names
    here = sorted(name for name in names if find_spec(name) is not None)
    lacking = ", ".join(sorted(names - set(here)))
    if lacking:
        return Requirement("modules", False, f"{lacking} cannot be imported in {sys.prefix}")
    known = packages_distributions() if here else {}
    versions = [f"{name} {version(known[name][0])}" if name in known else name for name in here]
    return Requirement("modules", True, ", ".join(versions) or "none but those of Python and its own")


def _requirements(text: str) -> Requirement:
    """Return the names of the required packages, without versions.

    Those with an environment marker, such as `; sys_platform == "win32"`, are named, but not looked for.
    """
    required = [match.groups() for line in text.splitlines() if (match := _REQUIRED.match(line))]
    names = [name for name, marker in required if not marker]
    conditional = ", ".join(dict.fromkeys(name for name, marker in required if marker))
    found = {_normalised(distribution.name): distribution.version for distribution in distributions()}
    lacking = ", ".join(name for name in names if _normalised(name) not in found)
    if lacking:
        return Requirement(
            "modules", False, f"{lacking} not installed in {sys.prefix}; python -m pythonfmu deploy -f FMU does it"
        )
    here = ", ".join(f"{name} {found[_normalised(name)]}" for name in names) or "none"
    return Requirement("modules", True, here + (f"; on conditions: {conditional}" if conditional else ""))


def _normalised(name: str) -> str:
    """Return the form of a package's name in which names are compared (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def _advice(is_python: bool, libpython: str | None, is_pythonfmu: bool) -> str:
    if not is_python:
        return "It is native: any importer loads it as it is."
    if sys.platform != "linux" or libpython is None:
        return "An importer that is Python itself loads it as it is."
    path = f"{shlex.quote(str(Path(sys.executable).parent))}:$PATH"
    command = ["env", f"LD_PRELOAD={shlex.quote(libpython)}", f"PATH={path}", *[_EXIT_OF_PYTHONFMU] * is_pythonfmu]
    return (
        "An importer that is Python itself loads it as it is, in this Python environment. Any other, on Linux:\n\n"
        f"  {' '.join(command)} IMPORTER"
    )
