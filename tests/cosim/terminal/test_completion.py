"""Completion: what the command offers when a shell asks, and a bash that asks."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.cli import main
from cosim.terminal.completion import SHELLS


def offered(line, folder, shell="bash"):
    """What `retune` offers at the end of a line."""
    answer = folder / "answer"
    asked = {
        "_ARGCOMPLETE": "1", "_ARGCOMPLETE_SHELL": shell, "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
        "_ARGCOMPLETE_IFS": "\n", "COMP_LINE": line, "COMP_POINT": str(len(line)), "COMP_TYPE": "9",
    }  # fmt: skip
    subprocess.run([sys.executable, "-m", "cosim.cli"], env=os.environ | asked, cwd=folder, check=True)
    return {re.split(r"[\t:]", text)[0].strip() for text in answer.read_text().splitlines()}


@pytest.mark.parametrize("shell", SHELLS)
def test_commands_and_options_are_offered(tmp_path, shell):
    assert offered("retune re", tmp_path, shell) == {"resume", "replay", "report"}


@pytest.mark.full
def test_values_are_offered(tmp_path):
    for name in ("mine.toml", "mine.ssp", "mine.csv"):
        (tmp_path / name).touch()
    assert offered("retune check --dr", tmp_path) == {"--dry-run"}
    assert offered("retune run mine", tmp_path) == {"mine.toml", "mine.ssp"}
    assert offered("retune run pen", tmp_path) == {"pendulum"}
    assert offered("retune run pendulum --estimator le", tmp_path) == {"least-squares"}
    assert offered("retune compare pendulum --estimators target,uk", tmp_path) == {"target,ukf"}


@pytest.mark.parametrize("shell", SHELLS)
def test_the_script_of_each_shell_is_printed(shell, capsys):
    assert main(["completion", shell]) == 0
    out = capsys.readouterr().out
    assert {"bash": "complete", "zsh": "compdef", "fish": "complete --command retune"}[shell] in out
    assert "retune" in out


def test_another_shell_is_refused(called):
    code, out, err = called("completion", "tcsh")
    assert (code, out, err.count("\n")) == (2, "", 1)


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_a_bash_completes_by_it(tmp_path, capsys):
    main(["completion", "bash"])
    (tmp_path / "script").write_text(capsys.readouterr().out)
    (tmp_path / "bin").mkdir()
    command = tmp_path / "bin" / "retune"
    command.write_text(f'#!/bin/sh\nexec {sys.executable} -m cosim.cli "$@"\n')
    command.chmod(0o755)
    ask = (
        "source ./script; COMP_WORDS=(retune illu); COMP_CWORD=1; COMP_LINE='retune illu'; COMP_POINT=11; COMP_TYPE=9; "
        "$(complete -p retune | sed 's/.*-F \\([^ ]*\\).*/\\1/') retune illu retune; echo \"${COMPREPLY[@]}\""
    )
    path = f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}"
    root = str(Path(__file__).parents[3])
    done = subprocess.run(
        ["bash", "-c", ask],
        cwd=tmp_path,
        env=os.environ | {"PATH": path, "PYTHONPATH": root},
        capture_output=True,
        text=True,
    )
    assert done.stdout.strip() == "illustrate", done.stderr
