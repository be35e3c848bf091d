"""Model-exchange FMUs as components: integrated by CVODE, with events of every kind."""

import re
import shutil
import zipfile

import fmpy
import numpy as np
import pytest
from scipy.linalg import expm

from benchmarks.native_fmus import FOREIGN, build_c
from cosim import ModelDescriptionError, Scenario, SlaveError, open_slave, resume, run
from cosim.fmi.component import read_component
from cosim.runs.run_files import EVENTS, SERIES
from cosim.ssp.write import to_ssp
from cosim.system.fmu_cache import find_fmu

pytestmark = pytest.mark.fmu
H = 0.01  # s
OUTPUTS = ("h", "v", "der(v)", "n_bounces", "n_stairs", "n_told")
STATES = 'canGetAndSetFMUstate="true" canSerializeFMUstate="true"'


@pytest.fixture(scope="session")
def balls(tmp_path_factory):
    """A folder with Ball.fmu and Ball-3.fmu, of FMI 2.0 and 3.0."""
    if shutil.which("gcc") is None:
        pytest.skip("no C compiler: gcc is not installed")
    folder = tmp_path_factory.mktemp("events")
    for name in ("Ball", "Ball-3"):
        build_c(FOREIGN / "events/Ball.c", (FOREIGN / f"events/{name}.xml").read_text(), folder / f"{name}.fmu")
    return folder


@pytest.fixture
def opened():
    """opened(path, inputs, tunables, outputs, start, options): an FMU in this process, initialised."""
    slaves = []

    def open_it(path, inputs=("a",), tunables=(), outputs=OUTPUTS, start=None, **options):
        slave = open_slave(path, "ball", **{"isolation": "none", "tolerance": 1e-10} | options)
        slaves.append(slave)
        slave.bind(inputs, tunables, outputs)
        slave.initialize(start or {}, 0.0, 3.0)
        return slave

    yield open_it
    for one in slaves:
        one.close()


def table(slave, n, first=0, inputs=lambda k: (0.0,)):
    """Outputs after each of n steps of H."""
    return np.array([slave.step(inputs(k), k * H, H) for k in range(first, first + n)])


def bounces(t, g=9.81, e=0.7):
    """Height, velocity and number of bounces of a ball dropped from 1 m, from its parabolas; at rest below 0.1 m/s."""
    begun, h, v, n = 0.0, 1.0, 0.0, 0
    while True:
        end = begun + (v + np.sqrt(v * v + 2 * g * h)) / g
        if t < end:
            return h + v * (t - begun) - g * (t - begun) ** 2 / 2, v - g * (t - begun), n
        v, h, begun, n = e * (g * (end - begun) - v), 0.0, end, n + 1
        if v < 0.1:
            return 0.0, 0.0, n


@pytest.mark.parametrize("name", ["Ball", "Ball-3"])
def test_a_ball_bounces_until_it_rests(balls, opened, name):
    """By its parabolas; the times of bounces, found to a rounding of CVODE's, come back g (1 + e) times in v."""
    found = table(opened(balls / f"{name}.fmu"), 300)
    t = np.arange(1, 301) * H
    expected = np.array([bounces(time) for time in t])
    np.testing.assert_allclose(found[:, [0, 1]], expected[:, :2], atol=1e-5)
    assert found[:, 3].tolist() == expected[:, 2].tolist()
    assert found[:, 4].tolist() == (np.arange(1, 301) // 100).tolist()  # an event at a communication point is at it
    assert found[-1].tolist() == [0.0, 0.0, 0.0, 11.0, 3.0, 10.0]  # the last bounce ends at rest


def test_fmpy_s_simulation_is_the_same(balls, opened):
    arguments = {"fmi_type": "ModelExchange", "relative_tolerance": 1e-10, "record_events": False}
    expected = fmpy.simulate_fmu(str(balls / "Ball.fmu"), stop_time=1.0, output_interval=H, output=OUTPUTS, **arguments)
    found = table(opened(balls / "Ball.fmu"), 100)
    np.testing.assert_allclose(found, np.array([list(row)[1:] for row in expected])[1:], atol=1e-4)


@pytest.mark.parametrize("name", ["Ball", "Ball-3"])
def test_it_goes_back_to_any_state(balls, opened, name):
    """In another instance too, with the input that is held and the time event to come."""
    slave, other = opened(balls / f"{name}.fmu"), opened(balls / f"{name}.fmu")
    table(slave, 44, inputs=lambda k: (2.0,))
    state = slave.get_state()
    expected = table(slave, 120, 44, inputs=lambda k: (2.0,))
    other.set_state(state)
    assert np.array_equal(table(other, 120, 44, inputs=lambda k: (2.0,)), expected)
    slave.set_state(state)
    assert np.array_equal(table(slave, 120, 44, inputs=lambda k: (2.0,)), expected)


@pytest.mark.parametrize("name", ["Ball", "Ball-3"])
def test_inputs_and_parameters_jump_at_communication_points(balls, opened, name):
    """v after 0.2 s of 1 - 9.81 m/s^2 and 0.2 s of 3 - 5 m/s^2; h is its integral."""
    slave = opened(balls / f"{name}.fmu", tunables=("g",))
    table(slave, 20, inputs=lambda k: (1.0,))
    slave.step((3.0,), 0.2, H, (5.0,))
    h, v, rate, *_ = table(slave, 19, 21, inputs=lambda k: (3.0,))[-1]
    v1 = 0.2 * (1.0 - 9.81)
    assert (rate, v) == (-2.0, pytest.approx(v1 - 0.4, abs=1e-7))
    assert h == pytest.approx(1.0 + 0.1 * v1 + 0.2 * v1 - 0.04, abs=1e-7)


def test_a_stiff_one_is_integrated(foreign, opened):
    """m s'' = f - c s - d s' with time constants of 20 ns and 12.5 s, by the matrix exponential."""
    d = 1e8
    start = {"mass.s": 1.0, "damper.d": d, "spring.c": 8e6}
    slave = opened(foreign / "Axis-ME.fmu", ("f",), outputs=("mass.s", "mass.v"), start=start)
    found = table(slave, 50, inputs=lambda k: (3.0,))[-1]
    a, steady = np.array([[0.0, 1.0], [-8e6 / 2.0, -d / 2.0]]), np.array([3.0 / 8e6, 0.0])
    expected = steady + expm(a * 0.5) @ (np.array([1.0, 0.0]) - steady)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_derivatives_of_outputs_are_read_as_outputs(balls):
    """der(h) and der(v) are local variables of the ball; of an FMU for co-simulation such are not read."""
    component = read_component(balls / "Ball.fmu")
    assert list(component.outputs) == ["h", "v", "der(h)", "der(v)", "n_bounces", "n_stairs", "n_told"]


def test_an_ssp_package_says_that_it_is_for_model_exchange(tmp_path):
    plant = find_fmu("Pendulum", tmp_path, 3, "ModelExchange")
    scenario = Scenario.load("pendulum", {"components.plant.fmu": str(plant), "scenario.stop_time": "0.1"})
    (tmp_path / "loop.ssp").write_bytes(to_ssp(scenario))
    with zipfile.ZipFile(tmp_path / "loop.ssp") as package:
        structure = package.read("SystemStructure.ssd").decode()
    kinds = re.findall('name="([a-z]+)" source="[^"]*" type="[^"]*" implementation="([A-Za-z]+)"', structure)
    assert dict(kinds) == {"plant": "ModelExchange", "controller": "CoSimulation", "reference": "CoSimulation"}


# -- what fails -------------------------------------------------------------------------------------------------------


@pytest.fixture
def mutant(tmp_path):
    """mutant(name, (old, new), ...): the ball, of whose C source or description these texts are replaced."""

    def build(name, *replacements):
        source, text = ((FOREIGN / "events" / file).read_text() for file in ("Ball.c", f"{name}.xml"))
        for old, new in replacements:
            assert source.count(old) + text.count(old) == 1, old
            source, text = source.replace(old, new), text.replace(old, new)
        (tmp_path / "Mutant.c").write_text(source)
        return build_c(tmp_path / "Mutant.c", text, tmp_path / "Mutant.fmu")

    return build


FAULTS = {
    "derivatives that are no numbers": (
        ("is_at_rest ? 0.0", "v[H] < 0.5 ? 0.0 / (v[H] - v[H])"),
        r"do_step at t = 0.3\d* s cannot be integrated: .*right-hand side"),
    "an event that never ends": (
        ("int again = 0;", "int again = v[N_BOUNCES] > 0;"), r"at t = 0.45\d* s has not ended after 100 calls"),
    "an event at the same time for ever": (
        ("v[NEXT] += 1.0;", ""), r"do_step at t = 1.000 s had more than 100 events at one time"),
    "Zeno's ball": (
        ("if (v[V] < 0.1) v[V] = 0.0;", ""), r"do_step at t = 2.5\d* s had more than 100 events at one time"),
}  # fmt: skip


@pytest.mark.full_but("derivatives that are no numbers-Ball")
@pytest.mark.parametrize("name", ["Ball", "Ball-3"])
@pytest.mark.parametrize(("edit", "told"), FAULTS.values(), ids=FAULTS)
def test_what_cannot_go_on_is_told_in_one_line(mutant, opened, capfd, name, edit, told):
    slave = opened(mutant(name, edit))
    with pytest.raises(SlaveError, match=told) as caught:
        table(slave, 300)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""  # CVODE's own words are in the error


def test_scheduled_execution_is_refused_in_one_line(mutant):
    fmu = mutant("Ball-3", ("<ModelExchange", "<ScheduledExecution"), ('needsCompletedIntegratorStep="true" ', ""))
    told = "Mutant.fmu is an FMI 3.0 scheduled-execution FMU, not FMI 2.0 or 3.0 co-simulation or model-exchange."
    with pytest.raises(ModelDescriptionError, match=re.escape(told)):
        open_slave(fmu, "ball")


# -- in a loop --------------------------------------------------------------------------------------------------------


@pytest.fixture
def exchanged(axis, tmp_path):
    """The scenario axis.toml with a model-exchange FMU as the plant, and FMUs that save their states."""
    for name, interface in (("Axis", "ModelExchange"), ("AxisController", "CoSimulation")):
        text = (FOREIGN / f"{name}.xml").read_text()
        part = f'<{interface} modelIdentifier="{name}" {STATES}/>'
        (tmp_path / f"{name}.fmu").unlink(missing_ok=True)
        build_c(FOREIGN / f"{name}.c", re.sub("<CoSimulation.*?>", part, text), tmp_path / f"{name}.fmu")

    def load(overrides=None, *replacements):
        return Scenario.load(axis_path(replacements), {"scenario.checkpoint": "10"} | (overrides or {}))

    def axis_path(replacements):
        for name in ("Axis", "AxisController"):  # as built above, not the fixture's
            (tmp_path / f"{name}.fmu").rename(tmp_path / f"{name}.own")
        path = axis(*replacements)
        for name in ("Axis", "AxisController"):
            (tmp_path / f"{name}.own").replace(tmp_path / f"{name}.fmu")
        return path

    return load


class Stopped(Exception):
    """The run is left where it is, as when it is killed."""


@pytest.mark.full
def test_a_run_tunes_by_it_is_rolled_ahead_and_goes_on_to_the_same_bits(exchanged, tmp_path):
    def stop(t, _):
        if t > 0.44:
            raise Stopped

    scenario = exchanged()
    whole = run(scenario, seed=1, out=tmp_path / "whole")
    assert whole.status == "done"
    assert whole.estimates["m"][-1] == pytest.approx(3.0, rel=2e-3)
    assert whole.guard["rolled_ahead"] > 0, whole.guard
    with pytest.raises(Stopped):
        run(scenario, seed=1, out=tmp_path / "left", progress=stop)
    resume(tmp_path / "left")
    for name in (SERIES, EVENTS):
        assert (tmp_path / "left" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
