"""`retune doctor`: what an FMU needs, native or in Python, whole or broken."""

import importlib
import os
import platform
import re
import shutil
import struct
import subprocess
import sys
import zipfile
from importlib.metadata import version
from io import BytesIO
from pathlib import Path

import pytest
from elftools.elf.elffile import ELFFile
from pythonfmu import FmuBuilder

from cosim.authoring import library_search
from cosim.authoring.doctor import diagnose
from cosim.authoring.library_search import missing_libraries
from cosim.authoring.shared_library import read_shared_library
from cosim.cli import main
from cosim.errors import ModelDescriptionError
from cosim.system.fmu_cache import find_fmu
from fmu_models.build import NAMES

pytestmark = [pytest.mark.fmu, pytest.mark.skipif(sys.platform != "linux", reason="examines libraries for Linux")]
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler: gcc is not installed")

DESCRIPTIONS = {
    "2.0": """<fmiModelDescription fmiVersion="2.0" modelName="Native" guid="1" generationTool="A tool 1.0">
<CoSimulation modelIdentifier="Native"/><ModelVariables><ScalarVariable name="x" valueReference="0" causality="local">
<Real/></ScalarVariable></ModelVariables><ModelStructure/></fmiModelDescription>""",
    "3.0": """<fmiModelDescription fmiVersion="3.0" modelName="Native" instantiationToken="1">
<ModelExchange modelIdentifier="Native"/><ModelVariables>
<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/></ModelVariables>
<ModelStructure/></fmiModelDescription>""",
}
FOLDERS = {"2.0": "binaries/linux64", "3.0": "binaries/x86_64-linux"}


@pytest.fixture
def pendulum(tmp_path):
    return find_fmu("Pendulum", tmp_path)


def zipped(path, files):
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def with_library(fmu, target, change):
    """A copy of an FMU with the bytes of its library for Linux changed."""
    with zipfile.ZipFile(fmu) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    return zipped(target, {n: change(c) if n.startswith("binaries/linux64/") else c for n, c in files.items()})


def compiled(folder, source, *options):
    (folder / "library.c").write_text(source)
    command = ["gcc", "-shared", "-fPIC", "-o", folder / "library.so", folder / "library.c", *options]
    subprocess.run(command, check=True, cwd=folder)
    return (folder / "library.so").read_bytes()


def finding(diagnosis, subject):
    (found,) = [f for f in diagnosis.findings if f.subject == subject]
    return found


@pytest.mark.full_but("Pendulum")
@pytest.mark.parametrize("name", NAMES)
def test_our_fmus_lack_nothing(tmp_path, name):
    diagnosis = diagnose(find_fmu(name, tmp_path))
    assert diagnosis.is_well, str(diagnosis)
    assert [f.subject for f in diagnosis.findings] == ["binary", "glibc", "libraries", "libpython", "modules"]
    assert "FMI 2.0 for co-simulation, made by PythonFMU" in diagnosis.title
    assert finding(diagnosis, "modules").text == "none but those of Python and its own"


def test_the_modules_that_an_fmu_imports_are_looked_for(tmp_path):
    (tmp_path / "needy_own.py").write_text("import tomllib, scipy.optimize\nfrom numpy import array\n")
    (tmp_path / "needy_slave.py").write_text(
        "import needy_own\nfrom pythonfmu import Fmi2Causality, Fmi2Slave, Real\n"
        "class Needy(Fmi2Slave):\n"
        "    def __init__(self, **kwargs):\n        super().__init__(**kwargs)\n        self.y = 0.0\n"
        "        self.register_variable(Real('y', causality=Fmi2Causality.output))\n"
        "    def do_step(self, t, h):\n        import no_such_module.part\n        return True\n"
    )
    FmuBuilder.build_FMU(tmp_path / "needy_slave.py", dest=tmp_path, project_files=[tmp_path / "needy_own.py"])
    diagnosis = diagnose(tmp_path / "Needy.fmu")
    assert not diagnosis.is_well
    assert finding(diagnosis, "modules").text == f"no_such_module cannot be imported in {sys.prefix}"
    with_library(tmp_path / "Needy.fmu", tmp_path / "Fed.fmu", lambda content: content)
    with zipfile.ZipFile(tmp_path / "Fed.fmu", "a") as archive:
        archive.writestr("resources/no_such_module/__init__.py", "")
        archive.writestr("resources/no_such_module/part.py", "")
    found = finding(diagnose(tmp_path / "Fed.fmu"), "modules")
    assert found.is_well
    assert re.fullmatch(r"numpy [\d.]+, scipy [\d.]+", found.text)


@pytest.mark.parametrize(
    ("line", "is_well", "text"),
    [
        ("Find-LibPython>=0.4  # this; not that", True, f"Find-LibPython {version('find_libpython')}"),
        ("no_such", False, f"no_such not installed in {sys.prefix}; python -m pythonfmu deploy -f FMU does it"),
        ("no_such>1; sys_platform == 'win32'\n# numpy", True, "none; on conditions: no_such"),
    ],
    ids=["other-spelling", "missing", "marker"],
)
def test_required_packages_are_found_by_any_spelling_and_not_looked_for_on_conditions(
    tmp_path, pendulum, line, is_well, text
):
    with_requirements = with_library(pendulum, tmp_path / "required.fmu", lambda content: content)
    with zipfile.ZipFile(with_requirements, "a") as archive:
        archive.writestr("resources/requirements.txt", line)
    found = finding(diagnose(with_requirements), "modules")
    assert (found.is_well, found.text) == (is_well, text)


def test_a_script_that_python_cannot_read_is_told(tmp_path, pendulum):
    with zipfile.ZipFile(pendulum) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    script = f"resources/{files['resources/slavemodule.txt'].decode()}.py"
    found = finding(diagnose(zipped(tmp_path / "broken.fmu", files | {script: b"def ("})), "modules")
    assert not found.is_well
    assert "cannot be read" in found.text


def test_a_newer_glibc_than_ours_is_told(tmp_path, pendulum):
    newer = with_library(pendulum, tmp_path / "newer.fmu", lambda so: so.replace(b"GLIBC_2.32", b"GLIBC_9.32"))
    diagnosis = diagnose(newer)
    here = platform.libc_ver()[1]
    assert finding(diagnosis, "glibc") == type(diagnosis.findings[0])("glibc", False, f"9.32 or newer, here {here}")
    assert "GLIBC_9.32' not found" in finding(diagnosis, "libraries").text


@needs_gcc
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_a_native_fmu_needs_no_python(tmp_path, fmi):
    library = compiled(tmp_path, "double fmi2One(void) { return 1.0; }")
    files = {"modelDescription.xml": DESCRIPTIONS[fmi], f"{FOLDERS[fmi]}/Native.so": library}
    diagnosis = diagnose(zipped(tmp_path / "Native.fmu", files))
    assert diagnosis.is_well, str(diagnosis)
    assert finding(diagnosis, "binary").text == f"{FOLDERS[fmi]}/Native.so"
    assert diagnosis.advice == "It is native: any importer loads it as it is."
    kind = {"2.0": "co-simulation, made by A tool 1.0", "3.0": "model exchange, made by a tool that it does not name"}
    assert diagnosis.title.endswith(f"FMI {fmi} for {kind[fmi]}")


def test_a_library_of_another_name_is_told(tmp_path):
    files = {"modelDescription.xml": DESCRIPTIONS["2.0"], "binaries/linux64/Other.so": b""}
    found = finding(diagnose(zipped(tmp_path / "Native.fmu", files)), "binary")
    text = "Native by the model description, but here is binaries/linux64/Other.so"
    assert (found.is_well, found.text) == (False, text)


@needs_gcc
def test_a_library_that_is_not_here_is_named(tmp_path):
    compiled(tmp_path, "int gone(void) { return 1; }", "-Wl,-soname,libgone.so.1")
    (tmp_path / "library.so").rename(tmp_path / "libgone.so")
    library = compiled(tmp_path, "int gone(void); int here(void) { return gone(); }", "-L.", "-lgone")
    files = {"modelDescription.xml": DESCRIPTIONS["2.0"], "binaries/linux64/Native.so": library}
    found = finding(diagnose(zipped(tmp_path / "Native.fmu", files)), "libraries")
    assert (found.is_well, found.text) == (False, "libgone.so.1 => not found")


@needs_gcc
def test_no_code_of_a_library_runs(tmp_path):
    """`ldd` loads the library's audit libraries."""
    marker = tmp_path / "ran"
    audit = f'#include <stdio.h>\nunsigned la_version(unsigned v) {{ fclose(fopen("{marker}", "w")); return v; }}'
    compiled(tmp_path, audit)
    (tmp_path / "library.so").rename(tmp_path / "audit.so")
    library = compiled(tmp_path, "double fmi2One(void) { return 1.0; }", f"-Wl,--audit={tmp_path / 'audit.so'}")
    files = {"modelDescription.xml": DESCRIPTIONS["2.0"], "binaries/linux64/Native.so": library}
    assert diagnose(zipped(tmp_path / "Native.fmu", files)).is_well
    assert not marker.exists()


@needs_gcc
@pytest.mark.parametrize("flag", ["--enable-new-dtags", "--disable-new-dtags"])
def test_libraries_of_libraries_are_looked_for_where_each_says(tmp_path, flag):
    """A DT_RPATH holds for what a library's libraries need too, a DT_RUNPATH does not."""
    compiled(tmp_path, "int last(void) { return 1; }", "-Wl,-soname,liblast.so")
    (tmp_path / "library.so").rename(tmp_path / "liblast.so")
    middle = compiled(tmp_path, "int last(void); int middle(void) { return last(); }", "-L.", "-llast")
    (tmp_path / "libmiddle.so").write_bytes(middle)
    options = ["-L.", "-lmiddle", "-Wl,-rpath,$ORIGIN/own", f"-Wl,{flag}", "-Wl,-soname,Native.so"]
    library = compiled(tmp_path, "int middle(void); int here(void) { return middle(); }", *options)
    files = {
        "modelDescription.xml": DESCRIPTIONS["2.0"],
        "binaries/linux64/Native.so": library,
        "binaries/linux64/own/libmiddle.so": middle,
        "binaries/linux64/own/liblast.so": (tmp_path / "liblast.so").read_bytes(),
    }
    found = finding(diagnose(zipped(tmp_path / "Native.fmu", files)), "libraries")
    assert found.text == ("libmiddle.so" if "disable" in flag else "liblast.so => not found")


@pytest.mark.skipif(shutil.which("ldd") is None, reason="there is no ldd to compare with")
@pytest.mark.parametrize("module", ["numpy", "scipy"])
def test_what_is_found_is_what_ldd_finds(module):
    folder = Path(importlib.import_module(module).__file__).parent
    for path in sorted([*folder.rglob("*.so"), *folder.parent.glob(f"{module}.libs/*.so*")])[-12:]:
        listing = subprocess.run(["ldd", path], capture_output=True, text=True, env=os.environ | {"LC_ALL": "C"})
        theirs = {line.split(" (")[0].strip() for line in listing.stdout.splitlines() if "not found" in line}
        library = read_shared_library(path)
        assert {name for name in missing_libraries(path, library) if "=>" in name} == theirs, path


def test_a_search_without_end_is_given_up(tmp_path, monkeypatch, pendulum):
    monkeypatch.setattr(library_search, "LONGEST_S", -1.0)
    found = finding(diagnose(pendulum), "libraries")
    assert not found.is_well
    assert found.text == "not all looked for: the search was given up after -1 s"


def test_a_table_without_end_is_no_librarys(tmp_path, pendulum):
    """Versions that are needed: 2^31 by the section's header, each the same one."""

    def endless(library):
        elf = ELFFile(BytesIO(library))
        number = next(i for i, s in enumerate(elf.iter_sections()) if s.name == ".gnu.version_r")
        (offset,) = [s["sh_offset"] for s in elf.iter_sections() if s.name == ".gnu.version_r"]
        patched = bytearray(library)
        struct.pack_into("<I", patched, elf["e_shoff"] + number * elf["e_shentsize"] + 44, 1 << 31)
        struct.pack_into("<I", patched, offset + 12, 0)
        return bytes(patched)

    found = finding(diagnose(with_library(pendulum, tmp_path / "endless.fmu", endless)), "binary")
    assert not found.is_well
    assert found.text.endswith("is no shared library for Linux")


@needs_gcc
def test_what_blocks_when_it_is_opened_is_no_library(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "libgone.so.1")
    monkeypatch.setenv("LD_LIBRARY_PATH", str(tmp_path))
    test_a_library_that_is_not_here_is_named(tmp_path)


@pytest.mark.parametrize("name", ["../x", "x/y", b"\xff", "x" * 300], ids=["above", "below", "bytes", "long"])
def test_a_script_of_an_odd_name_is_told(tmp_path, pendulum, name):
    with zipfile.ZipFile(pendulum) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    found = finding(diagnose(zipped(tmp_path / "odd.fmu", files | {"resources/slavemodule.txt": name})), "modules")
    assert not found.is_well
    assert found.text.startswith("its script cannot be read: ")


@pytest.mark.parametrize("content", [b"", b"MZ not for Linux", b"\x7fELF" + bytes(60)], ids=["empty", "other", "cut"])
def test_a_file_that_is_no_library_is_told(tmp_path, content):
    files = {"modelDescription.xml": DESCRIPTIONS["2.0"], "binaries/linux64/Native.so": content}
    diagnosis = diagnose(zipped(tmp_path / "Native.fmu", files))
    assert not diagnosis.is_well
    assert finding(diagnosis, "binary").text == "binaries/linux64/Native.so is no shared library for Linux"
    assert diagnosis.advice == "No importer can load it as it is: build the FMU anew for this platform."


BROKEN = {
    "no file": (None, "cannot be read: No such file or directory"),
    "no zip": (b"not a zip", "is not a usable FMU: File is not a zip file"),
    "no description": ({"readme.txt": ""}, "is not a usable FMU: .*modelDescription.xml"),
    "no binary": (
        {"modelDescription.xml": DESCRIPTIONS["2.0"], "binaries/win64/Native.dll": ""},
        "has no binary for linux64, only for win64",
    ),
    "no platform": ({"modelDescription.xml": DESCRIPTIONS["2.0"]}, "has no binary for linux64, nor for any other"),
    "a path that leads out": (
        {"modelDescription.xml": DESCRIPTIONS["2.0"], "binaries/linux64/Native.so": "", "../x": ""},
        "outside its folder",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("content", "message"), BROKEN.values(), ids=BROKEN)
def test_a_broken_file_is_refused_in_one_line(tmp_path, capfd, content, message):
    path = tmp_path / "broken.fmu"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        zipped(path, content)
    with pytest.raises(ModelDescriptionError, match=message):
        diagnose(path)
    assert main(["doctor", str(path)]) == 2
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert re.match(f"retune: .*{message}", err)


def test_the_command_tells_by_its_exit_code_whether_something_is_missing(tmp_path, pendulum, capfd):
    assert main(["doctor", str(pendulum)]) == 0
    text = capfd.readouterr().out
    assert "LD_PRELOAD=" in text.splitlines()[-1]
    assert re.search(r"^  ok +libpython +/", text, re.MULTILINE)
    newer = with_library(pendulum, tmp_path / "newer.fmu", lambda so: so.replace(b"GLIBC_2.32", b"GLIBC_9.32"))
    assert main(["doctor", str(newer)]) == 1
    assert "  MISSING  glibc" in capfd.readouterr().out
