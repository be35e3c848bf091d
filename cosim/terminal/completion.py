"""Completion in bash, zsh and fish, by argcomplete: the shell runs `retune` with `_ARGCOMPLETE` set."""

import argparse
from collections.abc import Iterable
from typing import Any, Final

from ..scenarios.named import named_scenarios

VARIABLE: Final = "_ARGCOMPLETE"
"""Environment variable by which a shell asks for completions."""
SHELLS: Final = ("bash", "zsh", "fish")


def complete(parser: argparse.ArgumentParser) -> None:
    """Print the completions that the shell has asked for, and exit."""
    import argcomplete  # only here: it takes its time

    argcomplete.autocomplete(parser)


def script(shell: str) -> str:
    """Return the lines that switch completion on in a shell."""
    from argcomplete.shell_integration import shellcode

    return shellcode(["retune"], shell=shell)


def scenarios(prefix: str, **_: Any) -> Iterable[str]:
    """Return the scenarios that begin so: named ones, and files."""
    from argcomplete.completers import FilesCompleter

    found: Iterable[str] = FilesCompleter(("toml", "ssp"))(prefix)
    return [*(name for name in named_scenarios() if name.startswith(prefix)), *found]


def estimators(prefix: str, **_: Any) -> Iterable[str]:
    """Return the estimators that begin so; of several, separated by commas, the last one is completed."""
    from estimator.methods import METHODS  # loads NumPy

    done, comma, last = prefix.rpartition(",")
    return [f"{done}{comma}{name}" for name in ("none", "true", *METHODS) if name.startswith(last)]
