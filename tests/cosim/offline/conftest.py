"""A plant FMU in C."""

import importlib.util
import shutil
from pathlib import Path

import pytest
import scipy.linalg  # noqa: F401 -- its BLAS must be loaded to be limited
from threadpoolctl import threadpool_limits

from benchmarks.native_fmus import build_c

HERE = Path(__file__).parent


@pytest.fixture(scope="session")
def compile_plant(tmp_path_factory):
    """compile_plant(*gcc options, **attributes of CoSimulation): the path of the FMU."""
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")

    def compiled(*options, **attributes):
        description = (HERE / "modelDescription.xml").read_text()
        for name, value in attributes.items():
            other = "false" if value == "true" else "true"
            assert f'{name}="{other}"' in description
            description = description.replace(f'{name}="{other}"', f'{name}="{value}"')
        path = tmp_path_factory.mktemp("plant") / "Plant.fmu"
        return build_c(HERE / "mass_spring_damper.c", description, path, *options)

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
def cache(tmp_path_factory):
    """The built-in FMUs are built once a session, never into the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FMU_RETUNE_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session", autouse=True)
def one_blas_thread():
    """As the command runs."""
    with threadpool_limits(1):
        yield
