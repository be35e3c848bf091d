"""A run in a notebook: a small table, without scripts."""

from ..runs.result import Run
from .frame import rendered_part


def html_of(run: Run) -> str:
    """Return a small table of a run: how it ended and tracked, and its parameters at the end."""
    end = float(run.time[-1]) if len(run.time) else None
    return rendered_part(
        "notebook.html.j2",
        run=run,
        name=run.scenario.scenario.name,
        end=end,
        errors=[(str(output), error) for output, error in zip(run.scenario.tracking, run.mse, strict=True)],
        parameters=run.parameters_at(end) if end is not None else [],
    )
