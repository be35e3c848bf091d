"""FMUs as other tools make them: what is used with a warning, and what `check` says before a load fails."""

import subprocess
import zipfile
from pathlib import Path

import pytest

from benchmarks.native_fmus import FOREIGN, build_c
from cosim import ModelDescriptionError, SlaveError, open_slave
from cosim.authoring.check_fmu import check_fmu
from cosim.ssp.system import System

CLOCK = '<Clock name="tick" valueReference="21" causality="{}" intervalVariability="triggered"/>'
ENUMERATION = (
    '<ScalarVariable name="mode" valueReference="20" causality="local" variability="continuous">'
    '<Enumeration declaredType="Mode"/></ScalarVariable>'
)
MODES = '<SimpleType name="Mode"><Enumeration><Item name="idle" value="1"/></Enumeration></SimpleType>'


@pytest.fixture
def changed(foreign, tmp_path):
    """changed(name, (old, new), ...): a copy of one of the FMUs with these texts replaced in its description."""

    def write(name, *replacements, library="Axis", twice=()):
        with zipfile.ZipFile(foreign / f"{name}.fmu") as whole:
            files = {place: whole.read(place) for place in whole.namelist()}
        xml = files.pop("modelDescription.xml").decode()
        for old, new in replacements:
            assert old in xml
            xml = xml.replace(old, new)
        path = tmp_path / "Changed.fmu"
        with zipfile.ZipFile(path, "w") as fmu:
            fmu.writestr("modelDescription.xml", xml)
            for place, content in files.items():
                fmu.writestr(place.replace("Axis.", f"{library}."), content)
            for content in twice:
                fmu.writestr("resources/table", content)
        return path

    return write


def told(fmu):
    return [str(finding) for finding in check_fmu(fmu)]


def runs(fmu):
    with open_slave(fmu, "axis") as slave:
        slave.bind(outputs=["mass.s"])
        slave.initialize({"mass.s": 1.0})
        return slave.step([], 0.0, 0.01)[0] == pytest.approx(1.0 - 4.0 * 0.5e-4, abs=1e-5)  # s_dot_dot = -c s / m


def test_a_library_with_a_hyphen_in_its_name_is_used(changed):
    fmu = changed("Axis", ('modelIdentifier="Axis"', 'modelIdentifier="My-Axis"'), library="My-Axis")
    assert told(fmu) == [
        "modelDescription.xml: warning: modelIdentifier 'My-Axis' is no C identifier, of letters, digits and '_' "
        "(FMI 2.0.4, section 4.3.1)"
    ]
    assert runs(fmu)


def test_an_enumeration_that_is_declared_continuous_is_used(changed):
    """Simulink R2016b writes it."""
    types = ("<TypeDefinitions>", f"<TypeDefinitions>{MODES}")
    fmu = changed("Axis", ("</ModelVariables>", f"{ENUMERATION}</ModelVariables>"), types)
    (finding,) = told(fmu)
    assert finding.startswith('modelDescription.xml: warning: The variable "mode"')
    assert finding.endswith('of type Enumeration and must have variability != "continuous" (FMI 2.0.4, section 2.2.7)')
    assert runs(fmu)


def test_a_continuous_enumeration_hides_no_other_fault(changed):
    types = ("<TypeDefinitions>", f"<TypeDefinitions>{MODES}")
    twin = ENUMERATION.replace('causality="local"', 'causality="input"')  # without a start value
    with pytest.raises(Exception, match="is not a usable FMU"):
        told(changed("Axis", ("</ModelVariables>", f"{twin}</ModelVariables>"), types))


@pytest.mark.full
def test_an_output_of_bytes_that_nothing_takes_is_passed_over(changed):
    output = '<Binary name="raw" valueReference="20" causality="output"/></ModelVariables>'
    structure = '<ModelStructure><Output valueReference="20"/>'
    fmu = changed("Axis-3", ("</ModelVariables>", output), ("<ModelStructure>", structure))
    assert told(fmu) == []
    assert runs(fmu)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_file_that_is_there_twice_is_used_if_both_are_the_same(changed):
    assert told(changed("Axis", twice=[b"1", b"1"])) == [
        "'resources/table': warning: is in the archive 2 times, with the same content; once is enough"
    ]
    assert runs(changed("Axis", twice=[b"1", b"1"]))
    assert told(changed("Axis", twice=[b"1", b"2"])) == [
        "'resources/table': error: is in the archive 2 times; it is not known which is meant"
    ]


@pytest.mark.parametrize(("causality", "n"), [("input", 1), ("output", 0)])
def test_clocks_that_need_event_mode_are_an_error(changed, causality, n):
    clock = ("</ModelVariables>", f"{CLOCK.format(causality)}</ModelVariables>")
    has_event_mode = ("<CoSimulation ", '<CoSimulation hasEventMode="true" ')
    structure = ("<ModelStructure>", '<ModelStructure><Output valueReference="21"/>' if n == 0 else "<ModelStructure>")
    text = "modelDescription.xml: error: it has input clocks, 'tick' for one, and nothing here makes a clock tick"
    assert told(changed("Axis-3", clock, has_event_mode, structure)) == [text] * n


def test_a_component_with_clocks_is_refused_before_it_is_loaded(foreign, tmp_path):
    text = (FOREIGN / "Axis-3.xml").read_text().replace("<CoSimulation ", '<CoSimulation hasEventMode="true" ')
    text = text.replace("</ModelVariables>", f"{CLOCK.format('input')}</ModelVariables>")
    fmu = build_c(FOREIGN / "Axis.c", text, tmp_path / "Axis.fmu", "-DNEEDS_EVENT_MODE")
    with pytest.raises(ModelDescriptionError) as caught:
        runs(fmu)
    reason = "it has input clocks, 'tick' for one, and nothing here makes a clock tick"
    assert str(caught.value) == f"{fmu} cannot be a component: {reason}."


@pytest.mark.parametrize("version", ["3.0-beta", "3.0-beta.2"])
def test_a_beta_of_fmi_3_is_an_error(changed, version):
    fmu = changed("Axis-3", ('fmiVersion="3.0"', f'fmiVersion="{version}"'))
    reason = f"is an FMI {version} co-simulation FMU, not FMI 2.0 or 3.0 co-simulation"
    assert told(fmu) == [f"modelDescription.xml: error: {reason}"]
    with pytest.raises(Exception, match=reason):
        runs(fmu)


def test_a_beta_that_breaks_rules_of_fmi_3_is_told_to_be_one(changed):
    """The Reference-FMUs of that time have no independent variable."""
    time = '<Float64 name="time" valueReference="9" causality="independent" variability="continuous"/>'
    fmu = changed("Axis-3", ('fmiVersion="3.0"', 'fmiVersion="3.0-beta.1"'), (time, ""))
    with pytest.raises(
        ModelDescriptionError, match=r"it is of FMI 3\.0-beta\.1, not 2\.0 or 3\.0, whose rules it breaks"
    ):
        told(fmu)


@pytest.mark.full
@pytest.mark.parametrize(("option", "reason"), [
    ("EARLY", "returned early, at 0.005 s"), ("OVER", "asked to end the simulation"),
])  # fmt: skip
def test_a_step_that_is_not_taken_to_its_end_is_a_fault(foreign, tmp_path, option, reason):
    """An importer that does not allow early return must not get one; it must not take the values for those of t + h."""
    fmu = build_c(FOREIGN / "Axis.c", (FOREIGN / "Axis-3.xml").read_text(), tmp_path / "Axis.fmu", f"-D{option}")
    with pytest.raises(SlaveError, match=f"do_step at t = 0.000 s {reason}"):
        runs(fmu)


@pytest.fixture
def incomplete(foreign, tmp_path):
    """An FMU whose library needs another one that is nowhere."""
    source, gone = tmp_path / "gone.c", tmp_path / "libgone.so.1"
    source.write_text("int gone(void) { return 0; }\n")
    subprocess.run(["gcc", "-shared", "-fPIC", f"-Wl,-soname,{gone.name}", "-o", gone, source], check=True)
    text = (FOREIGN / "Axis.xml").read_text()
    fmu = build_c(FOREIGN / "Axis.c", text, tmp_path / "Axis.fmu", "-Wl,--no-as-needed", str(gone))
    gone.unlink()
    return fmu


def test_a_library_that_is_missing_is_an_error(incomplete):
    assert told(incomplete) == [
        "binaries/linux64/Axis.so: error: needs libgone.so.1 => not found (retune doctor says more)"
    ]
    with pytest.raises(SlaveError, match=r"libgone\.so\.1"):
        runs(incomplete)


@pytest.mark.full
def test_a_system_of_an_fmu_that_does_not_load_raises(incomplete, tmp_path):
    with zipfile.ZipFile(tmp_path / "one.ssp", "w") as package:
        package.write(incomplete, "resources/Axis.fmu")
        package.writestr(
            "SystemStructure.ssd",
            '<SystemStructureDescription xmlns="http://ssp-standard.org/SSP1/SystemStructureDescription" version="1.0"'
            ' name="one"><System name="top"><Elements><Component name="axis" source="resources/Axis.fmu"/></Elements>'
            "</System></SystemStructureDescription>",
        )
    system = System.from_ssp(Path(tmp_path / "one.ssp"))
    with pytest.raises(SlaveError, match=r"axis: .*libgone\.so\.1"):
        system.simulate(stop_time=0.1, step_size=0.01)
