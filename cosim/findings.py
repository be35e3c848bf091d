"""Findings of `retune check`, in a scenario or in an FMU."""

from dataclasses import dataclass

from .errors import one_line


@dataclass(frozen=True)
class Finding:
    """A finding: something wrong or risky. As text, one line."""

    where: str
    """Key of the scenario, such as `connections.\"plant.u\"`, or place in the FMU, such as `modelDescription.xml`."""
    what: str
    """Description of what is wrong, and the remedy where it is not obvious."""
    is_error: bool = True
    """True where `run` would refuse it, or compute nonsense; otherwise it may be intended."""
    is_note: bool = False
    """True for information on what `run` will do, neither an error nor a warning."""

    def __str__(self) -> str:
        kind = "note" if self.is_note else "error" if self.is_error else "warning"
        return one_line(f"{self.where}: {kind}: {self.what}", longest=4000)


def warning(where: str, what: str) -> Finding:
    """Return a finding that is a warning."""
    return Finding(where, what, is_error=False)
