"""Errors and risks in an FMU, found before any of its code runs: all of them, where a run stops at the first."""

from io import BytesIO
from pathlib import Path

from ..errors import ModelDescriptionError
from ..findings import Finding, warning
from ..fmi.archive import (
    DESCRIPTION,
    content,
    contents_findings,
    interfaces,
    library_finding,
    library_path,
    look_into,
    no_binary,
    unusable,
)


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
    if any(part.needsExecutionTool in ("true", "1", True) for part in interfaces(description).values()):
        found.append(warning(DESCRIPTION, "the FMU needs the tool that made it to run (needsExecutionTool)"))
    if unusable(description, "model-exchange") and (problem := unusable(description, "co-simulation")):
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
    return found
