"""Units at the two ends of connections, tracked pairs and parameters: the same run in degrees and millimetres."""

from pathlib import Path

import numpy as np
import pytest

from cosim.errors import WiringError
from cosim.fmi.archive import FmuFile
from cosim.fmi.component import read_component
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario
from cosim.system.unit_conversions import unit_conversions

pytestmark = pytest.mark.fmu

SCENARIO = """
[scenario]
name = "swing"
stop_time = 0.3
macro_step = 0.01
[components]
plant = { fmu = "Pendulum", start = { phi = 0.5 } }
controller = { fmu = "PendulumController" }
reference = { table = "reference.csv" }
in_radians = { table = "radians.csv" }
[connections]
"controller.phi" = "plant.phi"
"controller.phi_dot" = "plant.phi_dot"
"controller.phi_ref" = "reference.phi_ref"
"plant.u" = "controller.u"
[tracking]
"plant.phi" = "in_radians.phi_ref"
[sampling.derivatives]
"plant.der(phi_dot)" = { noise = 1e-3 }
[estimation]
model = "fmu_models.pendulum:derivative"
trigger = { kind = "innovation" }
[[estimation.parameters]]
name = "m"
lower = 0.1
upper = 5.0
unit = "kg"
writes = "controller.m"
"""
DEGREES = "time [s], phi_ref [deg]\n0, 0\n0.3, 57.29577951308232\n"
RADIANS = "time [s], phi_ref [rad]\n0, 0\n0.3, 1\n"


@pytest.fixture
def written(tmp_path):
    """Writes the scenario with a reference table, with pairs of text replaced; as it is loaded."""

    def write(table: str, *replacements: tuple[str, str]) -> Scenario:
        text = SCENARIO
        for old, new in replacements:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        (tmp_path / "swing.toml").write_text(text)
        (tmp_path / "reference.csv").write_text(table)
        (tmp_path / "radians.csv").write_text(RADIANS)
        return Scenario.load(tmp_path / "swing.toml")

    return write


@pytest.mark.full
def test_a_reference_in_degrees_arrives_in_the_controllers_radians(written):
    in_degrees, in_radians = (run(written(table), "none") for table in (DEGREES, RADIANS))
    assert in_degrees["reference.phi_ref"][-1] == pytest.approx(57.29577951308232)  # recorded as it was given
    assert in_degrees["plant.phi"] == pytest.approx(in_radians["plant.phi"], rel=1e-12)
    assert np.ptp(in_radians["plant.phi"]) > 0.04


@pytest.mark.parametrize(
    ("table", "replacements", "message"),
    [
        pytest.param(DEGREES.replace("deg", "kg"), (), r'connections."controller.phi_ref": .*dimensions differ',
                     id="another dimension"),
        pytest.param(DEGREES, (('"in_radians.phi_ref"', '"reference.phi_ref"'),),
                     r"tracking.\"plant.phi\": 'reference.phi_ref' is in deg, 'plant.phi' in rad "
                     r"\(x deg = 0.0174532925 x rad\), and both", id="tracked in degrees"),
        pytest.param(RADIANS, (('writes = "controller.m"', 'writes = "controller.m"\ntrue = "plant.l"'),),
                     r"estimation.parameters 'm': 'plant.l' to 'controller.m': 'm' cannot", id="a length for a mass"),
    ],
)  # fmt: skip
def test_what_cannot_be_right_is_refused_in_one_line(written, table, replacements, message):
    with pytest.raises(WiringError, match=message) as refused:
        run(written(table, *replacements), "none")
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1e-3), ("m", None), ("tick", None)])
def test_fmus_own_definitions_say_the_factor(described, tmp_path, unit, factor):
    sensor = (
        f'<ScalarVariable name="y" valueReference="0" causality="output"><Real unit="{unit}"/></ScalarVariable>'
        '<ScalarVariable name="z" valueReference="1" causality="output"><Real unit="m"/></ScalarVariable>'
        '<ScalarVariable name="r" valueReference="2" causality="output"><Real unit="m"/></ScalarVariable>'
    )
    user = '<ScalarVariable name="s" valueReference="0" causality="input"><Real unit="m" start="0"/></ScalarVariable>'
    paths = {"plant": described(sensor, name="Sensor"), "controller": described(user, name="User")}
    scenario = written_for(tmp_path)
    descriptions = {name: FmuFile(name, read_component(path).description).description for name, path in paths.items()}
    found = unit_conversions(scenario, descriptions)["controller"]
    assert {name: (c.factor, c.offset) for name, c in found.items()} == ({"s": (factor, 0.0)} if factor else {})


def written_for(folder: Path) -> Scenario:
    path = folder / "two.toml"
    path.write_text("""
        scenario = { name = "two", stop_time = 1.0, macro_step = 0.1 }
        components = { plant = { fmu = "Sensor.fmu" }, controller = { fmu = "User.fmu" } }
        connections = { "controller.s" = "plant.y" }
        tracking = { "plant.z" = "plant.r" }
        sampling = { outputs = { "plant.z" = { noise = 1.0 } } }
        estimation.model = "a:b"
        estimation.trigger = { kind = "innovation" }
        estimation.parameters = [{ name = "m", lower = 0.1, upper = 1.0, writes = "controller.m" }]
    """)
    return Scenario.load(path)
