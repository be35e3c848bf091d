"""Settings given on the command line, as KEY=VALUE."""

import tomllib
from typing import Any, cast

from ..errors import ScenarioError, one_line


def override(tree: dict[str, Any], key: str, text: str) -> None:
    """Put `key = text` into the tree; both as in TOML, but bare text is a string too. Raises ScenarioError."""
    path = key_path(key)
    for name in path[:-1]:
        below: Any = tree.setdefault(name, {})
        if isinstance(below, list):
            raise ScenarioError(f"--set {key}={text}: '{name}' is a list, which is set as a whole, or in the file.")
        if not isinstance(below, dict):
            raise ScenarioError(f"--set {key}={text}: '{name}' is not a table.")
        tree = cast(dict[str, Any], below)
    tree[path[-1]] = toml_value(text)


def sweep(text: str) -> list[str]:
    """Return the values of a setting that are separated by commas outside brackets and quotes: `10,20,30`."""
    parts, depth, quote = [""], 0, ""
    for c in text:
        if quote:
            quote = "" if c == quote else quote
        elif c in "\"'":
            quote = c
        elif c in "([{" or c in ")]}":
            depth += 1 if c in "([{" else -1
        if c == "," and not quote and depth == 0:
            parts.append("")
        else:
            parts[-1] += c
    return [part.strip() for part in parts] if all(part.strip() for part in parts) else [text]


def key_path(key: str) -> list[str]:
    """Return the names of a dotted TOML key. Raises ScenarioError."""
    path: list[str] = []
    try:
        rest: Any = tomllib.loads(f"{key} = 0")
    except tomllib.TOMLDecodeError:
        rest = {}
    while isinstance(rest, dict) and len(cast(dict[str, Any], rest)) == 1:
        name, rest = next(iter(cast(dict[str, Any], rest).items()))
        path.append(name)
    if rest != 0 or not path or len(key.splitlines()) != 1:
        raise ScenarioError(f"--set: '{one_line(key)}' is not a TOML key, such as scenario.stop_time.")
    return path


def toml_value(text: str) -> Any:
    """Return the value of a setting's text, in TOML; bare text is a string."""
    try:
        tree = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return tree["value"] if len(tree) == 1 else text
