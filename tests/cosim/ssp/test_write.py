"""What is exported: valid by the schemas that FMPy ships, whole, and the same run when it comes back."""

import json
import zipfile

import numpy as np
import pytest
import tomli_w
from fmpy.ssp.ssd import read_ssd, read_ssv
from lxml import etree

from cosim import Scenario, ScenarioError, SspError, System, WiringError, load_scenario, run
from cosim.ssp.write import to_ssp
from cosim.system.fmu_cache import find_fmu

pytestmark = [pytest.mark.fmu, pytest.mark.usefixtures("leaves_nothing")]


@pytest.fixture
def export(tmp_path):
    def export(scenario, name="out.ssp"):
        path = tmp_path / name
        path.write_bytes(to_ssp(scenario))
        return path

    return export


@pytest.mark.full_but("pendulum")
@pytest.mark.parametrize("name", ["pendulum", "quadrotor", "stiction", "rigid-body"])
def test_the_files_are_valid(export, name):
    path = export(Scenario.load(name))
    ssd = read_ssd(str(path))  # validates against SystemStructureDescription.xsd
    bindings = {c.name: c.parameterBindings for c in ssd.system.elements}
    assert [b.source for of_component in bindings.values() for b in of_component]
    for of_component in bindings.values():
        for binding in of_component:
            read_ssv(str(path), binding.source)  # validates too


def test_every_component_has_parameters_of_its_own(export, tmp_path):
    """Names that are the same in ASCII: each keeps its start values."""
    tables = Scenario.load("pendulum").model_dump(mode="json", by_alias=True)
    text = json.dumps(tables).replace("plant", "\u03b2").replace("controller", "\u03b3")
    scenario = Scenario.from_tables(json.loads(text), {}, tmp_path, tmp_path / "s")
    start = System.from_ssp(export(scenario)).start
    assert {"phi", "phi_dot", "m", "l"} <= set(start["\u03b2"])
    assert set(start["\u03b3"]) == {"m", "l"}


FMI_3 = {f"components.{name}.fmi": "3" for name in ("plant", "controller", "reference")}


@pytest.mark.full
@pytest.mark.parametrize("of_fmi_3", [FMI_3, {"components.plant.fmi": "3"}], ids=["all", "plant"])
def test_fmus_of_fmi_3_without_arrays_are_exported(export, pendulum, of_fmi_3):
    """The same system in FMI 2.0 is the truth: both FMUs compute the same bits."""
    start = {"components.plant.start.phi": "0.4"}
    newer = export(pendulum(start | of_fmi_3, stop_time=0.2), "newer.ssp")
    older = export(pendulum(start, stop_time=0.2), "older.ssp")
    for component in read_ssd(str(newer)).system.elements:  # validates
        for binding in component.parameterBindings:
            read_ssv(str(newer), binding.source)
    one, other = (System.from_ssp(path).simulate() for path in (newer, older))
    assert list(one.series) == list(other.series)
    for name, values in other.series.items():
        assert one[name].tobytes() == values.tobytes(), name
    assert other["plant.phi"][-1] != other["plant.phi"][0]


@pytest.fixture
def quadrotor_3():
    """The quadrotor in FMI 3.0, with arrays."""
    return Scenario.load("quadrotor", FMI_3 | {"scenario.stop_time": "0.5"})


def test_arrays_are_exported_as_ssp_2_has_them(export, quadrotor_3):
    """Whole, with their sizes: 18 connected elements of r, v, R and Omega are four connections."""
    path = export(quadrotor_3)
    with zipfile.ZipFile(path) as archive:
        structure = etree.fromstring(archive.read("SystemStructure.ssd"))
        start = etree.fromstring(archive.read("resources/plant.ssv"))
    assert (structure.get("version"), start.get("version")) == ("2.0", "2.0")
    sizes = {
        c.get("name"): [d.get("size") for d in c.findall("{*}Dimension")]
        for c in structure.iterfind(".//{*}Component[@name='controller']//{*}Connector")
    }
    assert (sizes["R"], sizes["r"], sizes["psi_d"]) == (["3", "3"], ["3"], [])
    joined = [(c.get("startConnector"), c.get("endConnector")) for c in structure.iterfind(".//{*}Connection")]
    assert {("R", "R"), ("r", "r"), ("M", "M"), ("F", "F")} <= set(joined)
    assert not [pair for pair in joined if "[" in "".join(pair)]
    inertia = start.find(".//{*}Parameter[@name='J']")
    assert (inertia[0].get("value"), inertia[1].get("size")) == ("3.45 3.45 6.75", "3")


@pytest.mark.full
def test_an_export_with_arrays_re_tunes_with_the_same_result(export, quadrotor_3):
    direct = run(quadrotor_3, seed=0)
    again = run(load_scenario(export(quadrotor_3)), seed=0)
    assert list(again.series) == list(direct.series)
    for name, values in direct.series.items():
        assert again[name].tobytes() == values.tobytes(), name


def test_an_element_of_an_array_that_is_connected_by_itself_is_refused():
    text = r"'plant\.r\[1\]' is an element of an array, and connected by itself: SSP packages join whole ones"
    with pytest.raises(SspError, match=text):
        to_ssp(Scenario.load("quadrotor", {"components.plant.fmi": "3"}))


def test_arrays_that_nothing_takes_are_left_out(export, pendulum, tmp_path):
    with zipfile.ZipFile(find_fmu("PendulumReference", tmp_path, 3)) as whole:
        files = {name: whole.read(name) for name in whole.namelist()}
    array = b'<Float64 name="spare" valueReference="90" causality="output"><Dimension start="2" /></Float64>'
    xml = files["modelDescription.xml"].replace(b"</ModelVariables>", array + b"</ModelVariables>")
    structure = b'<ModelStructure><Output valueReference="90" />'
    files["modelDescription.xml"] = xml.replace(b"<ModelStructure>", structure)
    with zipfile.ZipFile(tmp_path / "Spare.fmu", "w") as fmu:
        for name, content in files.items():
            fmu.writestr(name, content)
    path = export(pendulum({"components.reference.fmu": str(tmp_path / "Spare.fmu")}))
    connectors = [c.name for element in read_ssd(str(path)).system.elements for c in element.connectors]
    assert "phi_ref" in connectors
    assert not [name for name in connectors if "spare" in name]


def test_the_package_is_as_the_standard_wants_it(export):
    with zipfile.ZipFile(export(Scenario.load("pendulum"))) as archive:
        assert archive.testzip() is None
        for entry in archive.infolist():
            assert entry.compress_type == zipfile.ZIP_DEFLATED
            assert entry.filename.isascii()
            assert entry.extract_version <= 20
            assert entry.filename == "SystemStructure.ssd" or entry.filename.split("/")[0] in ("resources", "extra")
        root = etree.fromstring(archive.read("SystemStructure.ssd"))
        text = archive.read("SystemStructure.ssd").decode()
    assert text.startswith("<?xml")
    assert "<ssd:SystemStructureDescription xmlns:ssd=" in text  # prefixes that libcosim and ecos look for
    assert root.get("version") == "1.0"
    names = {"ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
             "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon"}  # fmt: skip
    units = {u.get("name"): dict(u[0].attrib) for u in root.findall("ssd:Units/ssc:Unit", names)}
    assert units == {
        "N": {"kg": "1", "m": "1", "s": "-2"}, "rad": {"rad": "1"}, "rad/s": {"s": "-1", "rad": "1"},
        "rad/s2": {"s": "-2", "rad": "1"},
    }  # fmt: skip
    connectors = root.findall(".//ssd:Connector", names)
    assert {c[0].tag for c in connectors} == {"{http://ssp-standard.org/SSP1/SystemStructureCommon}Real"}
    assert {c[0].get("unit") for c in connectors} <= set(units)
    experiment = root.find("ssd:DefaultExperiment", names)
    assert (experiment.get("startTime"), experiment.get("stopTime")) == ("0.0", "10.0")


def test_the_same_scenario_gives_the_same_bytes():
    assert to_ssp(Scenario.load("quadrotor")) == to_ssp(Scenario.load("quadrotor"))


def test_parameters_are_start_values_changes_and_what_is_estimated(export):
    settings = {"components.reference.start.smooth_yaw": "true", 'changes."plant.m"': "2.0 + t"}
    system = System.from_ssp(export(Scenario.load("quadrotor", settings)))
    assert system.start["reference"] == {"smooth_yaw": True}
    assert system.start["controller"] == {"m": 1.25, "J_x": 1.1, "J_y": 1.1, "J_z": 2.2}
    assert system.start["plant"] == {
        "r_x": 0.0, "r_y": 0.0, "r_z": 0.0, "v_x": 3.2, "v_y": 2.0, "v_z": 0.8, "m": 2.0,
        "J_x": pytest.approx(3 * (1.1 + 1.25 * 0.04)), "J_y": pytest.approx(3 * (1.1 + 1.25 * 0.04)),
        "J_z": pytest.approx(3 * (2.2 + 1.25 * 0.04)),
    }  # fmt: skip


@pytest.mark.full
def test_an_export_re_tunes_again_with_the_same_result(export, pendulum):
    scenario = pendulum({'changes."plant.m"': "[[0.0, 2.0], [0.2, 4.271]]", "estimation.instants": "[0.3]"})
    package = load_scenario(export(scenario))
    one, other = run(scenario, seed=3), run(package, seed=3)
    assert one.n_episodes > 0
    assert list(one.series) == list(other.series)
    for name, series in one.series.items():
        assert series.tobytes() == other[name].tobytes(), name
    assert [p.name for p in package.estimation.parameters] == ["m", "l"]
    assert package.estimation.methods == scenario.estimation.methods


def test_a_component_s_tolerance_comes_back(export, pendulum):
    package = load_scenario(export(pendulum({"components.plant.tolerance": "1e-6"})))
    assert {name: c.tolerance for name, c in package.components.items()} == {
        "plant": 1e-6, "controller": None, "reference": None,
    }  # fmt: skip


def test_what_another_tool_edits_in_the_package_counts(export, pendulum, tmp_path):
    path = export(pendulum())
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    files["resources/plant.ssv"] = files["resources/plant.ssv"].replace(b"1.0471975511965976", b"0.5")
    edited = tmp_path / "edited.ssp"
    with zipfile.ZipFile(edited, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    assert load_scenario(edited).components["plant"].start == {"phi": 0.5, "phi_dot": 0.0}
    assert load_scenario(edited, {"components.plant.start.phi": "0.7"}).components["plant"].start["phi"] == 0.7


@pytest.mark.full
def test_a_package_steps_as_our_parallel_coupling_does(export, pendulum):
    """Where inputs start as the plant's states do; a scenario leaves them to their start values."""
    known = {"phi": 0.9, "phi_dot": 0.0, "phi_ref": 0.3, "phi_dot_ref": 0.0}
    settings = {f"components.controller.start.{k}": repr(v) for k, v in known.items()}
    settings |= {"components.plant.start.phi": "0.9", "components.reference.start.phi_initial": "0.3"}
    scenario = pendulum({"scenario.coupling": "parallel", "changes": "{}", **settings}, stop_time=2.0)
    ours = run(scenario, "none")
    package = System.from_ssp(export(scenario)).simulate()
    assert np.ptp(ours["plant.phi"]) > 0.4
    for name in ("plant.phi", "plant.phi_dot", "controller.u"):
        assert package[name] == pytest.approx(ours[name], abs=1e-12), name


def test_a_model_of_the_users_goes_along(export, pendulum, tmp_path):
    (tmp_path / "a_pendulum_of_mine.py").write_text(
        "from math import sin\ndef derivative(x, u, m, l):\n"
        "    return x[1], -9.81 / l * sin(x[0]) - 0.1 / m * x[1] + u[0] / (m * l)\n"
    )
    settings = {"estimation.model": "a_pendulum_of_mine:derivative", 'changes."plant.m"': "[[0.0, 1.75], [0.1, 4.0]]"}
    path = export(pendulum(settings).model_copy(update={"folder": tmp_path}))
    (tmp_path / "a_pendulum_of_mine.py").unlink()
    assert run(load_scenario(path, trust=True), seed=0).n_evaluations > 0


def test_two_fmus_of_one_name_are_kept_apart(export, pendulum, tmp_path):
    copy = tmp_path / "Pendulum.fmu"
    copy.write_bytes(find_fmu("PendulumReference", tmp_path).read_bytes())
    system = System.from_ssp(export(pendulum({"components.reference.fmu": str(copy)})))
    assert [c.fmu.name for c in system.components.values()] == [
        "Pendulum.fmu", "PendulumController.fmu", "Pendulum_reference.fmu"
    ]  # fmt: skip


def test_connected_units_must_agree(pendulum):
    wired = {'connections."controller.phi_dot"': '"plant.phi"'}
    with pytest.raises(SspError, match=r"connection plant.phi -> controller.phi_dot: 'rad' .* the dimensions differ"):
        to_ssp(pendulum(wired))
    with pytest.raises(WiringError, match="no variable 'phu' in plant; did you mean 'phi'"):
        to_ssp(pendulum({'connections."controller.phi"': '"plant.phu"'}))


def test_the_scenario_on_a_system_from_elsewhere(package, tmp_path):
    """Components, connections and start values come from the package, all else from the file."""
    text = json.loads(
        Scenario.load("pendulum").model_dump_json(exclude={"components", "connections"}, exclude_none=True)
    )
    file = tmp_path / "tuning.toml"
    clean = {k: v for k, v in text.items() if k != "folder"}
    clean["estimation"].pop("linear")
    clean["estimation"]["parameters"] = [
        {k: v for k, v in p.items() if v is not None} for p in clean["estimation"]["parameters"]
    ]
    file.write_text(tomli_w.dumps(clean))
    overrides = {"scenario.stop_time": "0.2", 'changes."plant.m"': "[[0.0, 1.75], [0.1, 4.0]]"}
    result = run(load_scenario(file, overrides, package()))
    assert result.status == "done"
    assert result.estimates["m"][-1] == pytest.approx(4.0, abs=0.2)


def test_a_package_from_elsewhere_holds_no_scenario(package):
    with pytest.raises(
        ScenarioError, match=r"made\.ssp holds no scenario: it can be simulated, but nothing in it is re-t"
    ):
        load_scenario(package())
