"""Files of the user's that have the name of one of our packages: one line says which, and what to do."""

import os
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest

PARENT = str(Path(str(files("cosim"))).parent)


def python(folder, *arguments):
    """A fresh interpreter in the folder, which is first on its path."""
    command = [sys.executable, *arguments]
    environment = os.environ | {"PYTHONPATH": PARENT}
    return subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=folder, env=environment)


@pytest.mark.parametrize("name", ["estimator.py", "fmu_models.py", "estimator/__init__.py"])
def test_the_command_names_the_file_that_hides_a_package(tmp_path, name):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("from cosim import run\n")
    found = tmp_path / name.removesuffix("/__init__.py")
    done = python(tmp_path, "-m", "cosim.cli", "run", "pendulum")
    package = name.partition("/")[0].removesuffix(".py")
    line = f"retune: {found} hides the package '{package}' of fmu-retune: rename it.\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", line)


def test_a_program_beside_such_a_file_gets_the_same_line_as_an_import_error(tmp_path):
    (tmp_path / "estimator.py").write_text("class Mine: ...\n")
    (tmp_path / "program.py").write_text("from cosim import run\n")
    done = python(tmp_path, "program.py")
    line = f"ImportError: {tmp_path / 'estimator.py'} hides the package 'estimator' of fmu-retune: rename it."
    assert (done.returncode, done.stderr.splitlines()[-1]) == (1, line)


def test_a_program_of_that_name_is_told_of_itself(tmp_path):
    (tmp_path / "estimator.py").write_text("from cosim import run\n")
    assert "estimator.py hides the package" in python(tmp_path, "estimator.py").stderr.splitlines()[-1]


def test_code_of_the_users_in_a_file_of_that_name_is_refused(called, workplace):
    (workplace / "estimator.py").write_text("class Mine: ...\n")
    code, out, err = called("run", "pendulum", "--only", "--estimator", "estimator:Mine")
    reason = f"{workplace / 'estimator.py'} has the name of a package of fmu-retune: rename it."
    assert (code, out, err.endswith(f"{reason}\n"), err.count("\n")) == (2, "", True, 1)


def test_nothing_is_hidden_in_the_folder_of_our_own_packages():
    assert python(PARENT, "-m", "cosim.cli", "--version").returncode == 0
    assert python(PARENT, "-c", "import cosim; cosim.CosimError").stderr == ""
