"""The boundary of the package, in a fresh interpreter and in its sources."""

import ast
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import estimator

PUBLIC = [
    "METHODS",
    "AskTell",
    "Batching",
    "DerivativeResidual",
    "EpisodeWindow",
    "Estimate",
    "Estimator",
    "SequenceObjective",
    "Evaluation",
    "LinearForm",
    "Method",
    "Model",
    "NoEstimateError",
    "Objective",
    "PaperBO",
    "PaperSettings",
    "Parameter",
    "ParameterSpace",
    "Rescoring",
    "ResidualWindow",
    "Sample",
    "Solver",
    "SampleSequence",
    "TargetSettings",
    "TargetVector",
    "Vector",
    "Window",
    "chi2_limit",
]


def _sources():
    root = Path(str(files("estimator")))
    return {path.relative_to(root).as_posix(): path.read_text(encoding="utf-8") for path in root.rglob("*.py")}


def _imported(source):
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module.split(".")[0]


def test_importing_the_estimators_brings_in_no_fmu_and_no_co_simulation():
    program = "import sys, estimator; print(*sorted({m.split('.')[0] for m in sys.modules}))"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    loaded = set(run.stdout.split())
    assert "estimator" in loaded
    assert loaded.isdisjoint({"fmpy", "pythonfmu", "cosim", "fmu_models"})


def test_importing_the_estimators_waits_for_neither_gpy_nor_statistics_nor_plots():
    program = "import sys, estimator; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    heavy = {"GPy", "scipy.stats", "scipy.special", "scipy.optimize", "scipy.linalg", "matplotlib", "pandas"}
    assert set(run.stdout.split()).isdisjoint(heavy)


def test_a_search_of_target_needs_neither_gpy_nor_statistics_nor_plots():
    program = """
import sys, numpy as np
from estimator import Parameter, ParameterSpace, TargetVector
space = ParameterSpace((Parameter("m", 0.1, 5.0, "kg"), Parameter("l", 0.1, 3.0, "m")))
target = TargetVector(space, np.ones(2), np.random.default_rng(0))
for m, l in (target.ask() for _ in range(8)):
    target.tell(np.array([m, l]), np.array([m * l - 1.3125, 1.0 / l - 1.0 / 0.75]) / 0.01)
target.estimate()
print(*sys.modules)"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert set(run.stdout.split()).isdisjoint({"GPy", "scipy.stats", "matplotlib", "pandas"})


def test_no_source_imports_an_fmu_or_the_co_simulation():
    for name, source in _sources().items():
        assert {"fmpy", "pythonfmu", "cosim", "fmu_models"}.isdisjoint(_imported(source)), name


def test_only_the_surrogate_and_its_kernels_import_gpy():
    importing = {name for name, source in _sources().items() if "GPy" in _imported(source)}
    assert importing == {"bayesian/surrogate.py", "bayesian/kernels.py"}


def test_the_public_names_are_these_and_are_only_re_exports():
    tree = ast.parse(_sources()["__init__.py"])
    assert all(isinstance(node, ast.ImportFrom | ast.Expr) for node in tree.body)
    names = [alias for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names]
    assert all(alias.asname == alias.name for alias in names)
    assert sorted(alias.name for alias in names) == sorted(PUBLIC)
    assert all(hasattr(estimator, name) for name in PUBLIC)
