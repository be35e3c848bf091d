"""An FMU as a file: the zip archive, and the description in it."""

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import fmpy
from fmpy.model_description import CoSimulation, ModelDescription

from .errors import ModelDescriptionError, one_line


@dataclass(frozen=True)
class FmuFile:
    """An FMU that has been looked into, but is not loaded."""

    name: str
    """Instance name."""
    description: ModelDescription
    """What it declares."""


def read_description(fmu: Path) -> ModelDescription:
    """The model description of an FMU that this machine can co-simulate. Raises ModelDescriptionError."""
    description = read_any(fmu)
    interface = description.coSimulation
    if description.fmiVersion != "2.0" or interface is None:
        kind = "co-simulation" if interface is not None else "model-exchange"
        raise ModelDescriptionError(f"{fmu} is an FMI {description.fmiVersion} {kind} FMU, not FMI 2.0 co-simulation.")
    if not str(interface.modelIdentifier).isidentifier():  # it becomes a file name
        raise ModelDescriptionError(f"{fmu} has the model identifier {interface.modelIdentifier!r}, not a C name.")
    return description


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
    except Exception as error:  # FMPy raises what the zip, XML and validation code happens to raise
        raise ModelDescriptionError(f"{fmu} is not a usable FMU: {_text_of(error)}") from error
    return description, platforms


def co_simulation(description: ModelDescription) -> CoSimulation:
    """The co-simulation part of a description that read_description has let through."""
    assert description.coSimulation is not None
    return description.coSimulation


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
