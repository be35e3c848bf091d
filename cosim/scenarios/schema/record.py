"""Table of a scenario file on what a run folder holds."""

import re
from collections.abc import Iterable, Sequence
from typing import Annotated, Final

from pydantic import Field

from ...names import did_you_mean
from .table import MOST, Table

_BYTES_A_NUMBER: Final = 18
"""Usual size of a number in CSV, with its comma."""


class RecordSettings(Table):
    """Variables that a run folder holds, and in which form."""

    columns: tuple[Annotated[str, Field(min_length=1)], ...] = ("*",)
    """Outputs to record, as `component.variable`; `*` for any text. Time, what is tracked, sampled, changed or written
    is recorded always: the pictures and `retune replay` need it."""
    csv: float = Field(default=10.0, ge=0.0, le=MOST)
    """Size [MB] up to which a run that has ended is also written as `series.csv`; `retune csv RUN` writes any."""

    def chosen(self, names: Sequence[str], always: Iterable[str]) -> set[str]:
        """Return those of the names that are recorded. Raises ValueError for columns that are none of them."""
        found = {*always}
        for pattern in self.columns:
            some = [n for n in names if re.fullmatch(re.escape(pattern).replace(r"\*", ".*"), n)]
            if not some:
                raise ValueError(f"record.columns: no output '{pattern}'{did_you_mean(pattern, names) or '.'}")
            found.update(some)
        return found

    def is_small(self, n_values: int) -> bool:
        """Return whether so many numbers are written as CSV too."""
        return n_values * _BYTES_A_NUMBER <= 1e6 * self.csv
