"""The command line of `retune estimate` from a TOML file. Imports nothing heavy: --help must not wait."""

import argparse
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NoReturn

from ..errors import ScenarioError
from ..names import did_you_mean
from .estimate_options import add_options

_TABLES: Final = {
    "parameters": "--parameter", "measured": "--measured", "inputs": "--input", "start": "--start", "noise": "--noise",
}  # fmt: skip
_LISTS: Final = {"windows": "--window", "validate": "--validate", "environment": "--environment", "own": "--own"}
_FLAGS: Final = ("profile", "online")
_VALUES: Final = (
    "time", "time_unit", "holdout", "step", "method", "evaluations", "samples", "evaluations_per_sample", "seed",
    "jobs", "timeout", "loss", "f_scale",
)  # fmt: skip
_KEYS: Final = {option: key for key, option in (_TABLES | _LISTS).items()} | {
    "--" + key.replace("_", "-"): key for key in (*_FLAGS, *_VALUES)
}
"""Key of each option."""
_REQUIRED: Final = ("--parameter", "--measured")
_ENTRIES: Final = {"parameters": ('[LOW, HIGH] or [LOW, HIGH, "log"]', (2, 3)), "windows": ("[FROM, TO]", (2,))}
"""Form and lengths of the entries that are lists, by key."""


class _Options(argparse.ArgumentParser):
    """The options of the command, for a file: an error is raised."""

    def error(self, message: str) -> NoReturn:
        raise ScenarioError(message.removeprefix("argument ").replace("following arguments", "following keys"))


def with_file(arguments: Sequence[str]) -> list[str]:
    """Return the command line, `estimate FILE.toml` replaced by the options in that file. Raises ScenarioError."""
    if len(arguments) < 2 or arguments[0] != "estimate" or not arguments[1].lower().endswith(".toml"):
        return list(arguments)
    from ..scenarios.scenario import read_tables

    path = Path(arguments[1])
    words = ["estimate", *_words(path, read_tables(path)), *arguments[2:]]
    parser = _Options(add_help=False, allow_abbrev=False)
    add_options(parser)
    try:
        parser.parse_known_args(words[1:])
    except ScenarioError as e:
        if (text := by_key(str(e), arguments, words)) != str(e):  # else the command line is wrong, and told as such
            raise ScenarioError(text) from None
    return words


def by_key(message: str, arguments: Sequence[str], words: Sequence[str]) -> str:
    """Return a message on options, those that are the file's, or that it lacks, told as its keys.

    arguments: the command line; words: that `with_file` has made of it.
    """
    if words == arguments:
        return message
    own = {word.partition("=")[0] for word in arguments}
    of_file = {*_REQUIRED, *(word.partition("=")[0] for word in words)} - own
    told = re.sub(r"--[a-z-]+", lambda option: _KEYS[option[0]] if option[0] in of_file else option[0], message)
    return message if told == message else f"{arguments[1]}: {told}"


def _words(path: Path, keys: Mapping[str, Any]) -> Iterator[str]:
    logs = [keys["logs"]] if isinstance(keys.get("logs"), str) else keys.get("logs")
    if not isinstance(keys.get("fmu"), str) or not isinstance(logs, list) or not logs:
        raise ScenarioError(f'{path} must have fmu = "FILE" and logs = ["FILE", ...].')
    yield from (_beside(path, file) for file in (keys["fmu"], *logs))
    for key, value in keys.items():
        option = "--" + key.replace("_", "-")
        if key in _TABLES and isinstance(value, dict):
            for name, entry in _flat(value):
                _check_form(f"{path}: {key}.{name}", key, entry)
                yield f"{_TABLES[key]}={name}={_entry(f'{path}: {key}.{name}', entry)}"
        elif key in _LISTS and isinstance(value, list):
            for entry in value:
                _check_form(f"{path}: {key}", key, entry)
                yield f"{_LISTS[key]}={_beside(path, entry) if key == 'validate' else _entry(f'{path}: {key}', entry)}"
        elif key in _FLAGS and isinstance(value, bool):
            yield from [option] if value else []
        elif key in _VALUES and isinstance(value, str | int | float) and not isinstance(value, bool):
            yield f"{option}={value}"
        elif key not in ("fmu", "logs"):
            known = (*_TABLES, *_LISTS, *_FLAGS, *_VALUES, "fmu", "logs")
            wrong = "is of the wrong type" if key in known else f"is no key{did_you_mean(key, known).rstrip('?')}"
            raise ScenarioError(f"{path}: '{key}' {wrong}.")


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the entries by the variable's name: dots in a key that is not quoted make tables."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _check_form(what: str, key: str, entry: Any) -> None:
    """Raise ScenarioError for an entry that must be a list of another length."""
    if key in _ENTRIES and not (isinstance(entry, list) and len(entry) in _ENTRIES[key][1]):
        raise ScenarioError(f"{what} must be {_ENTRIES[key][0]}, got {entry!r}.")


def _entry(what: str, value: Any) -> str:
    """Return a number, a name, or a list of them as an option has it. Raises ScenarioError."""
    if isinstance(value, list):
        return ":".join(_entry(what, item) for item in value)
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise ScenarioError(f"{what} must be a number, a name or a list of them, got {value!r}.")
    return str(value)


def _beside(path: Path, file: Any) -> str:
    """Return the path of a file that is named relative to the TOML file. Raises ScenarioError."""
    if not isinstance(file, str):
        raise ScenarioError(f"{path}: a file's name must be text, got {file!r}.")
    return f"./{found}" if str(found := path.parent / file).startswith("-") else str(found)
