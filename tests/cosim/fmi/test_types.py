"""The table of FMI types against the schemas, C headers and C types that FMPy ships: no row missing or incomplete."""

import math
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import pytest
from fmpy import fmi2, fmi3
from fmpy.model_description import ModelVariable

from cosim.fmi.elements import handle
from cosim.fmi.ports import Ports
from cosim.fmi.types import TYPES, Access, FmiType
from cosim.fmi.value_buffers import ScalarVariable, buffers_of
from cosim.fmi.value_buffers3 import buffers3_of

FMPY = Path(fmpy.__file__).parent
XS = "{http://www.w3.org/2001/XMLSchema}"
FMI2 = [row for row in TYPES.values() if row.fmi2]
FMI3 = [row for row in TYPES.values() if row.fmi3]


def choice(path, parent):
    """Names of the elements from which the schema's element, type or group of that name lets one choose."""
    root = ElementTree.parse(FMPY / path).getroot()
    (found,) = (e for e in root.iter() if e.get("name") == parent)
    return {element.get("name") for element in found.find(f".//{XS}choice").findall(f"{XS}element")}


def test_every_type_of_the_standards_has_a_row():
    of_fmi2 = choice("schema/fmi2/fmi2ScalarVariable.xsd", "fmi2ScalarVariable")
    of_fmi3 = choice("schema/fmi3/fmi3Variable.xsd", "fmi3Variable")
    assert of_fmi2 | of_fmi3 == set(TYPES)
    assert {row.name for row in FMI2} == of_fmi2
    assert {row.name for row in FMI3} == of_fmi3 - {"Binary", "Clock"}
    assert {row.ssp for row in TYPES.values()} - {None} == choice("ssp/schema/SystemStructureCommon.xsd", "GTypeChoice")


@pytest.mark.parametrize("row", FMI2, ids=lambda row: row.name)
def test_functions_and_c_types_are_those_of_fmi_2(row):
    header = (FMPY / "c-code/fmi2FunctionTypes.h").read_text()
    assert all(f"fmi2{verb}{row.fmi2.functions}TYPE" in header for verb in ("Get", "Set"))
    assert row.fmi2.c_type is getattr(fmi2, f"fmi2{row.fmi2.functions}")


@pytest.mark.parametrize("row", FMI3, ids=lambda row: row.name)
def test_functions_and_c_types_are_those_of_fmi_3(row):
    header = (FMPY / "c-code/fmi3FunctionTypes.h").read_text()
    assert all(f"fmi3{verb}{row.fmi3.functions}TYPE" in header for verb in ("Get", "Set"))
    assert row.fmi3.c_type is getattr(fmi3, f"fmi3{row.fmi3.functions}")


LIMITS = {
    "Int8": (-128, 127), "UInt8": (0, 255), "Int16": (-32768, 32767), "UInt16": (0, 65535),
    "Int32": (-2147483648, 2147483647), "UInt32": (0, 4294967295), "Boolean": (0, 1),
    "Int64": (-9007199254740992, 9007199254740992), "UInt64": (0, 9007199254740992),  # what a double holds exactly
    "Integer": (-2147483647, 2147483647), "Enumeration": (-2147483647, 2147483647),  # the lowest means: not filled
}  # fmt: skip


@pytest.mark.parametrize("name", TYPES)
def test_the_limits_of_a_type_cross_both_ways_and_nothing_beyond(name):
    row = TYPES[name]
    assert row.limits == LIMITS.get(name)
    assert row.is_numeric == (name in LIMITS or name in ("Real", "Float32", "Float64"))
    if not row.is_numeric:
        return
    low, high = map(float, row.limits or (-0.5, 1e30))
    port = Ports("input", [ModelVariable("x", 0, name), ModelVariable("x", 1, name)])
    assert port.problem([low, high]) is None
    if row.limits:
        assert "must be within" in port.problem([low, math.nextafter(high, math.inf)])
        assert "must be within" in port.problem([math.nextafter(low, -math.inf), high])
    for version, access in ((2, row.fmi2), (3, row.fmi3)):
        if access is not None and access.functions == name:
            buffer = buffer_of(name, version)
            buffer.fill([low, high])
            assert list(buffer.read()) == pytest.approx([low, high], rel=1e-7 if name == "Float32" else 0.0, abs=0.0)


def buffer_of(name, version):
    if version == 2:
        (buffer,) = buffers_of([ScalarVariable("x", name, 0), ScalarVariable("y", name, 1)])
        return buffer
    variables = [ScalarVariable("x[1]", name, handle(0, 0)), ScalarVariable("x[2]", name, handle(0, 1))]
    (buffer,) = buffers3_of(variables, {0: [0.0, 0.0]})
    return buffer


def test_a_new_type_is_one_row(monkeypatch):
    row = FmiType("Int7", int, "Integer", fmi3=Access("Int7", fmi3.fmi3Int8))
    monkeypatch.setitem(TYPES, "Int7", row)
    buffer = buffer_of("Int7", 3)
    buffer.fill([-3.0, 5.0])
    assert (buffer.getter, buffer.setter, list(buffer.read())) == ("fmi3GetInt7", "fmi3SetInt7", [-3, 5])
    assert (
        Ports("output", [ModelVariable("x", 0, "Int7")]).problem([0.5]) == "output 'x' must be a whole number, got 0.5"
    )
