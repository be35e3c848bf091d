"""A plant FMU in C."""

import importlib.util
import shutil
from pathlib import Path

import pytest
import scipy.linalg  # noqa: F401 -- its BLAS must be loaded to be limited

from benchmarks.native_fmus import SOURCES, build_c
from cosim.blas_threads import one_thread

HERE = Path(__file__).parent


@pytest.fixture(scope="session")
def compile_plant(made_once):
    """compile_plant(*gcc options, **attributes of CoSimulation): the path of the FMU."""
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")

    def compiled(*options, **attributes):
        description = (HERE / "modelDescription.xml").read_text()
        for name, value in attributes.items():
            other = "false" if value == "true" else "true"
            assert f'{name}="{other}"' in description
            description = description.replace(f'{name}="{other}"', f'{name}="{value}"')
        source = HERE / "mass_spring_damper.c"
        folder = made_once(
            lambda folder: build_c(source, description, folder / "Plant.fmu", *options),
            source, SOURCES, description, options,
        )  # fmt: skip
        return folder / "Plant.fmu"

    return compiled


@pytest.fixture(scope="session")
def plant(compile_plant):
    return compile_plant()


@pytest.fixture(scope="session")
def oracles():
    """The closed form: with the importlib import mode the folder of the tests is not on the path."""
    spec = importlib.util.spec_from_file_location("offline_oracles", HERE / "oracles.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session", autouse=True)
def one_blas_thread():
    """As the command runs."""
    with one_thread():
        yield
