"""Packages made elsewhere: what is read of them, what comes of simulating them, and what is refused."""

import io
import math
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cosim import ModelDescriptionError, SspError, System, WiringError
from cosim.ssp.scenario import with_system
from cosim.system.fmu_cache import find_fmu

pytestmark = [pytest.mark.fmu, pytest.mark.usefixtures("leaves_nothing")]

SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
SSM = "http://ssp-standard.org/SSP1/SystemStructureParameterMapping"
SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"


def bound(structure, where, *bindings):
    """The structure with parameter bindings at the place that a comment marks."""
    mark = f"<!--{where}-->"
    assert mark in structure
    return structure.replace(mark, "".join(bindings))


def values(parameters, attributes=""):
    """A binding of inline values, their elements in the prefix p."""
    return (
        f'<ParameterBinding {attributes}><ParameterValues><p:ParameterSet xmlns:p="{SSV}" version="1.0" name="s">'
        f"<p:Parameters>{parameters}</p:Parameters></p:ParameterSet></ParameterValues></ParameterBinding>"
    )


def real(name, value, unit=""):
    return f'<p:Parameter name="{name}"><p:Real value="{value}"{f""" unit="{unit}" """ if unit else ""}/></p:Parameter>'


# What is read.


def test_prefixes_and_layout_do_not_matter(package):
    system = System.from_ssp(package())
    assert (system.name, system.start_time, system.stop_time, system.step_size) == ("hand made", 0.0, 0.2, 0.01)
    assert list(system.components) == ["plant", "controller", "reference"]
    assert {str(c.target): str(c.source) for c in system.connections} == {
        "controller.phi": "plant.phi", "controller.phi_dot": "plant.phi_dot", "plant.u": "controller.u",
        "controller.phi_ref": "reference.phi_ref", "controller.phi_dot_ref": "reference.phi_dot_ref",
    }  # fmt: skip


def test_the_loop_follows_its_own_closed_form(package, flat):
    """The feedback-linearising law, written out, of the plant's states one step before; at the start of the same."""
    run = System.from_ssp(package(bound(flat, "plant", values(real("phi", 0.4))))).simulate()
    assert (run.status, len(run.time)) == ("done", 21)
    phi, rate, u = run["plant.phi"], run["plant.phi_dot"], run["controller.u"]
    kp, kd, m, l, g, b = 10.0, 5.0, 1.75, 0.75, 9.81, 0.1
    reference = run["reference.phi_ref"]
    law = m * l * (kp * (reference - phi) + kd * -rate) + m * l * (g / l * np.sin(phi) + b / m * rate)
    assert u[0] == pytest.approx(law[0], rel=1e-13)  # inputs are known in initialization mode
    assert u[1:] == pytest.approx(law[:-1], rel=1e-13)  # and later one step late
    assert run["plant.u_held"][1:] == pytest.approx(u[:-1], rel=1e-15)


def test_version_2_is_read(package, flat):
    structure = flat.replace('version="1.0"', 'version="2.0"').replace("<c:Real/>", "<c:Float64/>")
    parameters = '<p:Parameter name="phi"><p:Float64 value="0.25"/></p:Parameter>'
    system = System.from_ssp(package(bound(structure, "plant", values(parameters).replace("1.0", "2.0"))))
    assert system.start["plant"] == {"phi": 0.25}


def test_bindings_later_and_higher_up_come_first(package, flat):
    low = values(real("m", 1.0) + real("l", 1.0) + real("b", 0.2)) + values(real("m", 2.0))
    high = values(real("plant.l", 3.0)) + values(real("phi_final", 0.7), 'prefix="reference."')
    system = System.from_ssp(package(bound(bound(flat, "plant", low), "top", high)))
    assert system.start == {"plant": {"m": 2.0, "l": 3.0, "b": 0.2}, "controller": {}, "reference": {"phi_final": 0.7}}


def test_parameters_in_files_are_mapped_and_converted(package, flat):
    ssv = (
        f'<ParameterSet xmlns="{SSV}" xmlns:c="{SSC}" version="1.0" name="s"><Parameters>'
        '<Parameter name="weight"><Real value="2500" unit="g"/></Parameter>'
        '<Parameter name="tilt"><Real value="30" unit="deg"/></Parameter>'
        '<Parameter name="l"><Real value="9"/></Parameter></Parameters>'
        '<Units><c:Unit name="g"><c:BaseUnit kg="1" factor="0.001"/></c:Unit>'
        '<c:Unit name="deg"><c:BaseUnit rad="1" factor="0.017453292519943295"/></c:Unit></Units></ParameterSet>'
    )
    ssm = (
        f'<m:ParameterMapping xmlns:m="{SSM}" xmlns:c="{SSC}" version="1.0">'
        '<m:MappingEntry source="weight" target="m"/>'
        '<m:MappingEntry source="tilt" target="phi"><c:LinearTransformation factor="-1" offset="1"/></m:MappingEntry>'
        '<m:MappingEntry source="nothing" target="b"/></m:ParameterMapping>'
    )
    binding = (
        '<ParameterBinding source="resources/values%20of%20mine.ssv">'
        '<ParameterMapping source="resources/map.ssm"/></ParameterBinding>'
    )
    files = {"resources/values of mine.ssv": ssv, "resources/map.ssm": ssm}
    system = System.from_ssp(package(bound(flat, "plant", binding), files))
    assert system.start["plant"] == {"m": 2.5, "phi": pytest.approx(1.0 - math.pi / 6, rel=1e-15)}  # l is not mapped


def test_parameters_that_no_component_has_are_passed_over_and_told(package, flat):
    structure = bound(bound(flat, "plant", values(real("mm", 1.0))), "top", values(real("wing.m", 1.0)))
    assert System.from_ssp(package(structure)).ignored == ("plant.mm", "wing.m")


def nested(flat):
    """Plant and controller in a system of their own, whose connectors are joined to the reference."""
    inner, rest = flat.partition("<Elements>")[2].split('      <Component name="reference"')
    reference = '<Component name="reference"' + rest.partition("</Elements>")[0]
    return (
        flat.partition("<Elements>")[0] + '<Elements><System name="drive"><Connectors>'
        '<Connector name="target" kind="input"><c:Real unit="deg"/></Connector><Connector name="rate" kind="input"/>'
        '<Connector name="mass" kind="parameter"><c:Real unit="g"/></Connector>'
        f'<Connector name="angle" kind="output"/></Connectors><Elements>{inner}</Elements><Connections>'
        '<Connection startElement="plant" startConnector="phi" endElement="controller" endConnector="phi"/>'
        '<Connection startElement="plant" startConnector="phi_dot" endElement="controller" endConnector="phi_dot"/>'
        '<Connection startConnector="target" endElement="controller" endConnector="phi_ref"/>'
        '<Connection startConnector="rate" endElement="controller" endConnector="phi_dot_ref"/>'
        '<Connection startElement="controller" startConnector="u" endElement="plant" endConnector="u"/>'
        '<Connection startConnector="mass" endElement="plant" endConnector="m"/>'
        '<Connection startElement="plant" startConnector="phi" endConnector="angle"/>'
        f"</Connections></System>{reference}</Elements><Connections>"
        '<Connection startElement="reference" startConnector="phi_ref" endElement="drive" endConnector="target"/>'
        '<Connection startElement="reference" startConnector="phi_dot_ref" endElement="drive" endConnector="rate"/>'
        "</Connections></System>" + flat.partition("</System>")[2]
    ).replace('name="phi_dot" kind="output"/>', 'name="phi_dot" kind="output"/><Connector name="m" kind="parameter"/>')


@pytest.mark.full
def test_systems_within_systems_are_dissolved(package, flat):
    start = values(real("drive.plant.phi", 0.9) + real("drive.mass", 2000))
    inner = System.from_ssp(package(bound(nested(flat), "top", start), name="nested.ssp"))
    outer = System.from_ssp(package(bound(flat, "plant", values(real("phi", 0.9) + real("m", 2.0))), name="flat.ssp"))
    assert list(inner.components) == ["drive.plant", "drive.controller", "reference"]
    assert inner.start["drive.plant"] == {"phi": 0.9, "m": 2.0}
    one, other = inner.simulate(), outer.simulate()
    # The angle goes from rad to deg at the system's connector and back again, which costs an ulp.
    assert one["drive.plant.phi"] == pytest.approx(other["plant.phi"], rel=1e-14)
    assert np.ptp(one["drive.plant.phi"]) > 0.01


def with_outer_mass(flat):
    """The nested system, with a connector of the top system that leads to that of the inner one."""
    structure = nested(flat).replace(
        '<System name="top">', '<System name="top"><Connectors><Connector name="Q" kind="parameter"/></Connectors>'
    )
    end = structure.rindex("</Connections></System>")
    way = '<Connection startConnector="Q" endElement="drive" endConnector="mass"/>'
    return structure[:end] + way + structure[end:]


@pytest.mark.parametrize(
    ("given", "mass"),
    [
        ({"drive.mass": 2000}, 2.0),  # Q has no value, which is no reason to lose it
        ({"drive.mass": 2000, "Q": 3000}, 3.0),
        ({"Q": 3000}, 3.0),
    ],
)
def test_the_outermost_connector_that_has_a_value_gives_it(package, flat, given, mass):
    start = values("".join(real(name, value) for name, value in given.items()))
    system = System.from_ssp(package(bound(with_outer_mass(flat), "top", start)))
    assert system.start["drive.plant"] == {"m": mass}


def test_a_binding_of_an_outer_system_comes_before_one_of_an_inner(package, flat):
    structure = bound(nested(flat), "top", values(real("drive.plant.m", 7.0)))
    inner = values(real("mass", 5000))
    structure = structure.replace(
        '<System name="drive">', f'<System name="drive"><ParameterBindings>{inner}</ParameterBindings>'
    )
    assert System.from_ssp(package(structure)).start["drive.plant"] == {"m": 7.0}


def test_two_ways_to_one_name_are_refused(package, flat):
    structure = nested(flat).replace('<Component name="reference"', '<Component name="drive.plant"')
    with pytest.raises(SspError, match=r"two elements have the name 'drive\.plant'"):
        System.from_ssp(package(structure))


def in_degrees(name):
    """The FMU with its angles declared in degrees: same numbers, another unit."""
    source = find_fmu(name, Path())
    with zipfile.ZipFile(source) as archive:
        files = {i.filename: archive.read(i) for i in archive.infolist()}
    text = files["modelDescription.xml"].decode()
    unit = '<Unit name="deg"><BaseUnit rad="1" factor="0.017453292519943295" /></Unit></UnitDefinitions>'
    text = text.replace('unit="rad"', 'unit="deg"').replace("</UnitDefinitions>", unit)
    return files | {"modelDescription.xml": text.encode()}


def zipped(files):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return buffer.getvalue()


@pytest.mark.full
def test_units_are_converted_on_a_connection(package, flat):
    fmu = {"resources/models/PendulumReference.fmu": zipped(in_degrees("PendulumReference"))}
    start = values(real("reference.phi_initial", 30.0) + real("plant.phi", 0.4))
    degrees = System.from_ssp(package(bound(flat, "top", start), fmu, "degrees.ssp")).simulate()
    start = values(real("reference.phi_initial", math.radians(30.0)) + real("plant.phi", 0.4))
    radians = System.from_ssp(package(bound(flat, "top", start), name="radians.ssp")).simulate()
    assert degrees["reference.phi_ref"][0] == 30.0
    assert degrees["plant.phi"] == pytest.approx(radians["plant.phi"], rel=1e-13)
    start = values(real("reference.phi_initial", math.radians(30.0)) + real("plant.phi", 0.4))
    connection = '"reference" startConnector="phi_ref"'
    raw = bound(flat, "top", start).replace(connection, f'{connection} suppressUnitConversion="true"')
    unconverted = System.from_ssp(package(raw, fmu, "raw.ssp")).simulate()
    assert unconverted["plant.phi"].tolist() == radians["plant.phi"].tolist()


@pytest.mark.full
def test_a_connection_is_transformed(package, flat):
    halved = flat.replace(
        'startConnector="phi_ref" endElement="controller" endConnector="phi_ref"/>',
        'startConnector="phi_ref" endElement="controller" endConnector="phi_ref">'
        '<c:LinearTransformation factor="0.5" offset="0.1"/></Connection>',
    )
    half = System.from_ssp(package(bound(halved, "top", values(real("reference.phi_initial", 0.6))))).simulate()
    whole = bound(flat, "top", values(real("reference.phi_initial", 0.4)))
    assert half["plant.phi"].tolist() == System.from_ssp(package(whole, name="b.ssp")).simulate()["plant.phi"].tolist()


def test_a_scenario_takes_converted_units_and_no_other_transformation(package, flat):
    fmu = {"resources/models/PendulumReference.fmu": zipped(in_degrees("PendulumReference"))}
    tree = with_system({}, System.from_ssp(package(flat, fmu, "degrees.ssp")))
    assert tree["connections"]["controller.phi_ref"] == "reference.phi_ref"
    place = '"reference" startConnector="phi_ref"'
    raw = System.from_ssp(package(flat.replace(place, f'{place} suppressUnitConversion="true"'), fmu, "raw.ssp"))
    with pytest.raises(SspError, match=r"'controller\.phi_ref' takes a transformed value; a scenario converts units"):
        with_system({}, raw)


def test_the_step_is_that_of_libcosims_annotation(package, flat):
    annotated = flat.replace(
        'stopTime="0.2"/>',
        'stopTime="0.2"><Annotations><c:Annotation type="com.opensimulationplatform"><o:Algorithm xmlns:o="http://o">'
        '<o:FixedStepAlgorithm baseStepSize="0.02"/></o:Algorithm></c:Annotation></Annotations></DefaultExperiment>',
    )
    assert System.from_ssp(package(annotated)).simulate().time.tolist() == pytest.approx(np.arange(11) * 0.02)


# What is refused.

ANGLE = '<Connection startElement="plant" startConnector="phi" endElement="controller" endConnector="phi"/>'


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("</SystemStructureDescription>", "", "SystemStructure.ssd is not readable XML: no element found"),
        ("<SystemStructureDescription", '<!DOCTYPE a [<!ENTITY e "e">]><SystemStructureDescription', "DOCTYPE"),
        ('version="1.0"', 'version="3.0"', "of SSP version '3.0', not 1.0 or 2.0"),
        ("models/Pendulum.fmu", "models/Pendulu.fmu", "'plant': no file 'resources/models/Pendulu.fmu' in the package"),
        ("resources/models/Pendulum.fmu", "../Pendulum.fmu", "'plant': '../Pendulum.fmu' is not a path within"),
        ("resources/models/Pendulum.fmu", "/etc/passwd", "'plant': '/etc/passwd' is not a path within the package"),
        ("resources/models/Pendulum.fmu", "file:///a.fmu", "'plant': 'file:///a.fmu' is not a path within"),
        ('source="resources/models/Pendulum.fmu"', "", "a Component has no source"),
        ('<Component name="plant"', '<Component name="plant" type="application/x-ssp-package"',
         "'plant' is of type application/x-ssp-package; only FMUs are supported"),
        ('<Component name="reference"', '<Component name="plant"', "two elements have the name 'plant'"),
        ("<Elements>", '<Elements><SignalDictionaryReference name="bus" dictionary="d"/>',
         "'bus' is a SignalDictionaryReference, which is not supported"),
        ('startElement="reference"', 'startElement="referenze"', "no element 'referenze'; did you mean 'reference'"),
        ('endConnector="phi_ref"', 'endConnector="phi_reff"',
         "no connector 'phi_reff' of 'controller'; did you mean 'phi_ref'"),
        ('<Connector name="phi_ref" kind="input"/>', '<Connector name="phi_reff" kind="input"/>',
         r"connector 'controller.phi_reff': no variable 'phi_reff' in PendulumController.fmu; did you mean 'phi_ref'"),
        ('kind="output"><c:Real/>', 'kind="output"><c:Boolean/>', "'plant.phi' is declared Boolean, but in .* Real"),
        ('kind="output"><c:Real/>', 'kind="output"><c:Real/><Dimension size="3"/>', "'phi' is no array of"),
        ('endConnector="u"', 'endConnector="u" startIndices="1"', "one of single elements, which is not supported"),
        ('name="u" kind="input"><c:Real unit="N"/>', 'name="u" kind="input"><c:Real unit="degC"/>',
         "connector 'plant.u': 'degC' cannot be converted to 'N': the dimensions differ"),
        ('name="u" kind="input"><c:Real unit="N"/>', 'name="u" kind="input"><c:Real unit="Newton"/>',
         "'Newton' cannot be converted to 'N': 'Newton' is not defined"),
        ('startElement="plant" startConnector="phi" endElement="controller" endConnector="phi"',
         'startElement="plant" startConnector="phi" endElement="controller" endConnector="u"',
         "connection plant.phi -> controller.u must join an output to an input"),
        (ANGLE, ANGLE + ANGLE, "two connections lead to 'controller.phi'"),
        (ANGLE, ANGLE.replace("/>", "><c:BooleanMappingTransformation/></Connection>"),
         "a BooleanMappingTransformation is not supported"),
        (ANGLE, ANGLE.replace("/>", '><c:LinearTransformation factor="a"/></Connection>'), "factor .* be a number"),
        ('stopTime="0.2"', 'stopTime="soon"', "stopTime of a DefaultExperiment must be a number, got 'soon'"),
        ('kg="1" factor="0.001"', 'kg="one"', "unit 'g': invalid literal"),
    ],
)  # fmt: skip
def test_bad_structures_are_refused_in_one_line(package, flat, old, new, message):
    assert old in flat
    with pytest.raises(SspError, match=message) as refused:
        System.from_ssp(package(flat.replace(old, new, 1)))
    assert "\n" not in str(refused.value)
    assert "made.ssp" in str(refused.value)


@pytest.mark.parametrize(
    ("binding", "message"),
    [
        ('<ParameterBinding source="resources/a.ssv"/>', "binding of 'plant': no file 'resources/a.ssv' in"),
        ('<ParameterBinding source="../a.ssv"/>', "'../a.ssv' is not a path within the package"),
        ('<ParameterBinding source="a.ssv" sourceBase="component"/>', "sources within a component are not supported"),
        ('<ParameterBinding type="text/csv" source="a.csv"/>', "is of type text/csv"),
        ("<ParameterBinding/>", "a ParameterBinding has no source"),
        (values(real("m", 20, "degC")), "parameter 'plant.m': 'degC' cannot be converted to 'kg': the dimensions"),
        (values(real("m", "heavy")), "parameter 'm' is no Real: 'heavy'"),
        ('<ParameterBinding><ParameterValues><ParameterSet version="9" name="a"/></ParameterValues></ParameterBinding>',
         "has no source|of SSP version"),
    ],
)  # fmt: skip
def test_bad_bindings_are_refused_in_one_line(package, flat, binding, message):
    with pytest.raises(SspError, match=message) as refused:
        System.from_ssp(package(bound(flat, "plant", binding)))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", ["../out.txt", "/tmp/out.txt", "resources/../../out.txt", "..\\out.txt"])
def test_no_file_is_put_outside_the_package(package, name, cache):
    with pytest.raises(ModelDescriptionError, match="would be put outside its folder"):
        System.from_ssp(package(files={name: "x"}))
    assert not list(cache.glob("ssp/.unpacking*"))


def test_what_is_no_package_is_told(tmp_path):
    path = tmp_path / "a.ssp"
    with pytest.raises(SspError, match=r"a\.ssp cannot be unpacked: No such file"):
        System.from_ssp(path)
    path.write_bytes(b"no zip")
    with pytest.raises(ModelDescriptionError, match=r"a\.ssp cannot be unpacked: File is not a zip file"):
        System.from_ssp(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "x")
    with pytest.raises(SspError, match=r"a\.ssp has no SystemStructure\.ssd"):
        System.from_ssp(path)


def test_a_start_value_that_the_fmu_refuses_is_told(package, flat):
    system = System.from_ssp(package(bound(flat, "plant", values(real("u_held", 1.0)))))
    with pytest.raises(WiringError, match=r"'u_held' of Pendulum\.fmu takes no start value"):
        system.simulate()


def test_how_long_must_be_said(package, flat):
    system = System.from_ssp(package(flat.replace('stopTime="0.2"', "")))
    with pytest.raises(SspError, match=r"hand made does not say its stop_time; give --set scenario.stop_time"):
        system.simulate()
    assert len(system.simulate(stop_time=0.05).time) == 6
    with pytest.raises(SspError, match="must be a whole multiple of macro_step"):
        system.simulate(stop_time=0.05, step_size=0.02)
