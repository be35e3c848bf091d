"""The loop simulated ahead: against what then happens, an independent integration, and where FMUs lack states."""

import math
import os
import re
import shutil
import signal
from contextlib import ExitStack

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cosim.errors import CosimError, SlaveError
from cosim.fmi.archive import capabilities
from cosim.retuning.lookahead import Lookahead, RunningSystem, _modelled
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario
from cosim.slaves.slave import Slave, open_slave
from cosim.system.fmu_cache import fmu_paths
from cosim.system.master import Master
from cosim.system.plant import plant_of
from cosim.system.tuning import tuning_rule
from cosim.system.wiring import wire
from cosim.variable_name import VariableName
from estimator import Sample
from fmu_models import pendulum as physics

pytestmark = [pytest.mark.fmu, pytest.mark.usefixtures("leaves_nothing")]

SWING = {"components.plant.start.phi": "0.3", "components.plant.start.phi_dot": "-1.0", "scenario.isolation": '"none"'}
G, FRICTION, KP, KD, H = 9.81, 0.1, 10.0, 5.0, 0.01
CHANGED_EARLY = {
    "scenario.isolation": '"none"',
    "scenario.checkpoint": "0",
    'changes."plant.m"': "[[0.0, 1.75], [0.1, 4.271]]",
}
NOMINAL, CHANGED = np.array([1.75, 0.75]), np.array([4.271, 0.981])


class Loop:
    """The pendulum, `n` steps on its way with the nominal parameters, and its lookahead.

    push: its input, where none is connected.
    """

    def __init__(self, scenario, stack, n=20, lacking=(), push=None):
        paths = fmu_paths(scenario)
        self.slaves = {name: stack.enter_context(open_slave(p, name, isolation="none")) for name, p in paths.items()}
        for name in lacking:
            capabilities(self.slaves[name].description).canGetAndSetFMUstate = False
        wiring, groups = wire(scenario, self.slaves)
        self.plant = plant_of(scenario, self.slaves["plant"])
        self.master = Master(self.slaves, wiring, groups)
        self.master.disturb({} if push is None else {"plant": [push]})
        self.master.initialize(0.0, 1.0)
        self.lookahead = Lookahead(
            scenario,
            RunningSystem(self.slaves, wiring, groups, paths, self.master.names),
            self.plant,
            physics.derivative,
            stack,
            tuning_rule(scenario),
        )
        self.n = n
        for k in range(n):
            tunables = {"plant": NOMINAL.tolist(), "controller": NOMINAL.tolist()} if k == 0 else {}
            self.master.begin(k * H, H, tunables)
            self.master.finish(k * H, H, tunables)

    def value(self, name):
        return self.master.values[self.master.names.index(name)]

    def predicted_peak(self, controller, plant):
        x = (self.value("plant.phi"), self.value("plant.phi_dot"))
        now = self.lookahead.snapshot(Sample(self.n * H, x, (), ()))
        return self.lookahead.predicted_peak(now, list(self.master.values), self.n, controller, plant)


@pytest.fixture
def loop(pendulum):
    with ExitStack() as stack:
        yield lambda lacking=(), **more: Loop(pendulum(SWING | more, stop_time=1.0), stack, lacking=lacking)


def independent_peak(x, controller, plant, n_steps):
    """Largest |phi - 60 deg| after each of n steps with the force held, by DOP853."""
    (m, l), (m_true, l_true), errors = controller, plant, []
    for _ in range(n_steps):
        wanted = KP * (math.pi / 3.0 - x[0]) - KD * x[1]
        u = m * l * (wanted + G / l * math.sin(x[0]) + FRICTION / m * x[1])

        def slope(t, y, u=u):
            return [y[1], -(G / l_true) * math.sin(y[0]) - FRICTION / m_true * y[1] + u / (m_true * l_true)]

        x = solve_ivp(slope, (0.0, H), x, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        errors.append(abs(x[0] - math.pi / 3.0))
    return max(errors)


@pytest.mark.parametrize("lacking", [(), ("plant",)], ids=["by FMU state", "by the model"])
@pytest.mark.parametrize("controller", [NOMINAL, CHANGED, np.array([0.2, 0.3])], ids=["nominal", "changed", "weak"])
def test_the_peak_is_that_of_an_independent_integration(loop, controller, lacking):
    made = loop(lacking)
    x = [made.value("plant.phi"), made.value("plant.phi_dot")]
    expected = independent_peak(x, controller, CHANGED, 50)
    # 1e-8: two Runge-Kutta steps a macro step, see test_simulation
    assert made.predicted_peak(controller, CHANGED) == pytest.approx(expected, abs=1e-8)


@pytest.mark.full
def test_in_a_process_of_its_own_it_is_the_same_bits(loop):
    """One process for all three FMUs, which goes back as often as it is asked to."""
    here, isolated = loop(), loop(**{"scenario.isolation": '"process"'})
    places = [(NOMINAL, NOMINAL), (CHANGED, NOMINAL), (np.array([0.2, 0.3]), CHANGED), (NOMINAL, NOMINAL)]
    expected = [here.predicted_peak(*place) for place in places]
    assert len({*expected}) == 3
    assert [isolated.predicted_peak(*place) for place in places] == expected
    assert isolated.predicted_peak(np.array([1.75, 1e-3]), NOMINAL) is None  # refused; then it is opened once more
    assert isolated.predicted_peak(*places[1]) == expected[1]


@pytest.mark.full
def test_a_prediction_whose_process_was_killed_from_outside_is_the_same(loop, children):
    """Killed while it loads, before a course and again: an infinite peak would be a veto that no FMU has caused."""
    made, others = loop(**{"scenario.isolation": '"process"'}), children()
    expected = loop().predicted_peak(CHANGED, NOMINAL)
    made.lookahead.prepare()
    for _ in range(3):
        (process_id,) = children() - others
        os.kill(process_id, signal.SIGKILL)
        assert made.predicted_peak(CHANGED, NOMINAL) == expected
    assert made.lookahead.failure is None


def test_with_the_truth_in_the_plant_it_is_what_then_happens(loop, pendulum):
    # the nominal run, which the shadow joins after 20 of its 100 steps
    result = run(pendulum(SWING | {"changes": "{}"}, stop_time=0.7), "none")
    assert loop().predicted_peak(NOMINAL, NOMINAL) == np.max(np.abs(result.errors["plant.phi"][21:]))


def test_a_disturbance_is_in_the_plants_state_and_not_in_what_is_predicted(pendulum):
    """A constant force takes the place of the controller's; without it the pendulum swings freely: DOP853."""
    wired = '{ "controller.phi" = "plant.phi", "controller.phi_dot" = "plant.phi_dot" }'
    pushed = SWING | {"connections": wired, "changes": '{ "plant.m" = 1.75, "plant.l" = 0.75, "plant.u" = 3.0 }'}
    result = run(pendulum(pushed, stop_time=0.7), "none")
    x = (result["plant.phi"][20], result["plant.phi_dot"][20])
    desired = (result["plant.phi"] - result.errors["plant.phi"])[21:71]
    times = 0.01 * np.arange(1.0, 51.0)

    def free(t, x):
        return (x[1], physics.derivative(x, (0.0, 0.0), m=NOMINAL[0], l=NOMINAL[1])[1])

    phi = solve_ivp(free, (0.0, 0.5), x, "DOP853", t_eval=times, rtol=1e-12, atol=1e-13).y[0]
    with ExitStack() as stack:
        made = Loop(pendulum(pushed, stop_time=1.0), stack, push=3.0)
        peak = made.predicted_peak(NOMINAL, NOMINAL)
    assert peak == pytest.approx(np.abs(phi - desired).max(), rel=1e-6)
    assert peak > 1.01 * np.max(np.abs(result.errors["plant.phi"][21:71]))


def test_a_model_does_not_stand_for_a_plant_where_a_parameter_belongs_to_another_component(loop, monkeypatch):
    made = loop()
    capabilities(made.slaves["plant"].description).canGetAndSetFMUstate = False
    monkeypatch.setattr(Scenario, "true_reference", lambda self, parameter: VariableName("reference.phi_final"))
    of_loop = made.lookahead._scenario, made.slaves, made.lookahead._wiring
    with pytest.raises(CosimError, match=r"its model does not set 'reference\.phi_final'"):
        _modelled(*of_loop, made.plant, physics.derivative)


@pytest.mark.parametrize("size", [2.0, -0.3])
def test_a_disturbance_of_the_derivatives_acts_through_the_connected_inputs_alone(loop, size):
    """The pendulum has an input for a disturbance, too, which is not connected: it takes no share."""
    made, (m, l) = loop(), NOMINAL
    assert list(made.plant.inputs) == ["u", "F_d"]
    x, u = (0.3, -1.0), (0.5, 0.0)
    (offset,) = made.lookahead.equivalent_inputs(Sample(0.2, x, u, ()), np.array([size]), NOMINAL)
    before, after = (physics.derivative(x, (push, 0.0), m=m, l=l)[1] for push in (u[0], u[0] + offset))
    assert after - before == pytest.approx(size, rel=1e-6)


def test_the_shadow_gets_the_estimate_and_leaves_the_run_alone(loop):
    made = loop()
    before = list(made.master.values), made.slaves["plant"].get_state()
    told, untold = made.predicted_peak(NOMINAL, CHANGED), made.predicted_peak(NOMINAL, NOMINAL)
    assert abs(told - untold) > 1e-4
    assert made.predicted_peak(NOMINAL, CHANGED) == told  # nothing of the last time is left
    assert (list(made.master.values), made.slaves["plant"].get_state()) == before


def test_a_loop_that_passes_the_limit_is_infinite(loop):
    assert loop(**{"limits.divergence": "0.1"}).predicted_peak(NOMINAL, NOMINAL) == math.inf


def test_parameters_that_the_plant_refuses_tell_nothing_and_harm_nothing(loop):
    made = loop()
    expected = made.predicted_peak(NOMINAL, NOMINAL)
    assert made.predicted_peak(NOMINAL, np.array([1.75, 1e9])) is None
    assert made.predicted_peak(NOMINAL, NOMINAL) == expected


def test_a_controller_without_states_is_not_rolled_ahead(loop):
    with pytest.raises(CosimError, match="controller cannot save and restore the state of the FMU"):
        loop(("controller",))


def test_a_run_says_at_its_start_that_it_does_not_look_ahead(pendulum, tmp_path, monkeypatch):
    monkeypatch.setattr("cosim.slaves.slave.Slave.has_states", property(lambda slave: slave.name == "plant"))
    result = run(pendulum({"scenario.isolation": '"none"'}, stop_time=0.05), "target", out=tmp_path / "run")
    reason = "controller, reference cannot save and restore the state of the FMU"
    assert result.guard["not_rolled_ahead"] == reason
    first = (tmp_path / "run" / "events.jsonl").read_text(encoding="utf-8").splitlines()[0]
    assert f"the loop is not simulated ahead: {reason}" in first


def fails(slave, *_):
    raise SlaveError(slave.name, "get_state", 0.0, "returned error")


def stays_where_it_is(slave, state, set_state=Slave.set_state):
    set_state(slave, slave.get_state())


@pytest.mark.full_but("restore nothing")
@pytest.mark.parametrize(
    ("function", "does", "told"),
    [
        ("get_state", fails, r"plant \(simulated ahead\): get_state at t = 0.000 s returned error"),
        ("set_state", fails, r"plant \(simulated ahead\): get_state at t = 0.000 s returned error"),
        (
            "set_state",
            stays_where_it_is,
            r"plant \(simulated ahead\): set_state leads to other outputs than .*",
        ),
    ],
    ids=["save", "restore", "restore nothing"],
)
def test_an_fmu_that_cannot_save_its_state_although_it_says_so_is_not_rolled_ahead_and_harms_no_run(
    pendulum, tmp_path, monkeypatch, function, does, told
):
    monkeypatch.setattr(f"cosim.slaves.slave.Slave.{function}", does)
    result = run(pendulum(CHANGED_EARLY, stop_time=0.5), "target", out=tmp_path / "run")
    assert result.status == "done"
    assert result.guard["written"] > 0
    events = (tmp_path / "run" / "events.jsonl").read_text().splitlines()
    vetoes = [line for line in events if '"veto"' in line]
    # Nothing is vetoed for want of a prediction, but where a disturbance may act as well.
    assert result.guard["vetoed"] == len(vetoes)
    assert all("a disturbance explains the samples as well" in v for v in vetoes)
    lines = [line for line in events if '"guard"' in line]
    assert len(lines) == 1
    assert re.search(f"the loop is not simulated ahead: {told}", lines[0]), lines
    assert re.fullmatch(told, result.guard["not_rolled_ahead"])


def test_an_fmu_that_is_replaced_in_mid_run_is_not_taken_for_the_one_that_runs(pendulum, tmp_path):
    scenario = pendulum(CHANGED_EARLY, stop_time=0.5)
    copy = tmp_path / "Controller.fmu"
    shutil.copy(fmu_paths(scenario)["controller"], copy)
    other = fmu_paths(scenario)["plant"]

    def replaced(t, held):
        if t == pytest.approx(0.05):
            shutil.copy(other, copy)

    (tmp_path / "run").mkdir()
    scenario = pendulum(CHANGED_EARLY | {"components.controller.fmu": f'"{copy}"'}, stop_time=0.5)
    result = run(scenario, "target", out=tmp_path / "run", progress=replaced)
    assert result.status == "done"
    assert result.guard["not_rolled_ahead"] == f"{copy} has changed since the run began"


UNITS = """
[scenario]
name = "swing"
stop_time = 0.5
macro_step = 0.01
isolation = "none"
[components]
plant = {{ fmu = "Pendulum", start = {{ phi = 0.5 }} }}
controller = {{ fmu = "PendulumController" }}
reference = {{ table = "{unit}.csv" }}
in_radians = {{ table = "rad.csv" }}
[connections]
"controller.phi" = "plant.phi"
"controller.phi_dot" = "plant.phi_dot"
"controller.phi_ref" = "reference.phi_ref"
"plant.u" = "controller.u"
[changes]
"plant.m" = [[0.0, 1.75], [0.1, 4.271]]
[tracking]
"plant.phi" = "in_radians.phi_ref"
[sampling.derivatives]
"plant.der(phi_dot)" = {{ noise = 1e-3 }}
[estimation]
model = "fmu_models.pendulum:derivative"
trigger = {{ kind = "innovation" }}
[[estimation.parameters]]
name = "m"
lower = 0.1
upper = 5.0
unit = "kg"
writes = "controller.m"
true = "plant.m"
[[estimation.parameters]]
name = "l"
lower = 0.1
upper = 2.0
unit = "m"
writes = "controller.l"
true = "plant.l"
"""


def test_units_are_converted_in_what_is_rolled_ahead_as_in_the_run(tmp_path, monkeypatch):
    peak, found = Lookahead.predicted_peak, {"deg": [], "rad": []}
    for unit, value in (("deg", "57.29577951308232"), ("rad", "1")):
        (tmp_path / f"{unit}.csv").write_text(f"time [s], phi_ref [{unit}]\n0, {value}\n9, {value}\n")
    for unit, peaks in found.items():
        path = tmp_path / f"swing_{unit}.toml"
        path.write_text(UNITS.format(unit=unit))
        monkeypatch.setattr(Lookahead, "predicted_peak", lambda *a, p=peaks: p.append(peak(*a)) or p[-1])
        assert run(Scenario.load(path), "target").status == "done"
    assert len(found["rad"]) > 1
    assert found["deg"] == pytest.approx(found["rad"], rel=1e-9)
