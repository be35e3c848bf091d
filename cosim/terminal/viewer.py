"""A viewer of a run, in a process of its own: it reads the run's folder and nothing else."""

import subprocess
import sys
from pathlib import Path


def show_in_browser(folder: Path) -> None:
    """Start `retune view` for a run that begins; it ends by itself, when the run has ended and the page has it all."""
    command = [sys.executable, "-P", "-m", "cosim.cli", "view", str(folder), "--until-end"]
    subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
