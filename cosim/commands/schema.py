"""`retune schema`."""

import argparse

from ..files import to_json, write_text
from ..scenarios.json_schema import json_schema
from ..terminal.exit_codes import DONE
from ..terminal.folders import must_be_new


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    must_be_new(options.out, "-o")
    text = to_json(json_schema(), indent=2)
    if options.out is None:
        print(text)
        return DONE
    write_text(options.out, text + "\n")
    print(f"{options.out}  written")
    print(f'next: write "#:schema {options.out}" into the first line of a scenario')
    return DONE
