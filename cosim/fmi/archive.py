"""An FMU as a file: the zip archive, the description in it, and a folder to unpack it into."""

import re
import sys
import tempfile
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import fmpy
from fmpy.model_description import CoSimulation, ModelDescription, ModelExchange, ValidationError

from ..errors import ModelDescriptionError, one_line
from .elements import scalarized

Interface = Literal["co-simulation", "model-exchange"]

# What a file URI keeps as it is, and the space, which every loader decodes: pythonfmu's crashes on anything else.
_SAFE: Final = re.compile(r"[A-Za-z0-9._~/ -]*" if sys.platform != "win32" else r"[A-Za-z0-9._~/\\: -]*")
_VERSIONS: Final[dict[str, tuple[str, ...]]] = {"co-simulation": ("2.0", "3.0"), "model-exchange": ("2.0", "3.0")}
_OTHER_FOLDERS: Final = ("/tmp", "/var/tmp") if sys.platform != "win32" else (r"C:\Users\Public", r"C:\Temp")


@dataclass(frozen=True)
class FmuFile:
    """An FMU that has been looked into, but is not loaded."""

    name: str
    """Instance name."""
    description: ModelDescription
    """What it declares."""


def read_description(fmu: Path, interface: Interface = "co-simulation") -> ModelDescription:
    """The model description of an FMU that this machine can load, arrays as their elements.

    Raises ModelDescriptionError.
    """
    description = read_any(fmu)
    version = str(description.fmiVersion)
    offered = {"co-simulation": description.coSimulation, "model-exchange": description.modelExchange}
    if not version.startswith(_VERSIONS[interface]) or offered[interface] is None:
        kind = next((kind for kind, part in offered.items() if part is not None), "scheduled-execution")
        asked = " or ".join(_VERSIONS[interface])
        raise ModelDescriptionError(f"{fmu} is an FMI {version} {kind} FMU, not FMI {asked} {interface}.")
    identifier = str(getattr(offered[interface], "modelIdentifier", None))
    if not identifier.isidentifier():  # it becomes a file name
        raise ModelDescriptionError(f"{fmu} has the model identifier {identifier!r}, not a C name.")
    return description if version == "2.0" else scalarized(description)


def read_any(fmu: Path) -> ModelDescription:
    """The model description of an FMU of any version and kind that this machine has a binary of.

    Raises ModelDescriptionError.
    """
    description, platforms = look_into(fmu)
    if fmpy.platform not in platforms:
        offer = f"only for {', '.join(platforms)}" if platforms else "nor for any other platform"
        raise ModelDescriptionError(f"{fmu} has no binary for {fmpy.platform}, {offer}.")
    return description


def look_into(fmu: Path) -> tuple[ModelDescription, list[str]]:
    """The model description of an FMU of any version and kind, and its platforms. Raises ModelDescriptionError."""
    try:
        with open(fmu, "rb") as file:  # given a path, FMPy leaves the file open when the XML is damaged
            description = fmpy.read_model_description(file)
            platforms: list[str] = fmpy.supported_platforms(file)
    except OSError as error:
        raise ModelDescriptionError(f"{fmu} cannot be read: {error.strerror or error}") from error
    except ValidationError as error:
        n = len(error.problems) - 1
        more = f" (and {n} more, which `fmpy validate` lists)" if n else ""
        raise ModelDescriptionError(f"{fmu} is not a usable FMU: {one_line(error.problems[0])}{more}") from error
    except Exception as error:  # FMPy raises what the zip, XML and validation code happens to raise
        raise ModelDescriptionError(f"{fmu} is not a usable FMU: {_text_of(error)}") from error
    return description, platforms


def co_simulation(description: ModelDescription) -> CoSimulation:
    """The co-simulation part of a description that read_description has let through."""
    assert description.coSimulation is not None
    return description.coSimulation


def model_exchange(description: ModelDescription) -> ModelExchange:
    """The model-exchange part of a description that read_description has let through."""
    assert description.modelExchange is not None
    return description.modelExchange


def private_folder() -> str:
    """A new folder for an FMU, which can be loaded from there whatever the folder of temporary files is called.

    Raises ModelDescriptionError where no folder has a name that every FMU can read.
    """
    for parent in (tempfile.gettempdir(), *_OTHER_FOLDERS):
        if _SAFE.fullmatch(parent):
            try:
                return tempfile.mkdtemp(prefix="fmu-retune-", dir=parent)
            except OSError:
                continue
    raise ModelDescriptionError(
        f"no FMU can be unpacked: {tempfile.gettempdir()} is not a name that FMUs can be loaded from; "
        "set TMPDIR to a folder of plain letters, digits and -_.~ only."
    )


def unpack(fmu: Path, folder: str) -> None:
    """Extract an FMU into folder. Raises ModelDescriptionError, for names that lead out of folder before any write."""
    try:
        with zipfile.ZipFile(fmu) as archive:
            for name in archive.namelist():
                if name.startswith("/") or ".." in name.split("/") or "\\" in name or ":" in name:
                    raise ModelDescriptionError(f"{fmu} holds a file that would be put outside its folder: {name!r}")
            archive.extractall(folder)
    except (zipfile.BadZipFile, zlib.error, OSError, RuntimeError, ValueError) as error:
        raise ModelDescriptionError(f"{fmu} cannot be unpacked: {_text_of(error)}") from error


def _text_of(error: Exception) -> str:
    """What an error says, in one line; a KeyError says its key in quotes."""
    return one_line(str(error.args[0] if isinstance(error, KeyError) else error) or type(error).__name__)
