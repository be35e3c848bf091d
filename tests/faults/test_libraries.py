"""What is read off the headers of libraries for Linux, on sound ones that are damaged in one place.

Places are those of ELF, 64 bit: the file's header, and that of a segment.
"""

import re
import struct
import subprocess
import sys
from io import BytesIO

import fmpy
import pytest
from fmpy.model_description import CoSimulation, ModelDescription, ModelVariable

from cosim.fmi.preflight.library import elf_problems, needed_functions

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(not (sys.platform == "linux" and fmpy.platform == "linux64"), reason="libraries of Linux"),
]
LOAD, DYNAMIC = 1, 2
NO_SECTIONS = (0x28, "<Q", 0), (0x3C, "<H", 0)
OF_2 = (  # FMI 2.0.4, section 2.4: all of them, by table of contents
    "fmi2GetTypesPlatform fmi2GetVersion fmi2SetDebugLogging fmi2Instantiate fmi2FreeInstance fmi2SetupExperiment "
    "fmi2EnterInitializationMode fmi2ExitInitializationMode fmi2Terminate fmi2Reset fmi2GetReal fmi2GetInteger "
    "fmi2GetBoolean fmi2GetString fmi2SetReal fmi2SetInteger fmi2SetBoolean fmi2SetString fmi2GetFMUstate "
    "fmi2SetFMUstate fmi2FreeFMUstate fmi2SerializedFMUstateSize fmi2SerializeFMUstate fmi2DeSerializeFMUstate "
    "fmi2GetDirectionalDerivative"
)
CO_SIMULATION_2 = (  # section 4.2
    "fmi2SetRealInputDerivatives fmi2GetRealOutputDerivatives fmi2DoStep fmi2CancelStep fmi2GetStatus "
    "fmi2GetRealStatus fmi2GetIntegerStatus fmi2GetBooleanStatus fmi2GetStringStatus"
)
MODEL_EXCHANGE_2 = (  # section 3.2
    "fmi2EnterEventMode fmi2NewDiscreteStates fmi2EnterContinuousTimeMode fmi2CompletedIntegratorStep fmi2SetTime "
    "fmi2SetContinuousStates fmi2GetDerivatives fmi2GetEventIndicators fmi2GetContinuousStates "
    "fmi2GetNominalsOfContinuousStates"
)
OF_3 = "fmi3FreeInstance fmi3EnterInitializationMode fmi3ExitInitializationMode fmi3Terminate"
STATES_3 = (
    "fmi3GetFMUState fmi3SetFMUState fmi3FreeFMUState fmi3SerializedFMUStateSize fmi3SerializeFMUState "
    "fmi3DeserializeFMUState"
)
NEEDED = {
    ("2.0", "co-simulation"): f"{OF_2} {CO_SIMULATION_2}",
    ("2.0", "model-exchange"): f"{OF_2} {MODEL_EXCHANGE_2}",
    ("3.0", "co-simulation"): f"{OF_3} fmi3InstantiateCoSimulation fmi3DoStep fmi3SetFloat64 fmi3GetInt64 {STATES_3}",
    ("3.0", "model-exchange"): f"{OF_3} fmi3InstantiateModelExchange fmi3EnterEventMode fmi3EnterContinuousTimeMode "
    "fmi3UpdateDiscreteStates fmi3SetContinuousStates fmi3GetContinuousStateDerivatives",
    ("3.0-beta.2", "co-simulation"): f"{OF_3} fmi3InstantiateCoSimulation fmi3DoStep fmi3SetFloat64 fmi3GetInt64 "
    f"{STATES_3}",
}


def problems(content, needed=frozenset(), machine="x86_64"):
    return [*elf_problems(BytesIO(content), len(content), machine, needed)]


def described(version):
    """The description of an FMU of both interfaces, which saves its state."""
    part = CoSimulation(modelIdentifier="Model", canGetAndSetFMUstate=True, canSerializeFMUstate=True)
    variables = [
        ModelVariable(name, i, type=kind, causality=causality)
        for i, (name, kind, causality) in enumerate([("u", "Float64", "input"), ("y", "Enumeration", "output")])
    ]
    return ModelDescription(fmiVersion=version, coSimulation=part, modelVariables=variables)


def patched(content, *changes):
    """content with numbers written into it: (place, form, value)."""
    data = bytearray(content)
    for place, form, value in changes:
        struct.pack_into(form, data, place, value)
    return bytes(data)


def segments(content, kind):
    """Places of the headers of the segments of a kind."""
    (first,) = struct.unpack_from("<Q", content, 0x20)
    length, n = struct.unpack_from("<HH", content, 0x36)
    return [p for p in range(first, first + n * length, length) if struct.unpack_from("<I", content, p) == (kind,)]


@pytest.fixture(scope="module")
def linked(compiled, tmp_path_factory):
    """linked(names, *options): a library of functions of these names, which do nothing."""
    compiled()  # skips where there is no compiler

    def link(names, *options):
        path = tmp_path_factory.mktemp("linked") / "library.so"
        source = "".join(f"void {name}(void) {{}}\n" for name in names)
        command = ["gcc", "-shared", "-fPIC", "-Wl,--hash-style=both", *options, "-x", "c", "-", "-o", path]
        subprocess.run(command, input=source.encode(), check=True)
        return path.read_bytes()

    return link


@pytest.mark.parametrize(("version", "interface"), NEEDED)
def test_a_library_without_a_function_of_its_interface_is_refused(linked, version, interface):
    names, needed = NEEDED[version, interface].split(), needed_functions(described(version), interface)
    sound = linked(names)
    assert problems(sound, needed) == []
    for name in names:
        renamed = sound.replace(b"\0" + name.encode() + b"\0", b"\0x" + name[1:].encode() + b"\0")
        assert problems(renamed, needed) == [f"lacks the function {name}"]


@pytest.mark.parametrize("style", ["sysv", "gnu", "both"])
def test_what_a_library_has_is_told_by_either_of_the_loaders_tables(linked, style):
    library = linked(["other"], f"-Wl,--hash-style={style}")
    assert problems(library, {"other"}) == []
    assert problems(library, {"other", "fmi2DoStep"}) == ["lacks the function fmi2DoStep"]


def test_a_function_that_a_library_only_calls_is_lacking(linked):
    library = linked(["other"], "-Wl,--hash-style=sysv", "-Wl,-u,fmi2DoStep")
    assert problems(library, {"fmi2DoStep"}) == ["lacks the function fmi2DoStep"]


def test_what_a_library_without_sections_has_is_not_told(linked):
    """The loader does not need them."""
    assert problems(patched(linked(["other"]), *NO_SECTIONS), {"fmi2DoStep"}) == []


@pytest.mark.parametrize(
    ("changes", "machine", "is_of_it"),
    [
        ([], "x86_64", True),
        ([], "aarch64", False),
        ([], "riscv64", False),
        ([(18, "<H", 0xB7)], "aarch64", True),
        ([(18, "<H", 0xB7)], "x86_64", False),
        ([(5, "B", 2), (18, ">H", 0xB7)], "aarch64", False),  # of the other byte order
        ([(4, "B", 1)], "x86_64", False),  # of 32 bit
    ],
)
def test_machines(linked, changes, machine, is_of_it):
    told = problems(patched(linked(["f"]), *changes), machine=machine)
    assert any(line.startswith("is a library of another machine") for line in told) != is_of_it
    assert all(f"; this one is {machine}" in line or is_of_it for line in told)


def test_a_library_that_is_cut_off_by_one_byte(linked):
    """Without the sections, of which the headers are last."""
    library = patched(linked(["f"]), *NO_SECTIONS)
    end = max(sum(struct.unpack_from("<8xQ16xQ", library, place)) for place in segments(library, LOAD))
    assert problems(library[:end]) == []
    assert problems(library[: end - 1]) == ["is cut off: it has fewer bytes than its header says"]


def test_a_library_that_the_loader_cannot_link(linked):
    library = linked(["f"])
    (place,) = segments(library, DYNAMIC)
    assert problems(patched(library, (place, "<I", 0))) == ["is no shared library: it has no dynamic section"]


def test_damage_anywhere_is_one_problem_in_one_line(linked):
    """In the headers of file and segments, the table of names, which follows them, and the types of sections."""
    library = linked(["fmi2DoStep"])
    (sections,) = struct.unpack_from("<Q", library, 0x28)
    for place in (*range(0, 1024, 4), *range(sections + 4, len(library), 64)):
        for value in (0, 0xFFFFFFFF):
            told = problems(patched(library, (place, "<I", value)), {"fmi2DoStep"})
            assert all(re.fullmatch(r"(is|lacks) [\x20-\x7e]*", line) for line in told)
            assert len(told) <= 1
