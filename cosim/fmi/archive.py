"""An FMU as a file: the zip archive, the description in it, and a folder to unpack it into."""

import math
import re
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal
from xml.etree.ElementTree import Element

import fmpy
from fmpy.model_description import CoSimulation, ModelDescription, ModelExchange, ValidationError

from ..errors import ModelDescriptionError, one_line
from ..files import readable
from ..findings import Finding
from .binding import FmuToLoad
from .elements import scalarized
from .folder import KeptFolder, KeptFolders, PrivateFolder
from .lazy_fmpy import lazy_numpy
from .preflight.archive import archive_findings
from .preflight.description import clock_problem, description_findings, harmless_findings, index_findings, is_true
from .preflight.library import library_problem, needed_functions
from .preflight.xml import LARGEST, strict_root

InterfaceName = Literal["co-simulation", "model-exchange"]
FindingsListener = Callable[[Iterable[Finding]], None]
"""Called with the findings of one check of an FMU; may raise."""

DESCRIPTION: Final = "modelDescription.xml"
_DAMAGED: Final = (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, ValueError)  # what zipfile raises
_BUILD: Final = "sources/buildDescription.xml"
_LEFT_OUT: Final = (b"relativeQuantity", b"<UInt", b"providesDirectionalDerivatives")
_CHUNK: Final = 1 << 20
_VERSION: Final = re.compile(r"2\.0|3\.0(\.\d+)?")  # those of betas have other functions


@dataclass(frozen=True)
class FmuFile:
    """An FMU whose description has been read, but which is not loaded."""

    name: str
    """Instance name."""
    description: ModelDescription
    """Its model description."""


def read_description(fmu: Path, interface: InterfaceName | None = None) -> ModelDescription:
    """Return the model description of an FMU that this machine can load, arrays as their elements.

    interface: one that it must offer; by default either will do. Raises ModelDescriptionError.
    """
    description = read_any(fmu)
    if problem := unusable(description, interface):
        raise ModelDescriptionError(f"{fmu} {problem}.")
    if interface is None and (problem := clock_problem(description)):
        raise ModelDescriptionError(f"{fmu} cannot be a component: {problem}.")
    return description if description.fmiVersion == "2.0" else scalarized(description)


def read_checked(fmu: Path) -> ModelDescription:
    """Return the model description of an FMU that `read_description` has accepted, in half the time.

    Raises ModelDescriptionError.
    """
    try:
        with lazy_numpy():
            description = fmpy.read_model_description(fmu, validate=False)
        text = content(fmu, DESCRIPTION)
        if any(word in text for word in _LEFT_OUT):
            _complete(description, strict_root(text))
    except ModelDescriptionError:
        raise
    except Exception as error:  # as in look_into
        raise ModelDescriptionError(f"{fmu} cannot be read: {_text_of(error)}") from error
    return description if description.fmiVersion == "2.0" else scalarized(description)


def unusable(description: ModelDescription, interface: InterfaceName | None = None) -> str | None:
    """Return the reason why an FMU cannot be used, its version or kind being another than asked for; else None."""
    version, offered = str(description.fmiVersion), interfaces(description)
    if _VERSION.fullmatch(version) and (interface in offered if interface else offered):
        return None
    kind = next(iter(offered), "scheduled-execution")
    wanted = interface or "co-simulation or model-exchange"
    return f"is an FMI {one_line(version)} {kind} FMU, not FMI 2.0 or 3.0 {wanted}"


def read_any(fmu: Path) -> ModelDescription:
    """Return the model description of an FMU of any version and kind that has a binary for this machine.

    Raises ModelDescriptionError.
    """
    description, platforms = look_into(fmu)
    if problem := no_binary(platforms):
        raise ModelDescriptionError(f"{fmu} {problem}.")
    return description


def no_binary(platforms: Sequence[str]) -> str | None:
    """Return the reason why an FMU with binaries for these platforms cannot be loaded here, or None."""
    if fmpy.platform in platforms:
        return None
    others = ", ".join(platforms)
    return f"has no binary for {fmpy.platform}, {f'only for {others}' if others else 'nor for any other platform'}"


def look_into(fmu: Path, on_findings: FindingsListener | None = None) -> tuple[ModelDescription, list[str]]:
    """Return model description and platforms of an FMU of any kind, after all of preflight but its library.

    on_findings: gets what is found; by default the first error is raised. Raises ModelDescriptionError.
    """
    on_findings = on_findings or partial(_refuse, f"{fmu} is not a usable FMU")
    version = "2.0"
    try:
        with open(readable(fmu), "rb") as file:
            root = _description_in(file, on_findings)
            version = root.get("fmiVersion", version)
            on_findings(index_findings(root))
            description = _validated(file, on_findings)
            _complete(description, root)
            on_findings(description_findings(description))
            platforms: list[str] = fmpy.supported_platforms(file)
    except ModelDescriptionError:
        raise
    except OSError as error:
        raise ModelDescriptionError(f"{fmu} cannot be read: {error.strerror or error}") from error
    except ValidationError as error:
        if not _VERSION.fullmatch(version):  # else what it breaks is a rule of another version
            what = f"it is of FMI {one_line(version)}, not 2.0 or 3.0, whose rules it breaks"
            raise ModelDescriptionError(f"{fmu} is not a usable FMU: {what}") from error
        n = len(error.problems) - 1
        more = f" (and {n} more, which `fmpy validate` lists)" if n else ""
        raise ModelDescriptionError(f"{fmu} is not a usable FMU: {one_line(error.problems[0])}{more}") from error
    except (AttributeError, TypeError, IndexError) as error:  # FMPy surprised by what the schema allows
        text = f"{DESCRIPTION}: it is not consistent ({type(error).__name__}: {_text_of(error)})"
        raise ModelDescriptionError(f"{fmu} is not a usable FMU: {text}") from error
    except Exception as error:  # FMPy raises what the zip, XML and validation code happens to raise
        raise ModelDescriptionError(f"{fmu} is not a usable FMU: {_text_of(error)}") from error
    return description, platforms


def _validated(file: BinaryIO, on_findings: FindingsListener) -> ModelDescription:
    """Return the description of a valid FMU, or of one whose faults are harmless. Raises what FMPy raises."""
    try:
        return fmpy.read_model_description(file)
    except ValidationError as error:
        harmless = harmless_findings(error.problems)
        if harmless is None:
            raise
        on_findings(harmless)
        return fmpy.read_model_description(file, validate=False)


def library_finding(library: BinaryIO, description: ModelDescription, interface: str) -> Iterable[Finding]:
    """Yield problems with the library of an FMU."""
    problem = library_problem(library, needed_functions(description, interface))
    if problem:
        yield Finding(library_path(description, interface), problem)


def library_path(description: ModelDescription, interface: str) -> str:
    """Return the place in an FMU where its library for this machine must be."""
    place = fmpy.platform if str(description.fmiVersion).startswith("2") else fmpy.platform_tuple
    identifier = interfaces(description)[interface].modelIdentifier
    return f"binaries/{place}/{identifier}{fmpy.sharedLibraryExtension}"


def fmu_to_load(
    description: ModelDescription,
    folder: str,
    instance_name: str,
    interface: InterfaceName | None = None,
    tolerance: float | None = None,
) -> FmuToLoad:
    """Return the argument of loading.load for an FMU that is unpacked into folder.

    interface: by default that of a component; tolerance: by default that of its default experiment.
    """
    interface = interface or component_interface(description)
    return FmuToLoad(
        folder,
        str(interfaces(description)[interface].modelIdentifier),
        str(description.guid),
        instance_name,
        "pythonfmu" in (description.generationTool or "").lower(),
        str(description.fmiVersion),
        interface,
        is_true(getattr(interfaces(description)[interface], "hasEventMode", False)),
        _declared_tolerance(description) if tolerance is None else tolerance,
    )


def _declared_tolerance(description: ModelDescription) -> float | None:
    declared = getattr(description.defaultExperiment, "tolerance", None)
    return float(declared) if declared is not None and 0.0 < float(declared) < math.inf else None


def interfaces(description: ModelDescription) -> Mapping[str, Any]:
    """Return the interfaces that an FMU offers, of those that are used here."""
    offered = {"co-simulation": description.coSimulation, "model-exchange": description.modelExchange}
    return {name: part for name, part in offered.items() if part is not None}


def component_interface(description: ModelDescription) -> InterfaceName:
    """Return the interface by which an FMU is a component: model exchange only where it has no solver of its own."""
    return "co-simulation" if description.coSimulation is not None else "model-exchange"


def capabilities(description: ModelDescription) -> CoSimulation | ModelExchange:
    """Return the part of a description, which read_description has accepted, with the capabilities as a component."""
    part = description.coSimulation or description.modelExchange
    assert part is not None
    return part


def needs_its_tool(description: ModelDescription) -> bool:
    """Return whether the tool that made an FMU must be installed; pythonfmu's is Python, which it declares."""
    is_python = str(description.generationTool or "").lower().startswith("pythonfmu")
    declared = any(part.needsExecutionTool in ("true", "1", True) for part in interfaces(description).values())
    return declared and not is_python


def has_fixed_step(description: ModelDescription) -> bool:
    """Return whether an FMU's communication steps must all be of one size."""
    part = capabilities(description)
    return isinstance(part, CoSimulation) and not part.canHandleVariableCommunicationStepSize


def unpacked(
    fmu: Path, interface: InterfaceName | None = None, *, is_checked: bool = False, kept: KeptFolders | None = None
) -> tuple[ModelDescription, PrivateFolder | KeptFolder]:
    """Unpack an FMU into a folder of its own, after all of preflight, and return its description too.

    is_checked: true for a file that has passed preflight, and has not changed since; kept: folders of which one may be
    used. Raises ModelDescriptionError; nothing is left then.
    """
    description = read_checked(fmu) if is_checked else read_description(fmu, interface)
    if kept is not None and (folder := kept.take(fmu)) is not None:
        return description, folder
    folder = PrivateFolder()
    try:
        unpack(fmu, folder.path)
        if not is_checked:
            interface = interface or component_interface(description)
            place = library_path(description, interface)
            try:
                with open(Path(folder.path, place), "rb") as library:
                    _refuse(f"{fmu} is not a usable FMU", library_finding(library, description, interface))
            except OSError as error:
                raise ModelDescriptionError(f"{fmu} is not a usable FMU: it has no {place}.") from error
    except BaseException:
        folder.remove()
        raise
    return description, folder if kept is None else kept.add(fmu, folder)


def content(fmu: Path, name: str) -> bytes:
    """Return the content of a file in an FMU. Raises ModelDescriptionError."""
    try:
        with zipfile.ZipFile(fmu) as archive:
            return archive.read(name)
    except (*_DAMAGED, KeyError) as error:
        raise ModelDescriptionError(f"{fmu} has no readable {name}: {_text_of(error)}") from error


def unpack(fmu: Path, folder: str) -> None:
    """Extract an FMU, or a package of FMUs, into folder.

    Raises ModelDescriptionError, before any write where the archive is not what it should be.
    """
    try:
        with zipfile.ZipFile(fmu) as archive:
            _refuse(f"{fmu} cannot be unpacked", archive_findings(archive.infolist()))
            archive.extractall(folder)
    except _DAMAGED as error:
        raise ModelDescriptionError(f"{fmu} cannot be unpacked: {_text_of(error)}") from error


def contents_findings(fmu: Path) -> Iterator[Finding]:
    """Yield the files of an archive that cannot be unpacked as its directory says: each is read to its end."""
    with zipfile.ZipFile(fmu) as archive:
        for entry in archive.infolist():
            try:
                with archive.open(entry) as file:
                    while file.read(_CHUNK):
                        pass
            except _DAMAGED as error:
                yield Finding(repr(entry.filename), f"cannot be unpacked: {_text_of(error)}")


def _complete(description: ModelDescription, root: Element) -> None:
    """Set what FMPy 0.3.32 leaves out: FMI 3.0's providesDirectionalDerivatives, differences, limits of UInt types."""
    for name in ("CoSimulation", "ModelExchange"):
        part = root.find(name)
        if part is not None and is_true(part.get("providesDirectionalDerivatives")):
            interface = description.coSimulation if name == "CoSimulation" else description.modelExchange
            assert interface is not None
            interface.providesDirectionalDerivative = True
    variables = {v.name: v for v in description.modelVariables}
    for element in root.iterfind("ModelVariables/*"):
        variable = variables.get(element.get("name", ""))
        if variable is None:
            continue
        for typed in (element, *element):  # FMI 2.0 has the attributes of a type one level down
            if (is_relative := typed.get("relativeQuantity")) is not None:
                variable.relativeQuantity = is_true(is_relative)
            if typed.tag.startswith("UInt"):
                variable.min, variable.max = typed.get("min"), typed.get("max")


def _description_in(file: BinaryIO, on_findings: FindingsListener) -> Element:
    """Return the model description of an archive that can be unpacked. Raises what zipfile raises, ValueError."""
    with zipfile.ZipFile(file) as archive:
        on_findings(archive_findings(archive.infolist()))
        if _BUILD in archive.namelist():  # FMPy reads it too
            _strict(archive, _BUILD)
        return _versioned(_strict(archive, DESCRIPTION))


def _strict(archive: zipfile.ZipFile, name: str) -> Element:
    size = archive.getinfo(name).file_size
    if size > LARGEST:
        raise ValueError(f"{name}: it has {size >> 20} MiB; at most {LARGEST >> 20} MiB are read")
    try:
        return strict_root(archive.read(name))
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error


def _versioned(root: Element) -> Element:
    """Return the root of a model description; without an FMI version it cannot be read. Raises ValueError."""
    if root.tag != "fmiModelDescription":
        raise ValueError(f"{DESCRIPTION}: its root is {root.tag!r}, not 'fmiModelDescription'")
    if root.get("fmiVersion") is None:
        raise ValueError(f"{DESCRIPTION}: it has no fmiVersion")
    return root


def _refuse(subject: str, findings: Iterable[Finding]) -> None:
    """Raise ModelDescriptionError for the first error."""
    for finding in findings:
        if finding.is_error:
            raise ModelDescriptionError(f"{subject}: {finding.where}: {finding.what}.")


def _text_of(error: Exception) -> str:
    """Return an error's message in one line; a KeyError's without quotes."""
    return one_line(str(error.args[0] if isinstance(error, KeyError) else error) or type(error).__name__)
