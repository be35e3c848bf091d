"""The command of a fresh interpreter that runs a program of this package."""

import json
import sys
from pathlib import Path
from typing import Final

# cosim may be importable only because of this process's sys.path; -P keeps the working directory out of it.
_BOOT: Final = """
import importlib, json, sys
arguments, root, program, *path = sys.argv[1:]
sys.path += [folder for folder in path if folder not in sys.path]
sys.path.insert(0, root)
from cosim.fmi.lazy_fmpy import load_fmpy_lazily
load_fmpy_lazily()
main = importlib.import_module(program).main
sys.path.remove(root)
main(*json.loads(arguments))
"""


def boot_command(program: str, *arguments: str) -> list[str]:
    """Return the command of a fresh interpreter that calls the main of a module of cosim with arguments."""
    root = str(Path(__file__).resolve().parents[2])
    return [sys.executable, "-u", "-P", "-c", _BOOT, json.dumps(arguments), root, program, *filter(None, sys.path)]
