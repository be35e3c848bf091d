"""The oracles, shared by the tests of the estimators."""

import importlib.util
from pathlib import Path

import pytest
import scipy.linalg  # noqa: F401 -- its BLAS must be loaded to be limited
from threadpoolctl import threadpool_limits


def _load(path: Path):
    """The module in `path`: with the importlib import mode the folder of the tests is not on the path."""
    spec = importlib.util.spec_from_file_location("estimator_oracles", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def oracles():
    """Comparisons of a module of the estimator with an independent truth; each raises AssertionError."""
    return _load(Path(__file__).with_name("oracles.py"))


@pytest.fixture(scope="session", autouse=True)
def one_blas_thread():
    """As the loop runs them: on small matrices a second thread costs more than it gives."""
    with threadpool_limits(1):
        yield
