"""Who imports whom, in fresh interpreters and in the sources."""

import ast
import subprocess
import sys
import tomllib
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path

import pytest

import cosim
from cosim.system.fmu_cache import find_fmu

PUBLIC = [
    "Comparison", "CosimError", "EstimateError", "Estimation", "FolderError", "ModelDescriptionError", "Online",
    "Run", "Scenario", "ScenarioError", "Slave", "SlaveError", "SspError", "System", "UnfinishedError",
    "WiringError", "compare", "estimate", "estimate_online", "load_scenario", "open_slave", "plot_belief",
    "plot_surrogate", "read_run", "resume", "run",
]  # fmt: skip
WORKSHOP = {"cosim", "estimator", "fmu_models"}


def loaded_by(program):
    """Top-level names of the modules that a fresh interpreter holds after the program."""
    command = [sys.executable, "-c", program + "; import sys; print(*{m.partition('.')[0] for m in sys.modules})"]
    return set(subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout.split())


def sources(package):
    folder = Path(str(files(package)))
    return {p.relative_to(folder).as_posix(): p.read_text(encoding="utf-8") for p in folder.rglob("*.py")}


def imported(source):
    """Top-level names that a source imports absolutely, anywhere in it."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module.partition(".")[0]


def imports_of(package):
    return {name: set(imported(source)) for name, source in sources(package).items()}


def test_importing_cosim_loads_nothing_heavy():
    loaded = loaded_by("import cosim")
    assert "cosim" in loaded
    assert loaded.isdisjoint({"numpy", "scipy", "GPy", "pydantic", "pyarrow", "fmpy", "matplotlib", "tqdm"})
    assert loaded & WORKSHOP == {"cosim"}


def test_the_process_of_an_fmu_loads_neither_estimators_nor_scenarios():
    loaded = loaded_by("import cosim.slaves.process")
    assert loaded.isdisjoint({"GPy", "pydantic", "pyarrow", "matplotlib", "tqdm", "estimator", "fmu_models"})


def test_the_process_of_an_fmu_loads_of_fmpy_what_calls_it_only():
    program = """
import sys
from cosim.fmi.lazy_fmpy import load_fmpy_lazily
load_fmpy_lazily()
import cosim.slaves.child, cosim.fmi.fmi2_co_simulation, cosim.fmi.fmi3_co_simulation
unused = {"multiprocessing", "pickle", "hashlib"}
heavy = {"numpy", "lxml", "fmpy.simulation", "fmpy.util", *unused} & set(sys.modules)
assert not heavy, heavy
"""
    assert "fmpy" in loaded_by(program + "pass")


def test_what_fmpy_left_out_is_there_for_whoever_asks():
    program = """
from cosim.fmi.lazy_fmpy import load_fmpy_lazily
load_fmpy_lazily()
import fmpy
from fmpy import read_model_description, simulate_fmu
import fmpy.model_description, fmpy.simulation, fmpy.util
assert simulate_fmu is fmpy.simulate_fmu is fmpy.simulation.simulate_fmu
assert read_model_description is fmpy.model_description.read_model_description
assert fmpy.plot_result is fmpy.util.plot_result
assert not hasattr(fmpy, "no_such_name")
pass"""
    loaded_by(program)


def test_a_run_loads_scipy_while_its_fmus_start_and_an_fmu_is_described_without_it():
    parts = {"scipy.linalg", "scipy.optimize", "scipy.spatial", "scipy.special", "scipy.sparse", "scipy.stats"}
    for program in ("import cosim.commands.run", "import cosim.commands.info"):
        command = [sys.executable, "-c", program + "; import sys; print(*sys.modules)"]
        loaded = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout.split()
        assert parts.isdisjoint(loaded), program


def test_the_process_of_a_loop_and_the_description_of_an_fmu_do_without_numpy():
    begin = "from cosim.fmi.lazy_fmpy import load_fmpy_lazily; load_fmpy_lazily()"
    loaded = loaded_by(f"{begin}; import cosim.system.loop_child, cosim.authoring.info, cosim.commands.info")
    assert loaded.isdisjoint({"numpy", "scipy", "pydantic", "estimator"})


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_checked_fmu_is_read_without_numpy_where_it_has_no_arrays(fmi):
    fmu = find_fmu("Pendulum", Path(), fmi)
    program = f"""
from pathlib import Path
from cosim.fmi.archive import read_checked
names = [v.name for v in read_checked(Path({str(fmu)!r})).modelVariables]
assert "phi" in names, names
pass"""
    loaded = loaded_by("from cosim.fmi.lazy_fmpy import load_fmpy_lazily; load_fmpy_lazily()\n" + program)
    assert ("numpy" in loaded) == (fmi == 3)
    assert "elftools" not in loaded


def test_help_waits_for_nothing_heavy():
    program = "from cosim.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass\nimport sys"
    command = [sys.executable, "-c", program + "\nprint('MODULES', *sys.modules)"]
    output = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout
    assert "usage: retune" in output
    heavy = {"numpy", "scipy", "GPy", "matplotlib", "pandas", "pydantic", "pyarrow", "fmpy"}
    assert set(output.partition("MODULES")[2].split()).isdisjoint(heavy)


def test_recording_a_series_and_reading_it_back_loads_no_pandas(tmp_path):
    program = f"""
from pathlib import Path
from cosim.runs.record import Recorder
recorder = Recorder(Path({str(tmp_path)!r}), ["time"])
for k in range(60): recorder.row([float(k)])
assert len(recorder.close()["time"]) == 60
pass"""
    assert "pandas" not in loaded_by(program)


def test_importing_the_models_loads_pythonfmu_and_the_standard_library_only():
    plain, loaded = loaded_by("pass"), loaded_by("import fmu_models.build, fmu_models.kernel.blocks")
    third_party = {m for m in loaded - plain if m not in sys.stdlib_module_names and not m.startswith("_")}
    assert "pythonfmu" in third_party
    assert third_party <= {"pythonfmu", "pythonfmu3", "fmu_models"}


def test_no_source_of_the_models_imports_anything_else():
    for name, modules in imports_of("fmu_models").items():
        assert modules <= {*sys.stdlib_module_names, "pythonfmu", "pythonfmu3", "fmu_models"}, name


def test_only_the_co_simulation_joins_the_packages():
    for package, allowed in (("fmu_models", {"fmu_models"}), ("estimator", set()), ("cosim", WORKSHOP - {"cosim"})):
        for name, modules in imports_of(package).items():
            assert modules & WORKSHOP <= allowed, f"{package}/{name}"


def test_only_the_modules_of_one_fmu_import_fmpy():
    users = {name for name, modules in imports_of("cosim").items() if "fmpy" in modules}
    elsewhere = {name for name in users if not name.startswith("fmi/")}
    assert users > elsewhere
    assert elsewhere <= {"slaves/slave.py", "slaves/process.py", "authoring/doctor.py", "objectives/model.py"}
    for package in ("estimator", "fmu_models"):
        assert all("fmpy" not in modules for modules in imports_of(package).values())


def test_what_needs_no_fmu_library_imports_none():
    below = ("scenarios/", "sampling/", "retuning/", "runs/", "system/master.py")
    for name, modules in imports_of("cosim").items():
        if name.startswith(below):
            assert modules.isdisjoint({"fmpy", "pythonfmu"}), name


@pytest.mark.parametrize("package", sorted(WORKSHOP))
def test_every_third_party_import_is_a_declared_dependency(package):
    pyproject = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))
    declared = {d.partition(">")[0].strip().replace("-", "_") for d in pyproject["project"]["dependencies"]} | {
        "pandas",
        "cyipopt",
        "asammdf",
        "xarray",
        "elftools",  # pyelftools
    }  # the first four are optional
    for name, modules in imports_of(package).items():
        assert modules <= {*sys.stdlib_module_names, *declared, *WORKSHOP}, name


def test_the_public_names_are_these():
    tree = ast.parse(sources("cosim")["__init__.py"])
    reexported = {
        alias.asname
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if alias.asname
    }
    assert reexported == set(PUBLIC)
    assert {name: getattr(cosim, name).__name__ for name in PUBLIC} == {name: name for name in PUBLIC}


def test_dir_lists_the_public_names_before_any_is_loaded():
    program = "import cosim; print(*dir(cosim))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert [name for name in done.stdout.split() if not name.startswith("_")] == PUBLIC


def test_the_version_is_that_of_the_distribution():
    assert cosim.__version__ == distribution("fmu-retune").version


@pytest.mark.parametrize("package", ["cosim", "estimator"])
def test_a_type_checker_of_a_user_is_told_that_there_are_types(package):
    assert (files(package) / "py.typed").is_file()


def test_an_unknown_public_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'cosim' has no attribute 'rum'"):
        _ = cosim.rum


def test_the_command_is_installed():
    (script,) = [e for e in distribution("fmu-retune").entry_points if e.group == "console_scripts"]
    assert (script.name, script.value) == ("retune", "cosim.cli:main")
