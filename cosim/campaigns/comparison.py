"""A comparison of estimators: its figures, with the tables made of them."""

from dataclasses import dataclass
from pathlib import Path

from ..files import write_text
from .figures import ComparisonFigures
from .tables import estimator_columns, run_columns, to_csv, to_markdown, to_terminal


@dataclass(frozen=True, repr=False)
class Comparison(ComparisonFigures):
    """Runs of several estimators with the same seeds, their figures and tables."""

    def __repr__(self) -> str:
        """Return one line: the records would fill pages."""
        names = ", ".join(self.estimators)
        return f"<Comparison on {self.scenario.scenario.name}: {names}; seeds {list(self.seeds)}>"

    def table(self) -> str:
        """Return the tables for a terminal."""
        return to_terminal(self)

    def write(self, folder: Path) -> None:
        """Write comparison.json, .md and .csv, and runs.csv. Raises FolderError."""
        write_text(folder / "comparison.json", self.to_json(indent=2) + "\n")
        write_text(folder / "comparison.md", to_markdown(self))
        write_text(folder / "comparison.csv", to_csv(estimator_columns(row) for row in self.rows()))
        write_text(folder / "runs.csv", to_csv(run_columns(self, record) for record in self.runs))
