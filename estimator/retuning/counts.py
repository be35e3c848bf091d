"""Counts of a retuner, for a class that has it inside."""

from typing import Generic, Protocol, TypeVar


class Counting(Protocol):
    """Counts of a retuner, or of what has one inside."""

    @property
    def n_evaluations(self) -> int: ...
    @property
    def n_episodes(self) -> int: ...
    @property
    def n_model_calls(self) -> int: ...
    def describe(self) -> str: ...


_Inside = TypeVar("_Inside", bound=Counting)


class RetunerCounts(Generic[_Inside]):
    """Counts of a retuner, for a class that has it inside."""

    _retuner: _Inside

    def describe(self) -> str:
        """Return how candidates are scored, in a line."""
        return self._retuner.describe()

    @property
    def n_evaluations(self) -> int:
        """Candidates evaluated so far."""
        return self._retuner.n_evaluations

    @property
    def n_episodes(self) -> int:
        """Episodes begun so far."""
        return self._retuner.n_episodes

    @property
    def n_model_calls(self) -> int:
        """Samples at which a candidate was scored so far."""
        return self._retuner.n_model_calls
