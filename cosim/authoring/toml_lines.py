"""Lines of a TOML file with comments, as a person would write them."""

import json
import re


def key(name: str) -> str:
    """Return a key, quoted where it must be."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else quoted(name)


def quoted(text: str) -> str:
    """Return a basic string of TOML, which is written as in JSON."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def said(line: str, comment: str) -> str:
    """Return a line with its comment."""
    return f"{line:<48}  # {comment}"
