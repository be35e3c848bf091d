"""Build the FMUs of an example in a folder of its own, and carry out the commands of its README there.

    python examples/run.py pi-speed-drive

The FMUs are compiled by gcc.
"""

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).parent
sys.path.insert(0, str(FOLDER.parent))  # of benchmarks, which is not installed

from benchmarks.native_fmus import build_c  # noqa: E402
from cosim.cli import main as retune  # noqa: E402

NAMES = tuple(sorted(path.parent.name for path in FOLDER.glob("*/README.md")))


def commands(name: str) -> list[str]:
    """Return the commands in the README of an example, `retune ...` and `python FILE`."""
    blocks = re.findall(r"^```sh\n(.*?)^```", (FOLDER / name / "README.md").read_text(encoding="utf-8"), re.S | re.M)
    return [line for block in blocks for line in block.splitlines() if re.match(r"retune |python \w+\.py", line)]


def prepare(name: str, folder: Path) -> None:
    """Copy an example into an absent folder, and build its FMUs there. Raises RuntimeError, FileExistsError."""
    shutil.copytree(FOLDER / name, folder)
    for description in folder.glob("*.xml"):
        build_c(description.with_suffix(".c"), description.read_text(encoding="utf-8"), description.with_suffix(".fmu"))


def main() -> int:
    """Carry out an example; return the exit code of the last command."""
    parser = argparse.ArgumentParser(prog="python examples/run.py", description="Build an example's FMUs, and run it.")
    parser.add_argument("name", choices=NAMES)
    parser.add_argument(
        "--out", type=Path, help="absent folder to build it in (default: NAME in the working directory)"
    )
    options = parser.parse_args()
    folder = options.out or Path(options.name)
    try:
        prepare(options.name, folder)
    except FileExistsError:
        parser.error(f"{folder} is there already: give --out another folder.")
    except RuntimeError as e:
        parser.error(str(e))
    os.chdir(folder)
    for command in commands(options.name):
        print(f"$ {command}", flush=True)
        program, *arguments = shlex.split(command)
        is_ours = program == "retune"
        code = retune(arguments) if is_ours else subprocess.run([sys.executable, *arguments], check=False).returncode
        if code:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main())
