"""The line that a command ends with: what to do next, to be copied."""

import shlex
from collections.abc import Iterable


def tell_next(*words: object) -> None:
    """Print the command that comes next; words: its own and its arguments."""
    print(f"next: {line_of(*words)}")


def set_options(overrides: Iterable[tuple[str, str]]) -> list[str]:
    """Return the options `--set` of the settings that were replaced."""
    return [word for key, value in overrides for word in ("--set", f"{key}={value}")]


def line_of(*words: object) -> str:
    """Return a command of `retune` as it is typed."""
    return shlex.join(["retune", *map(str, words)])
