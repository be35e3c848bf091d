"""Progress on a terminal."""

from collections.abc import Generator, Mapping
from contextlib import contextmanager

from tqdm import tqdm

from .scenario import Scenario
from .simulation import Progress


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
