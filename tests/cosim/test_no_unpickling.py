"""No file is unpickled: bytes of a process of our own are, in two places."""

import ast
from importlib.resources import files
from pathlib import Path

UNSAFE = {"pickle", "_pickle", "cPickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "jsonpickle"}
OWN_PROCESS = {
    "cosim/studies/processes.py": "the calls that a worker's parent has sent it, and their outcomes",
    "cosim/estimator_fmu/slave.py": "an FMU state that has not left the process",
}
ROOTS = [Path(str(files(package))) for package in ("cosim", "estimator")]


def unsafe_in(tree: ast.AST) -> set[str]:
    """What a module imports, or allows NumPy, that may turn bytes into calls."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names} & UNSAFE
        elif isinstance(node, ast.ImportFrom):
            found |= {(node.module or "").partition(".")[0]} & UNSAFE
            found |= {alias.name for alias in node.names} & {"read_pickle"}
        elif isinstance(node, ast.Attribute) and node.attr in ("read_pickle", "Unpickler"):
            found.add(node.attr)
        elif isinstance(node, ast.keyword) and node.arg == "allow_pickle":
            found.add("allow_pickle")
    return found


def test_no_file_is_unpickled():
    modules = {
        f"{root.name}/{path.relative_to(root).as_posix()}": path for root in ROOTS for path in root.rglob("*.py")
    }
    unsafe = {name for name, path in modules.items() if unsafe_in(ast.parse(path.read_text(encoding="utf-8")))}
    assert unsafe == set(OWN_PROCESS)
