"""Findings of `retune check`, in a scenario or in an FMU."""

from dataclasses import dataclass


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
        return f"{self.where}: {'note' if self.is_note else 'error' if self.is_error else 'warning'}: {self.what}"


def warning(where: str, what: str) -> Finding:
    """Return a finding that is a warning."""
    return Finding(where, what, is_error=False)
