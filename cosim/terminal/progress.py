"""Progress bars on a terminal."""

from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from tqdm import tqdm


@contextmanager
def progress_bar(
    title: str, count: str, state: Callable[..., tuple[float, float, str]]
) -> Generator[Callable[..., None]]:
    """Show a bar with the remaining time on standard error; on terminals only.

    Yields a function to be called with each progress report. count: amount done, in tqdm's format; state: converts a
    report to the amount done, the total and a short text.
    """
    form = f"{{desc}} {{percentage:3.0f}}%|{{bar}}| {count}, {{remaining}} left {{postfix}}"
    with tqdm(total=0, desc=title, bar_format=form, disable=None, leave=False) as bar:

        def show(*report: Any) -> None:
            if not bar.disable:
                done, total, text = state(*report)
                if not bar.total:
                    bar.initial = bar.n = done  # of what goes on, the rate is that of the rest
                bar.total = total
                bar.set_postfix_str(text, refresh=False)
                bar.update(done - bar.n)

        yield show


def bar_of_runs(title: str) -> AbstractContextManager[Callable[..., None]]:
    """Return a progress bar for many runs, showing the status of the last one to end."""

    def state(record: Any, n_ended: int, n_runs: int) -> tuple[int, int, str]:
        return n_ended, n_runs, "{scenario} {estimator} {seed} {status}".format_map(record)

    return progress_bar(title, "{n_fmt} of {total_fmt} runs, {rate_fmt}", state)
