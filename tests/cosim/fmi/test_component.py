"""An FMU as a component, by its description alone: what FMPy leaves out of it, and what takes no start value."""

import zipfile

import fmpy
import pytest

from cosim.errors import WiringError
from cosim.fmi.archive import read_checked
from cosim.fmi.component import component_of, items_of, read_component
from cosim.ssp.arrays import arrays_of, with_arrays
from cosim.ssv.document import ArrayValue, ParameterValue, document, parameter_set, ssv_element
from cosim.ssv.xml import parse
from cosim.units import IDENTITY, Linear, conversion

TWO = """<fmiModelDescription fmiVersion="2.0" modelName="M" guid="g">
<CoSimulation modelIdentifier="M"/>
<UnitDefinitions><Unit name="K"><BaseUnit K="1"/></Unit>
<Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit></UnitDefinitions>
<TypeDefinitions>
<SimpleType name="Difference"><Real unit="degC" relativeQuantity="true"/></SimpleType></TypeDefinitions>
<ModelVariables>
<ScalarVariable name="T" valueReference="0" causality="input"><Real unit="degC" start="0"/></ScalarVariable>
<ScalarVariable name="dT" valueReference="1" causality="input"><Real unit="degC" start="0"
 relativeQuantity="true"/></ScalarVariable>
<ScalarVariable name="typed" valueReference="2" causality="input"><Real declaredType="Difference" start="0"/>
</ScalarVariable>
<ScalarVariable name="not" valueReference="3" causality="input"><Real declaredType="Difference" start="0"
 relativeQuantity="false"/></ScalarVariable>
<ScalarVariable name="K" valueReference="4" causality="output"><Real unit="K"/></ScalarVariable>
</ModelVariables><ModelStructure><Outputs><Unknown index="5"/></Outputs><InitialUnknowns><Unknown index="5"/>
</InitialUnknowns></ModelStructure></fmiModelDescription>"""
THREE = """<fmiModelDescription fmiVersion="3.0" modelName="M" instantiationToken="t">
<CoSimulation modelIdentifier="M"/>
<TypeDefinitions><EnumerationType name="Mode"><Item name="slow" value="1"/><Item name="fast" value="2"/>
</EnumerationType></TypeDefinitions>
<ModelVariables>
<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
<UInt8 name="u" valueReference="1" causality="input" start="0" min="2" max="10"/>
<Int8 name="i" valueReference="2" causality="input" start="0" min="2" max="10"/>
<Enumeration name="mode" valueReference="3" causality="parameter" variability="fixed" start="1" declaredType="Mode"/>
<UInt64 name="n" valueReference="4" causality="structuralParameter" variability="fixed" start="2"/>
<String name="names" valueReference="5" causality="parameter" variability="fixed"><Dimension start="2"/>
<Start value="a"/><Start value="b"/></String>
<Int32 name="k" valueReference="6" causality="parameter" variability="fixed" start="1 2 3">
<Dimension start="3"/></Int32>
<Boolean name="on" valueReference="7" causality="parameter" variability="fixed" start="true false">
<Dimension start="2"/></Boolean>
<Float64 name="y" valueReference="8" causality="output"/>
</ModelVariables><ModelStructure><Output valueReference="8"/></ModelStructure></fmiModelDescription>"""


@pytest.fixture
def component(tmp_path):
    def made(text):
        path = tmp_path / "M.fmu"
        platform = fmpy.platform if 'fmiVersion="2' in text else fmpy.platform_tuple
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("modelDescription.xml", text)
            archive.writestr(f"binaries/{platform}/M{fmpy.sharedLibraryExtension}", b"")
        return read_component(path)

    return made


@pytest.mark.parametrize("is_checked", [False, True])
def test_a_difference_is_converted_without_the_unit_s_offset(component, is_checked):
    """FMI 2.0.4, section 2.2.3: 10 K of difference are 10 degrees; a temperature of 283.15 K is 10 of them."""
    made = component(TWO)
    made = component_of(made.fmu, read_checked(made.fmu)) if is_checked else made
    kelvin = made.unit("K")
    assert conversion(kelvin, made.unit("T"))(283.15) == 10.0
    assert conversion(kelvin, made.unit("not")) == Linear(1.0, -273.15)
    for name in ("dT", "typed"):
        assert conversion(kelvin, made.unit(name)) == IDENTITY == conversion(made.unit(name), kelvin)


@pytest.mark.parametrize("is_checked", [False, True])
def test_limits_of_every_whole_type_hold(component, is_checked):
    made = component(THREE)
    made = component_of(made.fmu, read_checked(made.fmu)) if is_checked else made
    for name in ("u", "i"):
        assert made.catalogue.ports("input", [name]).problem([3.0]) is None
        for value in (1.0, 11.0):
            assert f"input '{name}' must be within [2, 10], got {value:g}" in made.catalogue.ports(
                "input", [name]
            ).problem([value])


def test_an_enumeration_of_fmi_3_has_its_items(component):
    variables = component(THREE).variables
    assert items_of(variables["mode"]) == {"slow": 1, "fast": 2}
    assert items_of(variables["i"]) is None


@pytest.mark.parametrize(("name", "value"), [("n", 3), ("names[1]", "z"), ("names[2]", "z")])
def test_sizes_and_parts_of_texts_take_no_start_value(component, name, value):
    with pytest.raises(WiringError, match="takes no start value: "):
        component(THREE).catalogue.start_port(name, value)


@pytest.mark.parametrize(
    ("name", "value", "written"),
    [("k[1]", 7, (7, 2, 3)), ("k[2]", 7.0, (1, 7, 3)), ("on[2]", True, (True, True)), ("on[1]", False, (False, False))],
)
def test_elements_that_are_not_given_keep_the_type_of_their_array(component, name, value, written):
    made = component(THREE)
    (array,) = with_arrays([ParameterValue(name, value)], made, arrays_of(made))
    assert isinstance(array, ArrayValue)
    assert [(v, type(v)) for v in array.values] == [(v, type(v)) for v in written]
    text = document(ssv_element("s", [array], {}, {"ssv", "ssc"}))
    read = parameter_set(parse(text.encode(), "s", "ParameterSet"), "s").values
    assert tuple(p.value for p in read) == written
