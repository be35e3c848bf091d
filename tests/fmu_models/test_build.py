"""Sources to FMUs."""

import os
import shutil
import subprocess
import sys
import zipfile
from hashlib import sha256
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import pytest

import fmu_models
from fmu_models import build

PACKAGE = Path(fmu_models.__file__).parent
BUILD = "import sys; from fmu_models import build; build.build('Pendulum', sys.argv[1])"
BUILD_ALL = (
    "import sys; from fmu_models import build; build.build_all(sys.argv[1]); build.build_all(sys.argv[1] + '/3', 3);"
    "build.build_all(sys.argv[1] + '/me', 3, 'ModelExchange')"
)


def in_a_process(code, *arguments, root=PACKAGE.parent, **environment):
    """Standard output of `code` in a new interpreter that finds fmu_models in `root`."""
    variables = {**os.environ, "PYTHONPATH": str(root), **environment}
    command = [sys.executable, "-P", "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=True, env=variables).stdout


def digests(directory):
    files = [path for path in sorted(directory.iterdir()) if path.is_file()]
    return {path.name: sha256(path.read_bytes()).hexdigest() for path in files}


def guid_of(fmu):
    with zipfile.ZipFile(fmu) as archive:
        return ElementTree.fromstring(archive.read("modelDescription.xml")).get("guid")


def copy_of_the_package(directory):
    shutil.copytree(PACKAGE, directory / "fmu_models", ignore=shutil.ignore_patterns("__pycache__"))
    return directory


@pytest.mark.full
def test_two_processes_in_two_directories_build_the_same_bytes(tmp_path):
    for name, seed in (("a", "1"), ("somewhere/else", "2")):
        in_a_process(BUILD_ALL, tmp_path / name, PYTHONHASHSEED=seed, TZ="Asia/Tokyo" if seed == "2" else "UTC")
    for folder, names in ((".", build.NAMES), ("3", build.NAMES), ("me", build.PLANTS)):
        assert set(digests(tmp_path / "a" / folder)) == {f"{name}.fmu" for name in names}
        assert digests(tmp_path / "a" / folder) == digests(tmp_path / "somewhere" / "else" / folder)


def test_every_kind_of_an_fmu_has_a_guid_of_its_own(tmp_path):
    kinds = [("2.0", 2, "CoSimulation"), ("3.0", 3, "CoSimulation"), ("3.0", 3, "ModelExchange")]
    assert len({build.guid("Pendulum", *kind) for _, *kind in kinds}) == 3
    for version, *kind in kinds:
        description = fmpy.read_model_description(str(build.build("Pendulum", tmp_path, *kind)))
        assert (description.fmiVersion, description.guid) == (version, build.guid("Pendulum", *kind))


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("Pendulum", 1), "fmi must be 2 or 3, got 1"),
        (("Pendulum", 2, "ModelExchange"), "got Pendulum in FMI 2.0"),
        (
            ("PendulumController", 3, "ModelExchange"),
            "model exchange is for FrictionPendulum, .*, got PendulumController",
        ),
    ],
)
def test_what_there_is_not_is_refused(arguments, reason):
    with pytest.raises(ValueError, match=reason):
        build.guid(*arguments)


def test_the_guid_is_known_before_the_build(built):
    assert set(built[2]) == set(build.NAMES)
    assert {name: guid_of(path) for name, path in built[2].items()} == {name: build.guid(name) for name in build.NAMES}
    assert len({build.guid(name) for name in build.NAMES}) == len(build.NAMES)


def test_a_plant_is_found_by_its_folder(tmp_path):
    root = copy_of_the_package(tmp_path)
    crane = root / "fmu_models" / "crane"
    shutil.copytree(root / "fmu_models" / "pendulum", crane)
    (crane / "plant.png").unlink()
    for path in crane.glob("*.py"):
        path.write_text(path.read_text(encoding="utf-8").replace("Pendulum", "Crane"), encoding="utf-8")
    code = "import sys; from fmu_models import build; build.build('Crane', sys.argv[1]); print(*build.NAMES)"
    names = in_a_process(code, tmp_path / "out", root=root).split()
    own = ["Crane", "CraneController", "CraneControllerAdaptive", "CraneReference", "CraneSine"]
    assert names == sorted([*build.NAMES, *own])
    with zipfile.ZipFile(tmp_path / "out" / "Crane.fmu") as archive:
        assert "model.png" not in archive.namelist()  # rather none than another plant's
        assert "(g/l) sin" in archive.read("documentation/index.html").decode()


def test_the_guid_follows_the_sources(tmp_path):
    root = copy_of_the_package(tmp_path)
    code = "from fmu_models import build; print(build.guid('Pendulum'))"
    assert in_a_process(code, root=root).strip() == build.guid("Pendulum")
    with (root / "fmu_models" / "kernel" / "ode.py").open("a") as file:
        file.write("# changed\n")
    assert in_a_process(code, root=root).strip() != build.guid("Pendulum")


@pytest.mark.full
def test_an_installed_package_is_not_written_to(tmp_path):
    root = copy_of_the_package(tmp_path / "site")
    folders = [root, *(path for path in root.rglob("*") if path.is_dir())]
    before = [digests(folder) for folder in folders]
    for folder in folders:
        folder.chmod(0o555)
    in_a_process(BUILD, tmp_path / "out", root=root, PYTHONDONTWRITEBYTECODE="1")
    assert [digests(folder) for folder in folders] == before
    assert digests(tmp_path / "out") == digests_of_a_build(tmp_path / "again")


def digests_of_a_build(directory):
    build.build("Pendulum", directory)
    return digests(directory)


@pytest.mark.full
def test_builds_at_the_same_time_leave_whole_files_and_nothing_else(tmp_path):
    command = [sys.executable, "-P", "-c", BUILD, str(tmp_path / "out")]
    variables = {**os.environ, "PYTHONPATH": str(PACKAGE.parent)}
    builders = [subprocess.Popen(command, env=variables) for _ in range(4)]
    assert [builder.wait() for builder in builders] == [0] * 4
    assert digests(tmp_path / "out") == digests_of_a_build(tmp_path / "alone")


def test_a_failed_build_leaves_the_old_file_and_no_other(tmp_path, monkeypatch):
    path = build.build("Pendulum", tmp_path)
    before = path.read_bytes()
    monkeypatch.setattr(build.os, "replace", lambda *_: (_ for _ in ()).throw(OSError("no space")))
    with pytest.raises(OSError, match="no space"):
        build.build("Pendulum", tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["Pendulum.fmu"]
    assert path.read_bytes() == before


def test_the_imports_of_the_caller_are_left_as_they_were(tmp_path):
    path, modules = list(sys.path), set(sys.modules)
    build.build("QuadrotorController", tmp_path)
    assert sys.path == path
    assert not {name for name in set(sys.modules) - modules if name.endswith("_fmu")}


def test_a_module_that_has_a_script_s_name_is_neither_used_nor_lost(tmp_path, monkeypatch):
    stranger = type(sys)("pendulum_fmu")
    monkeypatch.setitem(sys.modules, "pendulum_fmu", stranger)
    assert guid_of(build.build("Pendulum", tmp_path)) == build.guid("Pendulum")
    assert sys.modules["pendulum_fmu"] is stranger


def test_an_fmu_holds_its_own_plant_and_no_trace_of_its_build(tmp_path):
    with zipfile.ZipFile(build.build("Quadrotor", tmp_path)) as archive:
        entries = archive.infolist()
        script = archive.read("resources/slavemodule.txt")
    names = [entry.filename for entry in entries]
    assert names == sorted(set(names))
    assert {entry.date_time for entry in entries} == {(1980, 1, 1, 0, 0, 0)}
    assert not [name for name in names if "__pycache__" in name or name.endswith(".pyc")]
    suffix = build.guid("Quadrotor")[:8]
    modules = [PACKAGE / "__init__.py", *(PACKAGE / "kernel").glob("*.py"), *(PACKAGE / "quadrotor").glob("*.py")]
    assert {name for name in names if name.startswith("resources/fmu_models")} == {
        f"resources/fmu_models_{suffix}/{path.relative_to(PACKAGE).as_posix()}" for path in modules
    }
    assert script == f"quadrotor_fmu_{suffix}".encode()
    binaries = {"binaries/linux64/Quadrotor.so", "binaries/win64/Quadrotor.dll"}
    assert {*binaries, f"resources/quadrotor_fmu_{suffix}.py"} <= set(names)


@pytest.mark.parametrize("function", [build.guid, lambda name: build.build(name, "nowhere")], ids=["guid", "build"])
def test_an_unknown_name_is_refused(function):
    with pytest.raises(ValueError, match=r"name must be one of FrictionPendulum, .*, got 'Pendulun'"):
        function("Pendulun")
    assert not Path("nowhere").exists()
