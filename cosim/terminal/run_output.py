"""Functions shared by `run` and `resume`: a run with its progress bar, and its report and figures."""

import sys
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from pathlib import Path

from ..files import to_json
from ..objectives.choice import chosen
from ..runs.manifest import is_signed_run
from ..runs.record import recording
from ..runs.report import ending, report
from ..runs.result import Run
from ..runs.resumable import has_begun, why_not_resumable
from ..runs.simulation import StepProgress
from ..scenarios.scenario import Scenario
from .exit_codes import DONE, UNFINISHED
from .next_step import line_of, tell_next
from .progress import progress_bar
from .streams import answer

BASELINES = ("none", "true")
"""Estimators that a run is compared with, each in a folder of its name inside the run's."""


def tell(folder: Path, runs: Mapping[Path, Run], is_json: bool, is_drawn: bool) -> int:
    """Draw and print the run of a folder and its baselines; return the exit code."""
    result, baselines = runs[folder], {path.name: run for path, run in runs.items() if path != folder}
    if is_drawn:
        from ..plots.runs import draw_run  # after the runs: what draws takes half a second to load

        with recording(folder):
            draw_run(result, baselines)
    answer(to_json(result.summary()) if is_json else report(result, baselines))
    if not is_json and (next_step := _next_step(folder, result)):
        tell_next(*next_step)
    if why := ending(result):
        print(f"retune: {why}", file=sys.stderr)
        return UNFINISHED
    return DONE


def _next_step(folder: Path, result: Run) -> tuple[object, ...]:
    """Return the command that follows on a run; nothing where none does."""
    if result.status == "faulted":
        return ("resume", folder) if why_not_resumable(folder) is None else ()
    trust = () if is_signed_run(folder) else ("--trust",)
    others = ("ukf", "target") if chosen(result.scenario).kind == "derivative" else ("least-squares", "target")
    return "replay", folder, "--estimator", next(name for name in others if name != result.estimator), *trust


@contextmanager
def telling_how_to_resume(folder: Path) -> Generator[None]:
    """Add to an interrupt, where a run has begun in the folder, the folder and the command that goes on with it."""
    try:
        yield
    except KeyboardInterrupt as e:
        if not has_begun(folder):
            raise
        lacking = why_not_resumable(folder)
        then = f"it cannot be resumed: {lacking}" if lacking else f"{line_of('resume', folder)} goes on"
        raise KeyboardInterrupt(f"what was recorded is in {folder}; {then}") from e


def simulated(scenario: Scenario, estimator: str, simulate: Callable[[StepProgress], Run]) -> Run:
    """Return the run that simulate makes, showing a progress bar meanwhile."""
    settings = scenario.scenario

    def state(t: float, held: Mapping[str, float]) -> tuple[float, float, str]:
        text = ", ".join(f"{name} {value:.4g}" for name, value in held.items())
        return t - settings.start_time, settings.stop_time - settings.start_time, text

    with progress_bar(f"{settings.name} {estimator}", "t = {n:.2f} s", state) as progress:
        return simulate(progress)
