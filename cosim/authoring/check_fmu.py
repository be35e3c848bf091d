"""Errors and risks in an FMU, found before any of its code runs: all of them, where a run stops at the first."""

import sys
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

from ..errors import ModelDescriptionError, one_line
from ..findings import Finding, warning
from ..fmi.archive import (
    DESCRIPTION,
    content,
    contents_findings,
    interfaces,
    library_finding,
    library_path,
    look_into,
    needs_its_tool,
    no_binary,
    unpack,
    unusable,
)
from ..fmi.component import ModelDescription
from ..fmi.folder import PrivateFolder
from ..fmi.preflight.description import clock_problem
from .library_search import missing_libraries
from .shared_library import read_shared_library


def check_fmu(fmu: Path) -> list[Finding]:
    """Return all findings about an FMU. Raises ModelDescriptionError if the file is not an FMU."""
    found: list[Finding] = []
    try:
        description, platforms = look_into(fmu, found.extend)
    except ModelDescriptionError:
        if any(f.is_error for f in found):  # what has been found is why
            return found
        raise
    damaged = [] if any(f.is_error for f in found) else [*contents_findings(fmu)]  # a bomb is not unpacked
    found += damaged
    if needs_its_tool(description):
        found.append(warning(DESCRIPTION, "the FMU needs the tool that made it to run (needsExecutionTool)"))
    if unusable(description, "model-exchange") and (problem := unusable(description, "co-simulation")):
        found.append(Finding(DESCRIPTION, problem))
    if problem := clock_problem(description):
        found.append(Finding(DESCRIPTION, problem))
    if problem := no_binary(platforms):
        return [*found, Finding("binaries", problem)]
    for interface in interfaces(description):
        place = library_path(description, interface)
        if repr(place) in {f.where for f in damaged}:
            continue
        try:
            found += library_finding(BytesIO(content(fmu, place)), description, interface)
        except ModelDescriptionError as error:
            found.append(Finding(place, str(error.__cause__)))
    return found if any(f.is_error for f in found) else [*found, *_missing_libraries(fmu, description)]


def _missing_libraries(fmu: Path, description: ModelDescription) -> Iterator[Finding]:
    """Yield the libraries that an FMU's own one needs and that would not be found; each folder may bring some along."""
    if sys.platform != "linux":
        return
    loaded = {Path(line.rpartition(" ")[2]).name for line in Path("/proc/self/maps").read_text().splitlines()}
    with PrivateFolder() as folder:
        unpack(fmu, folder)
        for place in dict.fromkeys(library_path(description, interface) for interface in interfaces(description)):
            library = read_shared_library(Path(folder, place))
            for text in missing_libraries(Path(folder, place), library) if library else ():
                if text.partition(" ")[0] not in loaded:
                    yield Finding(place, f"needs {one_line(text)} (retune doctor says more)")
