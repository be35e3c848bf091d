"""The estimator as an FMU: what it declares, estimates and ships, and what it says where something is missing."""

import ast
import json
import os
import re
import subprocess
import sys
import sysconfig
import zipfile
from importlib.metadata import distributions, version
from math import sin
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

import cosim
from cosim import Scenario, ScenarioError
from cosim.authoring.doctor import diagnose
from cosim.cli import main
from cosim.estimator_fmu.build import build_estimator
from cosim.estimator_fmu.settings import estimator_settings
from cosim.estimator_fmu.slave import EstimatorSlave
from cosim.scenarios.scenario import named_scenarios
from estimator import Estimate
from estimator.retuning.proposal import Proposal

fmu = pytest.mark.fmu
TRUTH = {"m": 4.271, "l": 0.981}


def slave_of(scenario: Scenario, method: str = "target", **start: float) -> EstimatorSlave:
    """An initialised slave in this process, with these values set before."""
    settings = estimator_settings(scenario, method) | {"ships": []}
    slave = type("Estimator", (EstimatorSlave,), {"settings": settings, "__doc__": "Estimates."})(instance_name="one")
    slave.setup_experiment(0.0)
    put(slave, **start)
    slave.exit_initialization_mode()
    return slave


def places_of(slave, *names) -> list[int]:
    """Value references."""
    known = [variable.name for variable in slave.variables]
    return [known.index(name) for name in names]


def put(slave, **values) -> None:
    for i, value in zip(places_of(slave, *values), values.values(), strict=True):
        getattr(slave, f"set_{slave.variables[i].type.lower()}")([i], [value])


def get(slave, *names):
    places = places_of(slave, *names)
    return [getattr(slave, f"get_{slave.variables[i].type.lower()}")([i])[0] for i in places]


def acceleration(phi: float, phi_dot: float, u: float, m: float, l: float) -> float:
    """Newton's second law along the tangent, with the friction 0.1 kg/s and gravity of the FMU's table."""
    return (u - m * 9.81 * sin(phi) - 0.1 * l * phi_dot) / (m * l)


def feed(slave, n_steps: int, truth=TRUTH, first: int = 0, error: float = 0.5, noise: float = 0.0) -> None:
    """Samples of a pendulum that is driven hard, so that two of them tell both parameters."""
    rng = np.random.default_rng(first)
    for k in range(first, first + n_steps):
        phi, phi_dot, u = rng.uniform(-1.5, 1.5), rng.uniform(-2.0, 2.0), rng.uniform(-30.0, 30.0)
        xdot = acceleration(phi, phi_dot, u, **truth) + noise * rng.standard_normal()
        put(slave, phi=phi, phi_dot=phi_dot, u_held=u, phi_ref=phi + error)
        slave.set_real(places_of(slave, "der(phi_dot)"), [xdot])
        slave.do_step(0.01 * k, 0.01)


def tracking_slave(**start):
    """The slave of the pendulum's scenario whose trigger is the tracking error."""
    return slave_of(Scenario.load("pendulum", {"estimation.trigger": '{kind = "tracking", threshold = 0.01}'}), **start)


# -- gains --------------------------------------------------------------------------------------------------------


def gains_scenario(tmp_path, formula: str, code: str = "") -> Scenario:
    """The pendulum's scenario, whose controller's Kp follows from the mass."""
    text = (Path(cosim.__file__).parent / "scenarios" / "pendulum.toml").read_text(encoding="utf-8")
    path = tmp_path / "gains.toml"
    path.write_text(
        text.replace('writes = "controller.m"', f'start = 1.75\nwrites = {{ "controller.Kp" = "{formula}" }}')
    )
    (tmp_path / "gain_functions.py").write_text(code)
    return Scenario.load(path)


def test_gains_are_outputs_that_follow_the_estimates(tmp_path):
    slave = slave_of(gains_scenario(tmp_path, "10*m/1.75"), m_start=3.5)
    unit = next(v.unit for v in slave.variables if v.name == "Kp")
    assert (get(slave, "Kp"), unit) == ([pytest.approx(20.0)], "1/s2")
    feed(slave, 60)
    assert get(slave, "Kp")[0] == pytest.approx(10.0 * 4.271 / 1.75, rel=0.01)
    assert get(slave, "Kp")[0] == 10.0 * get(slave, "m")[0] / 1.75


def test_an_estimate_without_gains_is_not_taken(tmp_path):
    slave = slave_of(gains_scenario(tmp_path, "10*sqrt((3 - m)/1.25)"))
    feed(slave, 60)
    assert get(slave, "m")[0] <= 3.0
    assert get(slave, "Kp")[0] == 10.0 * ((3.0 - get(slave, "m")[0]) / 1.25) ** 0.5


@fmu
def test_an_infinite_setting_is_built_in(tmp_path):
    """The FMU is instantiated for its description, with the entry script that has the setting."""
    scenario = Scenario.load("pendulum", {"estimation.target.significance": "inf"})
    assert build_estimator(scenario, tmp_path).is_file()


@fmu
@pytest.mark.full
def test_a_function_that_gives_gains_is_shipped(tmp_path):
    scenario = gains_scenario(tmp_path, "gain_functions:place", "def place(m, l):\n    return 10.0 * m / 1.75\n")
    path = build_estimator(scenario, tmp_path / "out")
    with zipfile.ZipFile(path) as archive:
        assert any(re.fullmatch(r"resources/gain_functions\w*\.py", name) for name in archive.namelist())
    names = ["phi", "phi_dot", "u_held", "phi_ref"]
    inputs = np.array(
        [(0.0, 0.3, 0.1, 5.0, 0.0), (0.1, 0.3, 0.1, 5.0, 0.0)], dtype=[(n, float) for n in ("time", *names)]
    )
    found = fmpy.simulate_fmu(str(path), stop_time=0.05, output_interval=0.01, input=inputs, output=["Kp", "m"])
    assert np.allclose(found["Kp"], 10.0 * found["m"] / 1.75, rtol=1e-12)


def windy(folder: Path) -> Scenario:
    """The pendulum in a wind that a table gives; from 0.3 s on its actuator lags, and at 0.8 s its mass changes."""
    t = 0.01 * np.arange(201)
    wind = np.repeat(np.random.default_rng(1).uniform(-8.0, 8.0, 41), 5)[: len(t)]
    rows = [f"{at:.2f},{force!r}" for at, force in zip(t, wind.tolist(), strict=True)]
    (folder / "wind.csv").write_text("\n".join(["time [s],F [N]", *rows]))
    text = (Path(cosim.__file__).parent / "scenarios" / "pendulum.toml").read_text(encoding="utf-8")
    text = text.replace("[connections]", 'wind = {table = "wind.csv"}\n[connections]\n"plant.F_d" = "wind.F"')
    (folder / "windy.toml").write_text(text)
    changes = '{"plant.tau_u" = [[0.0, 0.0], [0.3, 0.05]], "plant.m" = [[0.0, 1.75], [0.8, 4.271]], "plant.l" = 0.75}'
    off = {"guard.enabled": "false", "observations.enabled": "false", "estimation.instants": "[]"}
    return Scenario.load(folder / "windy.toml", {"changes": changes, "scenario.stop_time": "1.2", **off})


def test_an_input_that_no_actuator_drives_does_not_lag_and_the_estimates_are_those_of_a_run(tmp_path):
    scenario, seed = windy(tmp_path), 3
    run = cosim.run(scenario, seed=seed)
    assert run.summary()["diagnosis"]["input_lag"]["time_constant"] == pytest.approx(0.05, rel=0.02)
    slave = slave_of(scenario, seed=seed)
    columns = {
        "der(phi_dot)": "sampled.plant.der(phi_dot)", "phi": "plant.phi", "phi_dot": "plant.phi_dot",
        "u_held": "held.plant.u", "F_d_held": "held.plant.F_d", "phi_ref": "reference.phi_ref",
    }  # fmt: skip
    for k in range(scenario.scenario.n_steps):
        slave.set_real(places_of(slave, *columns), [float(run.series[name][k]) for name in columns.values()])
        slave.do_step(scenario.scenario.time(k), 0.01)
        assert get(slave, "m", "l") == [run.series[f"controller.{name}"][k] for name in ("m", "l")]


# -- what it declares ---------------------------------------------------------------------------------------------


@pytest.mark.full_but("pendulum")
@fmu
@pytest.mark.parametrize("name", named_scenarios())
def test_every_scenario_s_estimator_is_a_valid_fmu_with_the_plant_s_names_and_units(tmp_path, name):
    scenario = Scenario.load(name)
    path = build_estimator(scenario, tmp_path)
    words = [word.capitalize() for word in name.split("-")]
    assert path == tmp_path / f"{''.join(words)}Estimator.fmu"
    assert validate_fmu(str(path)) == []
    declared = {v.name: v for v in fmpy.read_model_description(str(path)).modelVariables}
    plant = fmpy.read_model_description(str(built(scenario.components["plant"].fmu, tmp_path))).modelVariables
    outputs = {v.name: v for v in plant if v.causality == "output"}
    sampled = [reference.partition(".")[2] for reference in scenario.sampling.derivatives]
    states = [v.derivative.name for v in plant if v.derivative is not None]
    held = [v for v in outputs if v.endswith("_held")]
    references = [reference.partition(".")[2] for reference in scenario.tracking.values()]
    inputs = [n for n, v in declared.items() if v.causality == "input"]
    assert inputs == [*states, *held, *sampled, *references, "tracking_error"]
    for n in (*states, *held, *sampled):
        assert declared[n].unit == outputs[n].unit
    names = [p.name for p in scenario.estimation.parameters]
    assert [n for n, v in declared.items() if v.causality == "output"] == [
        *names, *(f"{n}_std" for n in names), *(f"{n}_identifiable" for n in names),
        "n_evaluations", "n_episodes", "update_ready",
    ]  # fmt: skip
    for p in scenario.estimation.parameters:
        bounds = [declared[f"{p.name}_{end}"] for end in ("lower", "upper")]
        assert [float(v.start) for v in bounds] == [p.lower, p.upper]
        assert {v.unit for v in (*bounds, declared[p.name], declared[f"{p.name}_std"])} == {p.unit}
        assert (declared[f"{p.name}_identifiable"].type, declared["n_evaluations"].type) == ("Boolean", "Integer")


def built(name: str, folder: Path) -> Path:
    from fmu_models.build import build

    return build(name, folder)


@pytest.mark.full
@fmu
def test_the_same_scenario_gives_the_same_bytes_anywhere(tmp_path):
    code = "import sys; from cosim.cli import main; main(['build', '--estimator', 'pendulum', '--out', sys.argv[1]])"
    for name, seed in (("a", "1"), ("b", "2")):
        folder = tmp_path / name
        folder.mkdir()
        environment = os.environ | {"PYTHONHASHSEED": seed, "TZ": "Asia/Tokyo" if seed == "2" else "UTC"}
        subprocess.run([sys.executable, "-c", code, "."], cwd=folder, env=environment, check=True, capture_output=True)
    a, b = ((tmp_path / name / "PendulumEstimator.fmu").read_bytes() for name in "ab")
    assert a == b == build_estimator(Scenario.load("pendulum"), tmp_path).read_bytes()
    other = Scenario.load("pendulum", {"estimation.budget": "31"})
    assert build_estimator(other, tmp_path).read_bytes() != a


def test_initial_dependencies_are_exactly_what_a_perturbation_shows():
    settings = estimator_settings(Scenario.load("pendulum")) | {"ships": []}
    kind = type("Estimator", (EstimatorSlave,), {"settings": settings, "__doc__": "Estimates."})
    outputs = [v.name for v in kind.variables if v.causality == "output"]

    def another(v, value):
        if isinstance(value, bool):
            return not value
        return value / 2 if v.max is not None and value + 1 > v.max else value + 1 if value else 0.5

    def initial(v=None):
        slave = kind(instance_name="one")
        slave.setup_experiment(0.0)
        if v is not None:
            put(slave, **{v.name: another(v, *get(slave, v.name))})
        return get(slave, *outputs)

    before = initial()
    seen = {name: set() for name in outputs}
    for v in kind.variables:
        if v.causality != "output":
            for name, a, b in zip(outputs, before, initial(v), strict=True):
                if a != b:
                    seen[name].add(v.name)
    assert seen == {v.name: set(v.dependencies) for v in kind.variables if v.causality == "output"}


# -- what it estimates --------------------------------------------------------------------------------------------


def test_it_finds_the_parameters_of_newton_s_pendulum_and_says_how_well():
    slave = slave_of(Scenario.load("pendulum"))
    assert get(slave, "m", "l", "m_std", "l_std", "update_ready") == [1.75, 0.75, 4.9, 2.9, False]
    feed(slave, 1)  # the first point has no sample, as in a run
    assert get(slave, "m", "l", "n_evaluations", "update_ready") == [1.75, 0.75, 0, False]
    feed(slave, 31, first=1, noise=1e-3)
    m, l, m_std, l_std = get(slave, "m", "l", "m_std", "l_std")
    # The tracking error is still large after thirty, but nothing contradicts what has been found.
    assert get(slave, "n_evaluations", "update_ready", "m_identifiable", "l_identifiable") == [30, True, True, True]
    assert 0.0 < m_std < 5e-3
    assert 0.0 < l_std < 5e-3
    assert m == pytest.approx(TRUTH["m"], abs=5.0 * m_std)
    assert l == pytest.approx(TRUTH["l"], abs=5.0 * l_std)


def test_a_tracking_error_alone_begins_no_other_search_of_samples_that_are_explained():
    slave = tracking_slave(diagnosis_enabled=False)
    feed(slave, 32, noise=1e-3)
    assert get(slave, "n_evaluations", "n_episodes") == [30, 1]


def test_without_a_tracking_error_nothing_is_estimated_and_with_one_from_outside_it_is():
    slave = tracking_slave()
    feed(slave, 10, error=0.009)
    assert get(slave, "n_evaluations", "n_episodes", "update_ready") == [0, 0, False]
    told = tracking_slave(tracking_error_is_input=True)
    feed(told, 5)  # the difference of phi and phi_ref is not looked at
    assert get(told, "n_episodes") == [0]
    put(told, tracking_error=-0.02)
    feed(told, 5, first=5)
    assert get(told, "n_episodes", "n_evaluations") == [1, 5]


def test_the_parameters_are_those_of_the_scenario_and_may_be_set():
    feeds = {}
    for name, start in {
        "as it is": {}, "seed": {"seed": 7}, "bounds": {"m_upper": 3.0}, "start": {"m_start": 3.0},
        "noise": {"noise_der_phi_dot": 10.0}, "window": {"window": 1},
    }.items():  # fmt: skip
        slave = slave_of(Scenario.load("pendulum"), **start)
        feed(slave, 12)
        feeds[name] = get(slave, "m", "l", "m_std")
    assert len({tuple(values) for values in feeds.values()}) == len(feeds)
    assert feeds["bounds"][0] <= 3.0
    assert feeds["noise"][2] > 100.0 * feeds["as it is"][2]
    few = slave_of(Scenario.load("pendulum"), budget=4, evaluations_per_step=3)
    feed(few, 3)
    assert get(few, "n_evaluations", "n_episodes") == [4, 1]
    high = tracking_slave(threshold=0.6)
    feed(high, 5)
    assert get(high, "n_episodes") == [0]


def test_the_quadrotor_s_threshold_is_a_probability():
    slave = slave_of(Scenario.load("quadrotor"), false_alarm=1e-9)
    assert get(slave, "false_alarm", "evaluations_per_step", "window") == [1e-9, 3, 10]


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ({"m_start": 6.0}, r"m_start must be in \[0.1, 5\] kg, got 6"),
        ({"m_lower": 6.0}, r"'m' must have finite lower < upper, got \[6.0, 5.0\] kg"),
        ({"m_lower": -1.0}, "'m' must have lower > 0 on a log scale"),
        ({"budget": 0}, "budget must be in"),
        ({"seed": -1}, "seed must be in"),
        ({"false_alarm": 0.0}, "false_alarm must be in"),
        ({"noise_der_phi_dot": 0.0}, "noise_der_phi_dot must be in"),
        ({"m_upper": float("nan")}, "m_upper must be finite"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_unsound_parameters_are_refused_when_initialisation_ends(start, message):
    with pytest.raises(ValueError, match=message):
        slave_of(Scenario.load("pendulum"), **start)


@pytest.mark.full_but("least-squares")
@pytest.mark.parametrize("method", ["paper", "least-squares", "rls", "ukf", "enkf"])
def test_other_methods_are_built_in_as_well(method):
    slave = slave_of(Scenario.load("pendulum"), method)
    feed(slave, 60, noise=1e-3)
    assert get(slave, "update_ready") == [True]
    if method != "paper":
        assert get(slave, "m", "l") == pytest.approx(list(TRUTH.values()), rel=0.02)


GAIN = [
    {"name": "m", "lower": 0.1, "upper": 5.0, "unit": "kg", "scale": "log", "start": 1.75,
     "writes": {"controller.m": "1.0*m"}},
    {"name": "l", "lower": 0.1, "upper": 3.0, "unit": "m", "scale": "log", "writes": "controller.l"},
]  # fmt: skip


@pytest.mark.parametrize("parameters", [None, GAIN], ids=["plain", "formula"])
def test_a_saved_state_repeats_every_bit(parameters):
    scenario = Scenario.load("pendulum")
    if parameters is not None:
        tables = scenario.model_dump(mode="json", by_alias=True)
        tables["estimation"]["parameters"] = parameters
        scenario = Scenario.from_tables(tables, {}, scenario.folder, Path("gain"), scenario.origin)
    slave = slave_of(scenario)
    feed(slave, 10, noise=1e-3)
    saved, before = slave._get_fmu_state(), get(slave, "m", "l", "n_evaluations")
    runs = []
    for _ in range(2):
        assert get(slave, "m", "l", "n_evaluations") == before
        feed(slave, 40, first=10, noise=1e-3)
        runs.append(get(slave, *(variable.name for variable in slave.variables)))
        slave._set_fmu_state(saved)
    assert runs[0] == runs[1]
    assert runs[0][places_of(slave, "n_evaluations")[0]] > before[2]


class Proposing:
    """A retuner that makes these proposals, one after the other."""

    n_evaluations = n_episodes = 0

    def __init__(self, *proposals: Proposal) -> None:
        self._proposals = list(proposals)

    def step(self, *_: object) -> Proposal:
        return self._proposals.pop(0)


def test_the_standard_deviation_is_that_of_the_parameters_in_force():
    slave, found = slave_of(Scenario.load("pendulum")), np.array([4.3, 1.0])
    estimate = Estimate(found, np.array([0.2, 0.01]), (True, True), 1.0, 20, "")
    finer = Estimate(found, np.array([0.1, 0.005]), (True, True), 1.0, 25, "")
    other = Estimate(np.array([2.0, 0.5]), np.array([0.01, 0.01]), (True, True), 9.0, 30, "")
    steps = [
        (Proposal(found, estimate, is_warranted=False), (1.75, 4.9, False)),  # it waits
        (Proposal(found, estimate), (4.3, 0.2, True)),
        (Proposal(None, other), (4.3, 0.2, True)),
        (Proposal(None, finer), (4.3, 0.1, True)),
        (Proposal(undo=np.array([1.75, 0.75])), (1.75, 4.9, False)),
    ]
    slave._loop._retuner = Proposing(*(proposal for proposal, _ in steps))
    for k, (_, (m, std, is_identifiable)) in enumerate(steps):
        slave.do_step(0.01 * k, 0.01)
        assert get(slave, "m", "m_std", "m_identifiable") == [m, pytest.approx(std), is_identifiable]


# -- what it ships, and where that is not enough --------------------------------------------------------------------


MODEL = '''
import constants
from geometry.tangent import force

def derivative(x, u, m, l):
    """As fmu_models.pendulum has it."""
    return (x[1], (u[0] + force(x, m, l)) / (m * l) * constants.ONE)
'''
TANGENT = """
from math import sin
import constants

def force(x, m, l):
    return -m * constants.GRAVITY * sin(x[0]) - 0.1 * l * x[1]
"""


@pytest.fixture
def users(tmp_path, monkeypatch):
    """A scenario file of a user's, in a folder of its own, with a model in modules beside it."""

    def made(name: str, one: str = "1.0") -> Path:
        folder = tmp_path / name
        (folder / "geometry").mkdir(parents=True)
        (folder / "my_model.py").write_text(MODEL)
        (folder / "constants.py").write_text(f"GRAVITY = 9.81\nONE = {one}\n")
        (folder / "geometry" / "__init__.py").write_text("")
        (folder / "geometry" / "tangent.py").write_text(TANGENT)
        text = (Path(sys.modules["cosim"].__file__).parent / "scenarios" / "pendulum.toml").read_text()
        text = text.replace("fmu_models.pendulum:derivative", "my_model:derivative")
        (folder / "own.toml").write_text(text.replace('name = "pendulum"', f'name = "{name}"'))
        return folder / "own.toml"

    monkeypatch.chdir(tmp_path)
    return made


ONE_STEP = """
import json, os, sys, fmpy
from fmpy.fmi2 import FMU2Slave
told, estimates = json.loads(sys.argv[1]), []
fmus = []
for path in sys.argv[2:]:
    description = fmpy.read_model_description(path)
    references = {v.name: v.valueReference for v in description.modelVariables}
    fmu = FMU2Slave(guid=description.guid, unzipDirectory=fmpy.extract(path), instanceName="one",
                    modelIdentifier=description.coSimulation.modelIdentifier)
    fmu.instantiate()
    fmu.setupExperiment()
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    fmus.append((fmu, references))
for fmu, references in fmus:
    for k, values in enumerate(told):
        fmu.setReal([references[name] for name in values], list(values.values()))
        fmu.doStep(0.01 * k, 0.01)
    estimates.append(fmu.getReal([references["m"], references["l"]]))
roots = {"cosim", "estimator", "fmu_models", "my_model", "constants", "geometry", "pydantic", "pyarrow"}
names = sorted(roots & {name.partition(".")[0] for name in sys.modules})
print(json.dumps({"estimates": estimates, "modules": names}), flush=True)
os._exit(0)
"""


def samples(n: int) -> list[dict[str, float]]:
    rng, rows = np.random.default_rng(0), []
    for phi, phi_dot, u in rng.uniform((-1.5, -2.0, -30.0), (1.5, 2.0, 30.0), (n, 3)):
        xdot = acceleration(phi, phi_dot, u, **TRUTH)
        rows.append({"phi": phi, "phi_dot": phi_dot, "u_held": u, "der(phi_dot)": xdot, "phi_ref": phi + 0.5})
    return rows


def in_fmpy(*paths: Path, blocked: str | None = None, code: str = ONE_STEP) -> subprocess.CompletedProcess:
    """The script in a new interpreter, far from the sources; blocked: a package that it cannot import."""
    folder = paths[0].parent / "host"
    folder.mkdir(exist_ok=True)
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    if blocked:
        (folder / "sitecustomize.py").write_text(f"import sys\nsys.modules['{blocked}'] = None\n")
        environment["PYTHONPATH"] = str(folder)
    command = [sys.executable, "-c", code, json.dumps(samples(40)), *map(str, paths)]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment)


@pytest.mark.full
@fmu
def test_a_user_s_model_is_shipped_with_what_it_imports(users, tmp_path):
    done = in_fmpy(build_estimator(Scenario.load(users("mine")), tmp_path))
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    np.testing.assert_allclose(result["estimates"], [list(TRUTH.values())], rtol=1e-3)
    assert result["modules"] == []  # neither installed ones nor names that another FMU could have


@pytest.mark.full
@fmu
def test_two_models_of_the_same_name_share_a_process(users, tmp_path):
    """The second model accelerates half as much: that of half the length, but for the little friction."""
    paths = [tmp_path / "first.fmu", tmp_path / "second.fmu"]
    for path, one in zip(paths, ("1.0", "0.5"), strict=True):
        source = users(path.stem, one)
        code = "import sys; from cosim.cli import main; main(['build', '--estimator', sys.argv[1], '--out', '.'])"
        subprocess.run([sys.executable, "-c", code, str(source)], cwd=source.parent, check=True, capture_output=True)
        (source.parent / f"{path.stem.capitalize()}Estimator.fmu").rename(path)
    first, second = json.loads(in_fmpy(*paths).stdout)["estimates"]
    np.testing.assert_allclose(first, list(TRUTH.values()), rtol=1e-3)
    np.testing.assert_allclose(second, [TRUTH["m"], TRUTH["l"] / 2.0], rtol=0.02)


REPORT = """
import gc, os, sys, fmpy
from fmpy.fmi2 import *
import fmpy.fmi2 as fmi2
path, messages = sys.argv[2], []
description, folder = fmpy.read_model_description(path), fmpy.extract(path)
callbacks = fmi2.fmi2CallbackFunctions()
callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda e, n, status, c, text: messages.append((status, text.decode())))
callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
for _ in range(20):
    fmu = fmi2.FMU2Slave(guid=description.guid, unzipDirectory=folder, instanceName="one",
                         modelIdentifier=description.coSimulation.modelIdentifier)
    try:
        fmu.instantiate(callbacks=callbacks, loggingOn=True)
    except Exception as e:
        print(e)
    gc.collect()
print(len(messages), messages[0], flush=True)
os._exit(0)
"""


@pytest.mark.full_but("scipy")
@fmu
@pytest.mark.parametrize("package", ["GPy", "scipy"])
def test_a_missing_package_is_told_in_the_log_and_instantiation_fails_again_and_again(tmp_path, package):
    done = in_fmpy(build_estimator(Scenario.load("pendulum"), tmp_path), blocked=package, code=REPORT)
    assert done.returncode == 0, done.stderr
    *failures, told = done.stdout.splitlines()
    assert failures == ["Failed to instantiate model"] * 20
    assert told.startswith("20 (4, ")  # fmi2Fatal
    for text in (told, done.stderr):
        assert "PendulumEstimator needs numpy, scipy, GPy in the Python that loads it" in text
        assert f"{package} cannot be imported" in text
        assert "python -m pip install numpy scipy GPy" in text


@fmu
def test_a_python_with_nothing_installed_is_told_so(tmp_path):
    """The host is ctypes and the standard library."""
    path = build_estimator(Scenario.load("pendulum"), tmp_path)
    host = Path(__file__).parents[2] / "fmu_models" / "fmu_host.py"
    arguments = json.dumps({"fmu": str(path)})
    done = subprocess.run([sys.executable, "-I", "-S", str(host), "modules", arguments], capture_output=True, text=True)
    assert done.returncode == 1
    assert "numpy cannot be imported, ModuleNotFoundError" in done.stderr.splitlines()[-1]  # the FMI log's messages


@fmu
@pytest.mark.full
def test_it_needs_no_more_than_it_says(tmp_path):
    """With NumPy, SciPy and GPy reachable, and nothing that a .pth file would add, such as our own sources."""
    path = build_estimator(Scenario.load("pendulum"), tmp_path)
    host = Path(__file__).parents[2] / "fmu_models" / "fmu_host.py"
    code = "import runpy, sys; sys.path.append(sys.argv[1]); del sys.argv[:2]; "
    code += "runpy.run_path(sys.argv[0], run_name='__main__')"
    arguments = [sysconfig.get_path("purelib"), str(host), "modules", json.dumps({"fmu": str(path)})]
    command = [sys.executable, "-I", "-S", "-c", code, *arguments]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    loaded = {name.partition(".")[0] for name in json.loads(done.stdout)}
    assert {"numpy", "scipy", "GPy"} <= loaded
    assert loaded.isdisjoint({"pydantic", "pyarrow", "fmpy", "filterpy", "tqdm", "platformdirs"})
    assert loaded.isdisjoint({"cosim", "estimator", "fmu_models"})  # but under the FMU's own names


@fmu
def test_the_archive_holds_no_more_of_the_co_simulation_than_is_loaded(tmp_path):
    with zipfile.ZipFile(build_estimator(Scenario.load("quadrotor"), tmp_path)) as archive:
        names = {Path(name).name for name in archive.namelist() if name.startswith("resources/cosim_")}
    assert names == {"__init__.py", "loop.py", "slave.py", "names.py", "formula.py", "tuning_rule.py"}


@pytest.mark.full
@fmu
def test_the_readme_s_script_re_tunes_the_pendulum(tmp_path):
    readme = (Path(__file__).parents[3] / "docs" / "estimator-fmu.md").read_text(encoding="utf-8")
    (script,) = [
        block for block in re.findall(r"```python\n(.*?)```", readme, re.DOTALL) if "PendulumEstimator" in block
    ]
    for name in ("Pendulum", "PendulumControllerAdaptive"):
        built(name, tmp_path / "fmus")
    build_estimator(Scenario.load("pendulum"), tmp_path / "fmus")
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    environment["GLIBC_TUNABLES"] = "glibc.malloc.tcache_count=65535"  # see docs/commands.md
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    held = ast.literal_eval(done.stdout)
    assert held == {"m_held": pytest.approx(4.271, abs=2e-3), "l_held": pytest.approx(0.981, abs=5e-4)}


@fmu
def test_the_doctor_knows_what_it_needs_and_what_of_that_is_missing(tmp_path, monkeypatch):
    path = build_estimator(Scenario.load("pendulum"), tmp_path)
    modules = diagnose(path).findings[-1]
    expected = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "GPy"))
    assert (modules.subject, modules.is_well, modules.text) == ("modules", True, expected)
    monkeypatch.setattr(
        "cosim.authoring.doctor.distributions", lambda: [d for d in distributions() if d.name.lower() != "gpy"]
    )
    modules = diagnose(path).findings[-1]
    assert not modules.is_well
    assert modules.text.startswith("GPy not installed in ")


# -- what is refused ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--estimator", "pendulum", "--method", "none"], "'none' cannot be built into an FMU"),
        (["--estimator", "pendulum", "--method", "my:Class"], "'my:Class' cannot be built into an FMU"),
        (["--estimator", "pendulum", "--method", "targt"], "no estimator 'targt'; did you mean 'target'?"),
        (["--estimator", "rigid-body", "--method", "rls"], "estimator 'rls' needs estimation.linear"),
        (["--estimator", "pendulun"], "did you mean 'pendulum'?"),
        (["--estimator", "pendulum", "--set", "estimation.budget=0"], "estimation.budget"),
        (["--estimator", "pendulum", "--set", "scenario.name=1st"], "scenario.name '1st' must begin with a letter"),
        (["--estimator", "pendulum", "--set", "sampling.derivatives={'plant.der(x)'={noise=1.0}}"], "plant.der(x)"),
        (["--method", "target"], "--method, --set and --trust are of an estimator"),
        (["--set", "estimation.budget=2"], "--method, --set and --trust are of an estimator"),
    ],
    ids=lambda value: " ".join(value[-1:]) if isinstance(value, list) else "",
)
def test_what_cannot_be_built_is_refused_in_one_line(capsys, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main(["build", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("retune: ")
    assert len(err.splitlines()) == 1
    assert message in err
    assert list(tmp_path.iterdir()) == []


@fmu
def test_the_command_builds_it_and_replaces_nothing_unasked(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = ["build", "--estimator", "quadrotor", "--out", "fmus"]
    assert main(command) == 0
    following = "next: retune info fmus/QuadrotorEstimator.fmu\n"
    assert capsys.readouterr().out == f"fmus/QuadrotorEstimator.fmu  built\n{following}"
    assert main(command) == 0
    assert capsys.readouterr().out == f"fmus/QuadrotorEstimator.fmu  unchanged\n{following}"
    assert main([*command, "--set", "estimation.budget=5"]) == 2
    assert "exists and differs; give --force" in capsys.readouterr().err
    assert main([*command, "--set", "estimation.budget=5", "--force"]) == 0
    assert capsys.readouterr().out == f"fmus/QuadrotorEstimator.fmu  replaced\n{following}"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("import geometry.tangent", "'import geometry.tangent' cannot be shipped in an FMU"),
        ("import math, constants", "'import math, constants' cannot be shipped in an FMU"),
    ],
)
def test_an_import_that_could_not_be_followed_is_refused(users, tmp_path, line, message):
    source = users("mine")
    name = f"model_{len(line)}"  # modules stay loaded
    (source.parent / f"{name}.py").write_text(f"{line}\n{MODEL}")
    source.write_text(source.read_text().replace("my_model:", f"{name}:"))
    with pytest.raises(ScenarioError, match=message):
        build_estimator(Scenario.load(source), tmp_path)
