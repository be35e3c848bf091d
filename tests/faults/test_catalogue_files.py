"""The rows of catalogue.toml on files: refused, or warned of, before any of an FMU's code runs."""

import os
import random
import re
import struct
import sys
import tomllib
import zipfile
from contextlib import ExitStack
from pathlib import Path

import fmpy
import pytest

from cosim.errors import ModelDescriptionError, SlaveError
from cosim.fmi.preflight.library import pe_problem
from cosim.slaves.slave import open_slave

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(not (sys.platform == "linux" and fmpy.platform == "linux64"), reason="libraries of Linux"),
]
CATALOGUE = tomllib.loads(Path(__file__).with_name("catalogue.toml").read_text(encoding="utf-8"))
DESCRIPTION, LIBRARY = "modelDescription.xml", "binaries/linux64/Native.so"
ARRAYS = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Native" instantiationToken="{native}">
  <CoSimulation modelIdentifier="Native"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent"/>
    <Float64 name="r" valueReference="1" causality="parameter" variability="tunable" start="1 2 3">
      <Dimension start="3"/></Float64>
  </ModelVariables>
  <ModelStructure/>
</fmiModelDescription>
"""


def zipped(path: Path, files: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def files_of(fmu: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(fmu) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def add(path: Path, name: str, content: bytes = b"x", **attributes: int) -> None:
    entry = zipfile.ZipInfo(name)
    for key, value in attributes.items():
        setattr(entry, key, value)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(entry, content)


def patch_directory(path: Path, name: str, offset: int, form: str, value: int) -> None:
    """Write a number into the central directory's entry of that name (APPNOTE.TXT, section 4.3.12)."""
    data = bytearray(path.read_bytes())
    end = data.rindex(b"PK\x05\x06")
    place = data.index(b"PK\x01\x02")
    while place < end:
        n_name, n_extra, n_comment = struct.unpack_from("<HHH", data, place + 28)
        if data[place + 46 : place + 46 + n_name] == name.encode():
            struct.pack_into(form, data, place + offset, value)
        place += 46 + n_name + n_extra + n_comment
    path.write_bytes(data)


def overlap(path: Path) -> None:
    add(path, "resources/a", b"a" * 1000)
    with zipfile.ZipFile(path) as archive:
        first = archive.getinfo("resources/a").header_offset
    add(path, "resources/b", b"a" * 1000)
    patch_directory(path, "resources/b", 42, "<I", first + 100)


def with_zeros(path: Path) -> None:
    add(path, "resources/zeros", bytes(1 << 20), compress_type=zipfile.ZIP_DEFLATED)
    patch_directory(path, "resources/zeros", 24, "<I", 300 << 20)


def too_large(path: Path) -> None:
    for name in ("resources/a", "resources/b"):
        add(path, name, b"x")
        patch_directory(path, name, 24, "<I", 3_000_000_000)


def too_many(path: Path) -> None:
    with zipfile.ZipFile(path, "a") as archive:
        for i in range(50_000):
            archive.writestr(f"resources/{i}", b"")


def with_size(path: Path, size: int) -> None:
    """The description is said to have this size, in an archive that is not packed so well."""
    add(path, "resources/random", random.Random(0).randbytes(2 << 20))
    patch_directory(path, DESCRIPTION, 24, "<I", size)


def damage(path: Path, what: str) -> None:
    """Change one byte of the compressed description."""
    data = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as archive:
        entry = archive.getinfo(DESCRIPTION)
    place = entry.header_offset + 30 + len(DESCRIPTION) + entry.compress_size // 2
    data[place : place + 8] = bytes(8)
    path.write_bytes(data)


def with_table(path: Path, offset: int, form: str, value: int) -> None:
    """A file that no model description names, of which the directory says what is not so."""
    add(path, "resources/table", b"0.0, 1.0\n" * 1000, compress_type=zipfile.ZIP_DEFLATED)
    patch_directory(path, "resources/table", offset, form, value)


def as_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def as_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


ARCHIVES = {
    "no zip": lambda p: p.write_text("not a zip"),
    "empty file": lambda p: p.write_bytes(b""),
    "cut in half": lambda p: p.write_bytes(p.read_bytes()[: p.stat().st_size // 2]),
    "a folder": as_folder,
    "a pipe": as_pipe,
    "no file": lambda p: p.unlink(),
    "no description": lambda p: zipped(p, {"readme.txt": b"no FMU"}),
    "long name": lambda p: add(p, "resources/" + "x" * 300),
    "symbolic link": lambda p: add(p, "resources/link", b"/etc/passwd", external_attr=0o120777 << 16),
    "device": lambda p: add(p, "resources/link", b"", external_attr=0o020666 << 16),
    "encrypted": lambda p: patch_directory(p, DESCRIPTION, 8, "<H", 1),
    "file as folder": lambda p: (add(p, "resources"), add(p, "resources/table.csv")),
    "overlapping": overlap,
    "bomb": with_zeros,
    "too large": too_large,
    "too many": too_many,
    "wrong checksum": lambda p: patch_directory(p, DESCRIPTION, 16, "<I", 17),
    "damaged contents": lambda p: damage(p, DESCRIPTION),
    "a size that is too small": lambda p: patch_directory(p, DESCRIPTION, 24, "<I", 100),
    "a table's wrong checksum": lambda p: with_table(p, 16, "<I", 17),
    "a table's size that is too small": lambda p: with_table(p, 24, "<I", 100),
    "a table's packed size that is too small": lambda p: with_table(p, 20, "<I", 10),
    "a table by an unknown method": lambda p: with_table(p, 10, "<H", 9),
    "a library's wrong checksum": lambda p: patch_directory(p, LIBRARY, 16, "<I", 17),
    "a description that is too large": lambda p: with_size(p, (256 << 20) + 1),
    "a description that is large": lambda p: with_size(p, 256 << 20),
    "a description of another name": lambda p: add(p, "./" + DESCRIPTION),
    "file and folder": lambda p: (add(p, "resources"), add(p, "resources/", b"")),
    "case": lambda p: (add(p, "resources/A"), add(p, "resources/a")),
    "another method": lambda p: add(p, "resources/table", b"x" * 100, compress_type=zipfile.ZIP_BZIP2),
}


@pytest.fixture
def unsound(tmp_path, native) -> Path:
    """A copy of the sound FMU, to be damaged."""
    path = tmp_path / "Native.fmu"
    path.write_bytes(native.read_bytes())
    return path


@pytest.fixture
def is_told(unsound, tmp_path, command):
    """Checks a row: what `retune check` says, and that opening the FMU refuses it in the same words, or takes it."""
    marker = tmp_path / "loaded"

    def check(row):
        code, out, err = command("check", unsound)
        lines = [line for line in (out + err).splitlines() if line != f"next: retune info {unsound}"]
        assert all(line.startswith((f"{unsound}: ", "retune: ")) for line in lines), lines
        assert not marker.exists(), "code of the FMU has run"
        without = [re.sub("(error|warning): ", "", line, count=1) for line in lines]
        assert any(re.search(row["expected"], line) for line in without), lines
        if row.get("warns"):
            assert code == 0
            assert lines[-1] == f"{unsound}: 0 errors, {len(lines) - 1} warning{'' if len(lines) == 2 else 's'}"
            with open_slave(unsound, "plant") as slave:
                slave.bind(inputs=["u"])
            return
        assert code == 2
        assert sum(": error: " in line or line.startswith("retune: ") for line in lines) >= 1
        with pytest.raises(ModelDescriptionError, match=row["expected"]) as caught:
            open_slave(unsound, "plant")
        assert "\n" not in str(caught.value)
        assert str(unsound) in str(caught.value)
        assert not marker.exists(), "code of the FMU has run"

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHON_FAULT_MARKER", str(marker))
        yield check


LONG = {"too many": pytest.mark.full}


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "row", [pytest.param(r, id=repr(r["inject"]), marks=LONG.get(r["inject"], ())) for r in CATALOGUE["archive"]]
)
def test_archive(unsound, is_told, row):
    how = row["inject"]
    with ExitStack() as stack:
        if how in ("two descriptions", "a table twice"):
            stack.enter_context(pytest.warns(UserWarning, match="Duplicate name"))
            name = DESCRIPTION if how == "two descriptions" else "resources/table"
            for _ in range(1 if how == "two descriptions" else 2):
                add(unsound, name)
        elif how.startswith("name "):
            add(unsound, how.removeprefix("name "))
        else:
            ARCHIVES[how](unsound)
    is_told(row)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("row", CATALOGUE["description"], ids=lambda row: row["fault"])
def test_description(unsound, is_told, row):
    files = files_of(unsound)
    old, new = row["replace"]
    text = files[DESCRIPTION].decode()
    assert old in text
    zipped(unsound, files | {DESCRIPTION: text.replace(old, new).encode()})
    is_told(row)


@pytest.mark.parametrize("row", CATALOGUE["arrays"], ids=lambda row: row["fault"])
def test_arrays(unsound, is_told, compiled, row):
    old, new = row["replace"]
    assert old in ARRAYS
    files = {DESCRIPTION: ARRAYS.replace(old, new).encode(), "binaries/x86_64-linux/Native.so": compiled()}
    zipped(unsound, files)
    is_told(row)


def patched(content: bytes, place: int, value: bytes) -> bytes:
    return content[:place] + value + content[place + len(value) :]


LIBRARIES = {  # places: the header of ELF, 64 bit
    "none": lambda so: {},
    "for Windows only": lambda so: {"binaries/win64/Native.dll": so},
    "of another name": lambda so: {"binaries/linux64/Other.so": so},
    "empty": lambda so: {LIBRARY: b""},
    "text": lambda so: {LIBRARY: b"#!/bin/sh\necho no library\n"},
    "header only": lambda so: {LIBRARY: so[:64]},
    "cut": lambda so: {LIBRARY: so[: len(so) // 2]},
    "cut, without sections": lambda so: {LIBRARY: patched(patched(so, 40, bytes(8)), 60, bytes(2))[: len(so) // 2]},
    "of another machine": lambda so: {LIBRARY: patched(so, 18, struct.pack("<H", 0xB7))},
    "of 32 bit": lambda so: {LIBRARY: patched(so, 4, b"\1")},
    "of the other byte order": lambda so: {LIBRARY: patched(so, 5, b"\2")},
    "a program": lambda so: {LIBRARY: patched(so, 16, struct.pack("<H", 2))},
}


WITHOUT = {"without fmi2DoStep": "WITHOUT_DO_STEP", "without fmi2GetFMUstate": "WITHOUT_GET_STATE"}


@pytest.mark.parametrize("row", CATALOGUE["library"], ids=lambda row: row["inject"])
def test_library(unsound, is_told, compiled, row):
    if row["inject"] == "an object file":
        library = {LIBRARY: compiled("-c", "-fPIC")}
    elif row["inject"] in WITHOUT:
        library = {LIBRARY: compiled("-shared", "-fPIC", f"-D{WITHOUT[row['inject']]}")}
    else:
        library = LIBRARIES[row["inject"]](compiled())
    zipped(unsound, {DESCRIPTION: files_of(unsound)[DESCRIPTION]} | library)
    is_told(row)


def test_a_library_that_needs_what_is_nowhere_is_found_when_it_is_loaded(unsound, compiled):
    """Which functions other libraries have only the loader knows."""
    library = compiled("-shared", "-fPIC", "-DNEEDS_WHAT_IS_NOWHERE", "-Wl,-z,now")
    zipped(unsound, files_of(unsound) | {LIBRARY: library})
    with open_slave(unsound, "plant") as slave, pytest.raises(SlaveError, match="nowhere") as caught:
        slave.bind()
    assert str(caught.value).startswith("plant: instantiate failed: ")


def test_the_sound_one_is_sound(unsound, command):
    following = f"next: retune info {unsound}\n"
    assert command("check", unsound) == (0, f"{unsound}: 0 errors, 0 warnings\n{following}", "")
    with open_slave(unsound, "plant") as slave:
        slave.bind(inputs=["u"], outputs=["y"])
        slave.initialize({})
        assert slave.step([3.0], 0.0, 0.01) == (3.0,)


def test_all_errors_of_an_fmu_are_listed(unsound, command):
    files = files_of(unsound)
    text = files[DESCRIPTION].decode().replace('min="-100"', 'min="101"').replace('startTime="0"', 'startTime="NaN"')
    zipped(unsound, {DESCRIPTION: text.encode(), LIBRARY: b"text", "../x": b""})
    code, out, err = command("check", unsound)
    lines = out.splitlines()
    assert (code, err) == (2, "")
    assert lines[-1] == f"{unsound}: 4 errors, 1 warning"  # the start value is outside the bounds, which are none
    for word in ("outside its folder", "min 101 > max 100", "startTime nan", "not a valid shared library"):
        assert sum(word in line for line in lines) == 1


PE = b"MZ" + bytes(58) + struct.pack("<I", 64) + b"PE\0\0" + struct.pack("<H", 0x8664) + bytes(16) + b"\x22\x20"


@pytest.mark.parametrize(
    ("head", "machine", "problem"),
    [
        (PE, "AMD64", None),
        (PE, "ARM64", "is a library of another machine (PE machine 0x8664); this one is ARM64"),
        (PE[:-2] + b"\x22\x00", "AMD64", "is a program, not a library"),
        (PE.replace(b"\x64\x86", b"\x4c\x01"), "x86", None),
        (PE, "x86_64", None),
        (PE.replace(b"PE\0\0", b"NE\0\0"), "AMD64", "is not a valid library for Windows (PE)"),
        (PE[:70], "AMD64", "is not a valid library for Windows (PE)"),
        (b"\x7fELF" + PE[4:], "AMD64", "is not a valid library for Windows (PE)"),
        (PE[:60] + struct.pack("<I", 1 << 31) + PE[64:], "AMD64", "is not a valid library for Windows (PE)"),
        (b"", "AMD64", "is not a valid library for Windows (PE)"),
    ],
    ids=["sound", "other machine", "program", "32 bit", "other name", "older", "cut", "ELF", "offset beyond", "empty"],
)
def test_libraries_of_windows_are_told_by_their_headers(head, machine, problem):
    assert pe_problem(head, machine) == problem
