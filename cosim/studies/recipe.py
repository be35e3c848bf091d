"""Messages to and from a worker: the recipe of a run, and its answer."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from ..scenarios.scenario import Scenario


class KilledFmuError(Exception):
    """Error for a run of which an FMU's process was killed from outside, as a machine without memory does: a loss."""


@dataclass(frozen=True)
class Parcel:
    """Files that a run needs, for a worker that does not share the head's: FMUs, tables, the user's modules."""

    digests: Mapping[str, str]
    """SHA-256 of each file, by its path in the worker's folder."""
    name: str
    """SHA-256 of all that: the name of the folder in the worker's cache."""


@dataclass(frozen=True)
class Recipe:
    """All that a run follows from."""

    scenario: Scenario
    """Scenario, with the settings of its point."""
    estimator: str
    """Name of the estimator."""
    seed: int
    """Seed of noise and search."""
    versions: Mapping[str, str]
    """Versions of the packages that the head has; a worker of others refuses."""
    is_kept: bool = False
    """True where the run's folder is wanted."""
    folder: str | None = None
    """Run folder, to be made by a worker of the head's machine; one elsewhere returns the files."""
    parcel: Parcel | None = None
    """Files, for a worker of another machine; the scenario's folder is the worker's own then."""
    is_recorded: bool = False
    """True where the run's whole summary is wanted, and not only its row."""


@dataclass(frozen=True)
class Answer:
    """Answer of a worker to a recipe."""

    kind: Literal["result", "refused", "unfinished", "missing", "unfit"]
    """A result; a scenario that is refused; a full disk; files that this worker lacks; a worker that differs."""
    why: str = ""
    """Reason, in one line, where there is no result."""
    row: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Row of the table of results."""
    record: dict[str, Any] | None = None
    """Whole summary, where it is wanted."""
    files: Mapping[str, bytes] | None = None
    """Files of the run folder, of a worker that does not share the head's."""
