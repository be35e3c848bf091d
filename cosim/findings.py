"""What `retune check` finds, in a scenario or in an FMU."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong or risky. As text, one line."""

    where: str
    """Key of the scenario, such as `connections.\"plant.u\"`, or place in the FMU, such as `modelDescription.xml`."""
    what: str
    """What is wrong, and what to do where that is not plain."""
    is_error: bool = True
    """`run` would refuse it, or compute nonsense; otherwise it may be meant."""
    is_note: bool = False
    """It is neither: what `run` will do, said beforehand."""

    def __str__(self) -> str:
        return f"{self.where}: {'note' if self.is_note else 'error' if self.is_error else 'warning'}: {self.what}"


def warning(where: str, what: str) -> Finding:
    """A finding that is no error."""
    return Finding(where, what, is_error=False)
