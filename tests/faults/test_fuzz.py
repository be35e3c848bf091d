"""Mutations of sound files: whatever is in an archive, a model description, a library or a scenario file, only
CosimError escapes, in one line.

    FUZZ_MUTANTS=100000 FUZZ_SEED=1 python -m pytest tests/faults/test_fuzz.py

tries as many as one likes; a mutant that fails is printed with what is needed to make it again.
"""

import os
import random
import re
import zipfile
from importlib.resources import files
from pathlib import Path

import pytest

from cosim.authoring.check import check
from cosim.authoring.check_fmu import check_fmu
from cosim.errors import CosimError
from cosim.fmi.archive import unpacked
from cosim.fmi.component import read_component
from cosim.fmi.ports import Catalogue
from cosim.scenarios.named import named_scenarios
from cosim.scenarios.scenario import Scenario
from cosim.system.fmu_cache import find_fmu

pytestmark = pytest.mark.fmu
N_MUTANTS = int(os.environ.get("FUZZ_MUTANTS", "0"))
SEED = int(os.environ.get("FUZZ_SEED", "0"))

# What mutations put in: numbers at their limits, words of the formats, characters that mean something in them.
XML_WORDS = [
    "0", "-1", "1", "2", "4294967295", "4294967296", "1e999", "NaN", "INF", "-INF", "", " ", "true", "Real", "String",
    "Integer", "Float64", "input", "output", "parameter", "independent", "exact", "calculated", "fixed", "tunable",
    "continuous", "2.0", "3.0", "1.0", "der(x)", "x[1,2]", "\u00e4", "\u202e", "&lt;", "&#10;", "&#0;", "<", ">", '"',
    "&", "]]>", "<!--",
]  # fmt: skip
TOML_WORDS = [
    "0", "-1", "1e308", "1e-308", "nan", "inf", "-inf", "true", '""', "'''", "[", "]", "{", "}", "=", ".", "9" * 30,
    '"plant.u"', '"plant.m"', '"controller.m"', '"plant."', '".m"', '"t"', '"t ** t ** t"', '"1/0"', '"__import__"',
    "[[0.0, 1.0], [0.0, 2.0]]", "\u0000", "1979-05-27", '"log"', '"process"', '"none"', '"Pendulum"', '"../x"',
    '"fmu_models.pendulum:nothing"', '"os:system"',
]  # fmt: skip


def mutated(text: str, words: list[str], rng: random.Random) -> str:
    """text with one to three changes: of a value, of a word, of a line, of a character."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        values = [m.span(1) for m in re.finditer(r'"([^"\n]*)"|(?<== )([^\n]+)', text) if m.group(1) is not None]
        values += [m.span() for m in re.finditer(r"(?<== )[^\n]+", text)]
        lines = text.splitlines(keepends=True)
        kind = rng.randrange(7)
        if kind <= 2 and values:
            a, b = rng.choice(values)
            text = text[:a] + rng.choice(words) + text[b:]
        elif kind == 3 and len(values) > 1:
            (a, b), (c, d) = rng.sample(values, 2)
            text = text[:a] + text[c:d] + text[b:]
        elif kind == 4:
            lines.pop(rng.randrange(len(lines)))
            text = "".join(lines) or " "
        elif kind == 5:
            lines.insert(rng.randrange(len(lines)), rng.choice(lines))
            text = "".join(lines)
        else:
            a = rng.randrange(len(text))
            text = text[:a] + rng.choice([*words, ""]) + text[a + rng.randrange(3) :]
    return text


def damaged(content: bytes, rng: random.Random) -> bytes:
    """content with some bytes changed, a part left out or repeated."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 2, 5))):
        a = rng.randrange(len(data))
        kind = rng.randrange(4)
        if kind == 0:
            data[a] = rng.randrange(256)
        elif kind == 1:
            data[a : a + 4] = rng.choice((b"\0" * 4, b"\xff" * 4, b"\x7f\xff\xff\xff", b"\0\0\0\x80"))
        elif kind == 2:
            del data[a : a + rng.randrange(1, 64)]
        else:
            data[a:a] = data[a : a + rng.randrange(1, 64)]
        if not data:
            return b"\0"
    return bytes(data)


def only_ours(function, *arguments) -> None:
    """Call; what it raises must be ours, and one line."""
    try:
        function(*arguments)
    except CosimError as error:
        assert len(str(error).splitlines()) <= 1, str(error)


def use(fmu: Path) -> None:
    """All that is done with an FMU before its code runs."""
    component = read_component(fmu)
    _ = component.derivatives, component.experiment, [component.unit(name) for name in component.variables]
    catalogue = Catalogue(fmu.name, component.description.modelVariables)
    catalogue.ports("output", [v.name for v in component.having("output")])
    for interface in ("co-simulation", "model-exchange"):
        try:
            _, folder = unpacked(fmu, interface)
        except CosimError:
            continue
        folder.remove()


def try_fmu(fmu: Path) -> None:
    only_ours(use, fmu)
    only_ours(lambda: [str(finding).splitlines() for finding in check_fmu(fmu)])


def mutants(n: int):
    """Seeds of mutants."""
    return range(SEED, SEED + (N_MUTANTS or n))


@pytest.mark.full_but("Native-2")
@pytest.mark.parametrize(("name", "fmi"), [("Pendulum", 2), ("Pendulum", 3), ("Native", 2)])
def test_descriptions(native, tmp_path, name, fmi):
    sound = native if name == "Native" else find_fmu(name, Path(), fmi)
    with zipfile.ZipFile(sound) as archive:
        contents = {n: archive.read(n) for n in archive.namelist() if n.startswith(("modelD", "binaries"))}
    text, path = contents["modelDescription.xml"].decode(), tmp_path / "mutant.fmu"
    for seed in mutants(80):
        mutant = mutated(text, XML_WORDS, random.Random(seed))
        with zipfile.ZipFile(path, "w") as archive:
            for member, content in contents.items():
                is_text = member == "modelDescription.xml"
                archive.writestr(member, mutant.encode("utf-8", "replace") if is_text else content)
        told(try_fmu, path, seed)


@pytest.mark.full
def test_archives_and_libraries(native, tmp_path):
    """Bytes of the archive; every second time those of the library within a sound archive."""
    with zipfile.ZipFile(native) as archive:
        contents = {n: archive.read(n) for n in archive.namelist()}
    library, path = next(name for name in contents if name.startswith("binaries")), tmp_path / "mutant.fmu"
    for seed in mutants(160):
        rng = random.Random(seed)
        if seed % 2:
            path.write_bytes(damaged(native.read_bytes(), rng))
        else:
            head = damaged(contents[library][:1024], rng) + contents[library][1024:]
            with zipfile.ZipFile(path, "w") as archive:
                for member, content in (contents | {library: head}).items():
                    archive.writestr(member, content)
        told(try_fmu, path, seed)


@pytest.mark.full_but("pendulum")
@pytest.mark.parametrize("name", named_scenarios())
def test_scenarios(tmp_path, name):
    text = (files("cosim") / "scenarios" / f"{name}.toml").read_text(encoding="utf-8")
    path = tmp_path / "mutant.toml"
    for seed in mutants(60):
        path.write_bytes(mutated(text, TOML_WORDS, random.Random(seed)).encode("utf-8", "replace"))
        told(lambda p: only_ours(Scenario.load, p), path, seed)
        if seed % 10 == 0:  # with the FMUs, which takes longer
            told(lambda p: only_ours(check, p), path, seed)


def told(function, path: Path, seed: int) -> None:
    try:
        function(path)
    except Exception as error:
        error.add_note(f"the mutant of FUZZ_SEED={seed} FUZZ_MUTANTS=1, kept at {path}")
        raise
