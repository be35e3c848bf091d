"""`retune info`: what an FMU declares, ours or not."""

import json

import fmpy
import pytest

from cosim.authoring.info import info
from cosim.cli import main
from cosim.errors import ModelDescriptionError
from cosim.system.fmu_cache import find_fmu

pytestmark = pytest.mark.fmu


def test_a_foreign_fmu_is_told_as_its_model_description_says(foreign):
    found = info(foreign / "Axis.fmu")
    variables = {v.name: v for v in found.variables}
    assert (found.fmi_version, found.model, found.tool) == ("2.0", "Lab.Axis", "Somebody's tool")
    assert found.kinds == {"co-simulation": ["variable communication step"]}
    assert found.experiment == {"start_time": 0.0, "stop_time": 5.0, "step_size": 0.01}
    mass = variables["mass.m"]
    assert (mass.role, mass.start, mass.min, mass.max, mass.unit) == (
        "tunable parameter",
        2.0,
        0.5,
        20.0,
        "kg",
    )  # typed
    assert variables["damper.d"].role == "fixed parameter"
    assert (variables["mass.v"].derivative, variables["der(mass.v)"].derivative_of) == ("der(mass.v)", "mass.v")
    assert variables["der(mass.v)"].depends_on == ("f", "mass.v", "mass.s")
    assert variables["f"].depends_on is None


def test_the_tables_have_a_row_for_each_variable(foreign, capsys):
    assert main(["info", str(foreign / "Axis.fmu")]) == 0
    text = capsys.readouterr().out
    rows = [line.split() for line in text.splitlines()]
    assert ["mass.m", "2", "0.5", "20", "kg", "Mass"] in rows
    assert ["damper.d", "1", "-", "-", "N.s/m"] in rows
    assert ["der(mass.v)", "-", "m/s2", "mass.v"] in rows
    assert ["mass.s", "0", "m", "der(mass.s)", "Position"] in rows
    assert (
        text.index("tunable parameters") < text.index("fixed parameters") < text.index("inputs") < text.index("states")
    )
    assert max(len(line) for line in text.splitlines() if str(foreign) not in line) <= 120


def test_json_is_one_object_with_numbers(tmp_path, capsys):
    assert main(["info", str(find_fmu("PendulumController", tmp_path)), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    gain = next(v for v in found["variables"] if v["name"] == "Kp")
    assert (gain["role"], gain["start"], gain["min"], gain["max"], gain["unit"]) == (
        "tunable parameter", 10.0, 0.0, None, "1/s2",
    )  # fmt: skip


def test_an_fmu_of_another_platform_is_told_too(described):
    other, suffix = ("win64", ".dll") if fmpy.platform != "win64" else ("linux64", ".so")
    kind = 'variability="discrete" initial="exact"'
    text = f'<ScalarVariable name="name" valueReference="0" {kind}><String start="a b"/></ScalarVariable>'
    path = described(text, library=f"{other}/Model{suffix}")
    found = info(path)
    assert found.platforms == [other]
    assert [(v.name, v.type, v.start) for v in found.variables] == [("name", "String", "a b")]
    assert "experiment          not declared" in str(found)
    assert "no optional capability" in str(found)


def test_a_model_exchange_fmu_of_fmi_3_with_an_array_is_told(tmp_path):
    import zipfile

    path = tmp_path / "Native.fmu"
    xml = """<fmiModelDescription fmiVersion="3.0" modelName="Native" instantiationToken="1">
    <ModelExchange modelIdentifier="Native" providesDirectionalDerivatives="true"/><ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Float64 name="J" valueReference="1" causality="parameter" variability="tunable" start="1 2 3" min="0">
    <Dimension start="3"/></Float64></ModelVariables><ModelStructure/></fmiModelDescription>"""
    with zipfile.ZipFile(path, "w") as fmu:
        fmu.writestr("modelDescription.xml", xml)
        fmu.writestr("binaries/x86_64-linux/Native.so", b"")
    found = info(path)
    assert found.kinds == {"model exchange": ["directional derivatives"]}
    inertia = found.variables[1]
    assert (inertia.role, inertia.type, inertia.start, inertia.min) == ("tunable parameter", "Float64[3]", "1 2 3", 0.0)
    assert "J (Float64[3])" in str(found)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 no archive"], ids=["empty", "broken"])
def test_what_is_no_fmu_is_refused_in_one_line(tmp_path, capsys, content):
    (tmp_path / "A.fmu").write_bytes(content)
    assert main(["info", str(tmp_path / "A.fmu")]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("retune: ")
    assert err.count("\n") == 1
    with pytest.raises(ModelDescriptionError, match="cannot be read"):
        info(tmp_path / "none.fmu")
