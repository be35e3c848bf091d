"""Progress on a terminal."""

from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from typing import Any

from tqdm import tqdm

from ..campaigns.executor import Progress as ProgressOfRuns
from ..runs.simulation import Progress
from ..scenarios.scenario import Scenario


@contextmanager
def progress_bar(scenario: Scenario, estimator: str) -> Generator[Progress]:
    """A bar on standard error, with the simulated time, what the controller holds, and an ETA; on terminals only."""
    settings = scenario.scenario
    with tqdm(
        total=settings.stop_time - settings.start_time,
        desc=f"{settings.name} {estimator}",
        bar_format="{desc} {percentage:3.0f}%|{bar}| t = {n:.2f} s, {remaining} left {postfix}",
        disable=None,  # where standard error is not a terminal
        leave=False,
    ) as bar:

        def show(t: float, held: Mapping[str, float]) -> None:
            if bar.disable:
                return
            bar.set_postfix_str(", ".join(f"{name} {value:.4g}" for name, value in held.items()), refresh=False)
            bar.update(t - settings.start_time - bar.n)

        yield show


@contextmanager
def bar_of_runs(title: str) -> Generator[ProgressOfRuns]:
    """A bar of ended runs on standard error, on terminals only."""
    form = "{desc} {percentage:3.0f}%|{bar}| {n_fmt} of {total_fmt} runs, {remaining} left {postfix}"
    with tqdm(total=0, desc=title, bar_format=form, disable=None, leave=False) as bar:

        def show(record: Mapping[str, Any], n_ended: int, n_runs: int) -> None:
            if bar.disable:
                return
            bar.total = n_runs
            run = f"{record['scenario']} {record['estimator']} {record['seed']}"
            bar.set_postfix_str(f"{run} {record['status']}", refresh=False)
            bar.update(n_ended - bar.n)

        yield show


@contextmanager
def bar_of_rollouts(title: str, n_search: int) -> Generator[Callable[[int, float], None]]:
    """A bar of simulated candidates on standard error, with the least sum of squares; on terminals only.

    n_search: the search's candidates; those after it make the bar longer.
    """
    form = "{desc} {percentage:3.0f}%|{bar}| {n_fmt} of {total_fmt} candidates, {remaining} left {postfix}"
    with tqdm(total=n_search, desc=title, bar_format=form, disable=None, leave=False) as bar:

        def show(n: int, cost: float) -> None:
            if bar.disable:
                return
            bar.total = max(n_search, n)
            bar.set_postfix_str(f"sum of squares {cost:.4g}", refresh=False)
            bar.update(n - bar.n)

        yield show


@contextmanager
def bar_of_samples(title: str) -> Generator[Callable[[int, int], None]]:
    """A bar of the samples of a log on standard error, on terminals only."""
    form = "{desc} {percentage:3.0f}%|{bar}| {n_fmt} of {total_fmt} samples, {remaining} left"
    with tqdm(total=0, desc=title, bar_format=form, disable=None, leave=False) as bar:

        def show(n: int, n_all: int) -> None:
            if not bar.disable:
                bar.total = n_all
                bar.update(n - bar.n)

        yield show
