"""Parameter values out and in, checked by the schemas that FMPy ships."""

import os

import pytest
from fmpy.ssp.ssd import read_ssv as fmpy_read_ssv

from cosim.errors import SspError
from cosim.fmi.types import TYPES
from cosim.ssv.document import ParameterValue, read_ssv, to_ssv
from cosim.units import make_unit

VALUES = (
    ParameterValue("plant.m", 4.271, "kg"), ParameterValue("n", -3), ParameterValue("on", True),
    ParameterValue("name", "a < b & c"), ParameterValue("angle", 1e-300, "deg"), ParameterValue("odd", 0.1, "Nm"),
)  # fmt: skip
UNITS = {
    "kg": make_unit("kg", {"kg": 1}), "deg": make_unit("deg", {"rad": 1, "factor": 0.017453292519943295}),
    "s": make_unit("s", {"s": 1}), "Nm": make_unit("Nm", None),
}  # fmt: skip


def ssv(parameters, version="1.0", units="", doctype=""):
    return (
        f'<?xml version="1.0"?>{doctype}<x:ParameterSet version="{version}" name="p" '
        'xmlns:x="http://ssp-standard.org/SSP1/SystemStructureParameterValues" '
        f'xmlns:y="http://ssp-standard.org/SSP1/SystemStructureCommon"><x:Parameters>{parameters}</x:Parameters>{units}'
        "</x:ParameterSet>"
    )


@pytest.fixture
def read(tmp_path):
    def read(text):
        path = tmp_path / "p.ssv"
        path.write_text(text, encoding="utf-8")
        return read_ssv(path)

    return read


def test_what_is_written_is_valid_and_fmpy_reads_it(tmp_path):
    path = tmp_path / "estimates.ssv"
    path.write_text(to_ssv("set", VALUES, UNITS), encoding="utf-8")
    found = fmpy_read_ssv(str(path))  # validates against SystemStructureParameterValues.xsd
    assert [(p.name, p.type, p.value, p.unit) for p in found.parameters] == [
        ("plant.m", "Real", "4.271", "kg"), ("n", "Integer", "-3", None), ("on", "Boolean", "true", None),
        ("name", "String", "a < b & c", None), ("angle", "Real", "1e-300", "deg"), ("odd", "Real", "0.1", None),
    ]  # fmt: skip


def test_what_is_written_is_read_again(read):
    found = read(to_ssv("set", VALUES, UNITS))
    assert found.name == "set"
    assert found.values == (*VALUES[:-1], ParameterValue("odd", 0.1))  # a unit that nobody defines is left out
    assert dict(found.units) == {"kg": UNITS["kg"], "deg": UNITS["deg"]}


def test_prefixes_of_the_written_file_are_literal():
    assert '<ssv:Parameter name="n">' in to_ssv("set", VALUES, UNITS)
    assert '<ssc:BaseUnit rad="1" factor="0.017453292519943295" />' in to_ssv("set", VALUES, UNITS)


READABLE = [row for row in TYPES.values() if row.python not in (bytes, None)]


@pytest.mark.parametrize("row", READABLE, ids=lambda row: row.name)
def test_a_value_is_read_by_its_type_fmi_3s_from_version_2(read, row):
    (parameter,) = read(ssv(f'<x:Parameter name="a"><x:{row.name} value="1"/></x:Parameter>', "2.0")).values
    assert parameter.value == ("1" if row.ssp in ("String", "Enumeration") else 1)
    assert type(parameter.value) is (str if row.name == "Enumeration" else row.python)  # SSP writes the item's name


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<a", r"p\.ssv is not readable XML: unclosed token"),
        (ssv("", doctype='<!DOCTYPE a [<!ENTITY e "e">]>'), r"document type \(DOCTYPE\), which is refused"),
        (ssv("", version="3.0"), "of SSP version '3.0', not 1.0 or 2.0"),
        ("<ParameterSet/>", "of SSP version ''"),
        ('<a version="1.0"/>', "must be a ParameterSet of SSP 1.0 or 2.0, got the element 'a'"),
        (ssv('<x:Parameter name="a"><x:Real value="1,5"/></x:Parameter>'), "parameter 'a' is no Real: '1,5'"),
        (ssv('<x:Parameter name="a"><x:Real value="1_2"/></x:Parameter>'), "parameter 'a' is no Real: '1_2'"),
        (ssv('<x:Parameter name="a"><x:Integer value="1_2"/></x:Parameter>'), "parameter 'a' is no Integer: '1_2'"),
        (ssv(f'<x:Parameter name="a"><x:Integer value="{"9" * 400}"/></x:Parameter>'), "'a' must be .* a double"),
        (ssv('<x:Parameter name="a"><x:Real value="1"/></x:Parameter>' * 2), "two parameters have the name 'a'"),
        (ssv('<x:Parameter name="a"><x:Boolean value="yes"/></x:Parameter>'), "'a' is no Boolean: 'yes'"),
        (ssv('<x:Parameter name="a"/>'), "'a' must be a number, Boolean, String or Enumeration, got nothing"),
        (ssv('<x:Parameter name="a"><x:Binary value="00"/></x:Parameter>'), "got Binary"),
        (
            ssv('<x:Parameter name="a"><x:Real value="1 2"/><x:Dimension size="3"/></x:Parameter>'),
            "'a' has 2 values for",
        ),
        (ssv('<x:Parameter name="a"><x:Real value="1 2"/><x:Dimension size="-2"/></x:Parameter>'), "dimensions -2"),
        (ssv('<x:Parameter name="a"><x:Real value=""/><x:Dimension/></x:Parameter>'), "dimensions not given"),
        (ssv('<x:Parameter name="a"><x:Real value="1 b"/><x:Dimension/></x:Parameter>'), r"'a\[2\]' is no Real: 'b'"),
        (ssv('<x:Parameter name="a"><x:String value="b"/><x:Dimension size="1"/></x:Parameter>'), "of no numbers"),
        (ssv("<x:Parameter><x:Real value='1'/></x:Parameter>"), "a Parameter has no name"),
        (ssv("", units='<x:Units><y:Unit name="g"><y:BaseUnit kg="a"/></y:Unit></x:Units>'), "unit 'g'"),
    ],
)
def test_bad_files_are_refused_in_one_line(read, text, message):
    with pytest.raises(SspError, match=message) as refused:
        read(text)
    assert "\n" not in str(refused.value)


def test_a_missing_file_and_a_pipe_are_told(tmp_path):
    os.mkfifo(tmp_path / "pipe.ssv")
    with pytest.raises(SspError, match=r"pipe\.ssv cannot be read: it is not a regular file"):
        read_ssv(tmp_path / "pipe.ssv")
    with pytest.raises(SspError, match=r"none\.ssv cannot be read: No such file"):
        read_ssv(tmp_path / "none.ssv")


def test_a_number_that_is_not_finite_is_not_written():
    with pytest.raises(ValueError, match="must be finite, got nan"):
        to_ssv("set", [ParameterValue("a", float("nan"))])


def test_arrays_of_ssp_2_are_read_by_their_elements(tmp_path):
    """In row-major order; one dimension may be without a size."""
    path = tmp_path / "arrays.ssv"
    J = '<x:Parameter name="J"><x:Float64 value="1 2 3 4 5 6" unit="kg"/><x:Dimension size="2"/><x:Dimension size="3"/>'
    path.write_text(ssv(f'{J}</x:Parameter><x:Parameter name="n"><x:Int32 value="7 8"/><x:Dimension/></x:Parameter>'))
    found = {p.name: p.value for p in read_ssv(path).values}
    assert found == {"J[1,1]": 1, "J[1,2]": 2, "J[1,3]": 3, "J[2,1]": 4, "J[2,2]": 5, "J[2,3]": 6, "n[1]": 7, "n[2]": 8}
