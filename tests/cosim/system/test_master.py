"""The master and the loop above it on stub slaves: the order of calls as text, and closed forms of linear loops."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import cosim.runs.simulation
from cosim.errors import SlaveError, WiringError
from cosim.system.master import Master, Wiring


def text(values):
    return "None" if values is None else "[" + ", ".join(f"{v:g}" for v in values) + "]"


class Stub:
    """A slave made of a function: outputs at t + h = step(inputs, t, h, tunables); every call is written down."""

    def __init__(self, name, calls, first, step):
        self.name, self._calls, self._outputs, self._function = name, calls, first, step

    def _note(self, call):
        self._calls.append(f"{self.name}.{call}")

    def bind(self, inputs, tunables, outputs):
        self._note(f"bind(inputs={list(inputs)}, tunables={list(tunables)}, outputs={list(outputs)})")

    def initialize(self, start, start_time, stop_time):
        self._note(f"initialize({dict(start)}, {start_time:g}, {stop_time:g})")

    def get(self):
        self._note("get()")
        return self._outputs

    def begin_step(self, inputs, t, h, tunables):
        self._note(f"begin_step(inputs={text(inputs)}, t={t:g}, h={h:g}, tunables={text(tunables)})")
        self._pending = inputs, t, h, tunables

    def end_step(self):
        self._note(f"end_step() at t={self._pending[1]:g}")
        self._outputs = self._function(*self._pending)
        return self._outputs

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._note("close()")


WIRING = {
    "plant": Wiring({"u": "controller.u"}, ("m",), ("x",), {"x": 1.0}),
    "controller": Wiring({"x": "plant.x", "r": "reference.r"}, ("m",), ("u",), {}),
    "reference": Wiring({}, (), ("r",), {}),
}
"""Wired in another order than they step, so that names and places cannot be mixed up unnoticed."""
SEQUENTIAL = [["controller"], ["plant", "reference"]]
PARALLEL = [["plant", "controller", "reference"]]


def loop(groups, calls, wiring=WIRING):
    """x' = x + u, u = 10 (r - x), r counts up from 7."""

    class Sum(Stub):
        def end_step(self):
            super().end_step()
            self._outputs = [self._x + self._pending[0][0]]
            self._x = self._outputs[0]
            return self._outputs

    plant = Sum("plant", calls, [1.0], lambda *_: None)
    plant._x = 1.0
    return Master(
        {
            "plant": plant,
            "controller": Stub("controller", calls, [0.5], lambda u, *_: [10.0 * (u[1] - u[0])]),
            "reference": Stub("reference", calls, [7.0], lambda u, t, h, p: [8.0 + t]),
        },
        wiring,
        groups,
    )


def test_every_fmu_is_bound_before_one_is_initialised_and_all_are_before_one_is_read():
    calls = []
    master = loop(SEQUENTIAL, calls)
    master.initialize(0.0, 10.0)
    assert calls == [
        "plant.bind(inputs=['u'], tunables=['m'], outputs=['x'])",
        "controller.bind(inputs=['x', 'r'], tunables=['m'], outputs=['u'])",
        "reference.bind(inputs=[], tunables=[], outputs=['r'])",
        "plant.initialize({'x': 1.0}, 0, 10)",
        "controller.initialize({}, 0, 10)",
        "reference.initialize({}, 0, 10)",
        "plant.get()",
        "controller.get()",
        "reference.get()",
    ]
    assert master.names == ("plant.x", "controller.u", "reference.r")
    assert master.values == [1.0, 0.5, 7.0]


def test_sequential_coupling_steps_the_controller_and_gives_its_output_to_the_plant_at_once():
    calls = []
    master = loop(SEQUENTIAL, calls)
    master.initialize(0.0, 10.0)
    del calls[:]
    master.begin(0.0, 1.0, {"controller": [2.0], "plant": [3.0]})
    assert master.values == [1.0, 60.0, 7.0]  # all of t = 0
    master.finish(0.0, 1.0, {"controller": [2.0], "plant": [3.0]})
    assert master.values == [61.0, 60.0, 8.0]
    master.begin(1.0, 1.0, {})
    master.finish(1.0, 1.0, {})
    assert calls == [
        "controller.begin_step(inputs=[1, 7], t=0, h=1, tunables=[2])",
        "controller.end_step() at t=0",
        "plant.begin_step(inputs=[60], t=0, h=1, tunables=[3])",
        "reference.begin_step(inputs=[], t=0, h=1, tunables=None)",
        "plant.end_step() at t=0",
        "reference.end_step() at t=0",
        "controller.begin_step(inputs=[61, 8], t=1, h=1, tunables=None)",
        "controller.end_step() at t=1",
        "plant.begin_step(inputs=[-530], t=1, h=1, tunables=None)",
        "reference.begin_step(inputs=[], t=1, h=1, tunables=None)",
        "plant.end_step() at t=1",
        "reference.end_step() at t=1",
    ]


def test_parallel_coupling_steps_all_at_once_with_the_controllers_output_of_the_step_before():
    calls = []
    master = loop(PARALLEL, calls)
    master.initialize(0.0, 10.0)
    del calls[:]
    for k in range(2):
        master.begin(float(k), 1.0, {})
        master.finish(float(k), 1.0, {})
    assert calls == [
        "plant.begin_step(inputs=[0.5], t=0, h=1, tunables=None)",
        "controller.begin_step(inputs=[1, 7], t=0, h=1, tunables=None)",
        "reference.begin_step(inputs=[], t=0, h=1, tunables=None)",
        "plant.end_step() at t=0",
        "controller.end_step() at t=0",
        "reference.end_step() at t=0",
        "plant.begin_step(inputs=[60], t=1, h=1, tunables=None)",
        "controller.begin_step(inputs=[1.5, 8], t=1, h=1, tunables=None)",
        "reference.begin_step(inputs=[], t=1, h=1, tunables=None)",
        "plant.end_step() at t=1",
        "controller.end_step() at t=1",
        "reference.end_step() at t=1",
    ]


def test_a_disturbance_is_an_input_after_the_connected_ones_and_holds_until_it_is_set_again():
    calls = []
    master = loop(PARALLEL, calls, WIRING | {"plant": replace(WIRING["plant"], disturbances=("push", "pull"))})
    master.initialize(0.0, 10.0)
    assert calls[0] == "plant.bind(inputs=['u', 'push', 'pull'], tunables=['m'], outputs=['x'])"
    master.disturb({"plant": [3.0, 4.0]})
    for k in range(3):
        if k == 2:
            master.disturb({"plant": [5.0, 6.0]})
        master.begin(float(k), 1.0, {})
        master.finish(float(k), 1.0, {})
        assert master.inputs["plant"].keys() == {"u"}
    assert [call.partition(", t=")[0] for call in calls if call.startswith("plant.begin_step")] == [
        "plant.begin_step(inputs=[0.5, 3, 4]",
        "plant.begin_step(inputs=[60, 3, 4]",
        "plant.begin_step(inputs=[65, 5, 6]",
    ]


class InInitializationMode(Stub):
    """A memoryless slave that can be read before it is initialised: outputs = step(inputs)."""

    def enter_initialization(self, start, start_time, stop_time):
        self._note("enter")

    def propagate(self, inputs):
        self._note(f"propagate({text(inputs)})")
        if inputs is not None:
            self._outputs = self._function(inputs, 0.0, 0.0, None)
        return self._outputs

    def exit_initialization(self):
        self._note("exit")


def test_initial_outputs_reach_the_end_of_the_longest_chain_within_initialization_mode():
    calls = []
    slaves = {
        "end": InInitializationMode("end", calls, [0.0], lambda u, t, h, p: [u[0] + 1.0]),
        "middle": InInitializationMode("middle", calls, [0.0], lambda u, t, h, p: [2.0 * u[0]]),
        "begin": InInitializationMode("begin", calls, [5.0], lambda u, t, h, p: [5.0]),
    }
    wiring = {
        "end": Wiring({"u": "middle.y"}, (), ("y",), {}),
        "middle": Wiring({"u": "begin.y"}, (), ("y",), {}),
        "begin": Wiring({}, (), ("y",), {}),
    }
    master = Master(slaves, wiring, [list(slaves)])
    master.initialize(0.0, 1.0, is_propagated=True)
    assert master.values == [11.0, 10.0, 5.0]
    assert calls[3:9] == [
        "end.enter", "middle.enter", "begin.enter", "end.propagate(None)", "middle.propagate(None)",
        "begin.propagate(None)",
    ]  # fmt: skip
    assert calls[9:12] == ["end.propagate([0])", "middle.propagate([5])", "begin.propagate([])"]
    assert calls[12:15] == ["end.propagate([10])", "middle.propagate([5])", "begin.propagate([])"]
    assert calls[-6:] == ["end.exit", "middle.exit", "begin.exit", "end.get()", "middle.get()", "begin.get()"]


def test_the_inputs_of_the_last_step_are_kept_by_name():
    master = loop(SEQUENTIAL, [])
    master.initialize(0.0, 10.0)
    assert master.inputs == {}
    master.begin(0.0, 1.0, {})
    master.finish(0.0, 1.0, {})
    assert master.inputs == {"plant": {"u": 60.0}, "controller": {"x": 1.0, "r": 7.0}, "reference": {}}


def test_a_source_that_is_no_output_is_a_wiring_error():
    wiring = WIRING | {"plant": Wiring({"u": "controller.v"}, (), ("x",), {})}
    with pytest.raises(WiringError, match=r"^plant: no output 'controller\.v' to take an input from\.$"):
        loop(SEQUENTIAL, [], wiring)


# A linear loop: double integrator under u = -k1 x - k2 v, input held over h.

H, GAINS, X0, U0 = 0.1, np.array([2.0, 1.5]), np.array([1.0, -0.5]), 0.25
A, B = np.array([[1.0, H], [0.0, 1.0]]), np.array([H * H / 2.0, H])


def linear_loop(groups, n_steps):
    class Plant(Stub):
        x = X0

        def end_step(self):
            super().end_step()
            self.x = A @ self.x + B * self._pending[0][0]
            return list(self.x)

    slaves = {
        "plant": Plant("plant", [], list(X0), lambda *_: None),
        "controller": Stub("controller", [], [U0], lambda x, *_: [float(-GAINS @ np.array(x))]),
    }
    wiring = {
        "plant": Wiring({"u": "controller.u"}, (), ("x", "v"), {}),
        "controller": Wiring({"x": "plant.x", "v": "plant.v"}, (), ("u",), {}),
    }
    master = Master(slaves, wiring, groups)
    master.initialize(0.0, 10.0)
    for k in range(n_steps):
        master.begin(k * H, H, {})
        master.finish(k * H, H, {})
    return master.values[:2]


def test_a_sequential_loop_is_the_matrix_power_of_the_undelayed_loop():
    expected = np.linalg.matrix_power(A - np.outer(B, GAINS), 10) @ X0
    assert linear_loop([["controller"], ["plant"]], 10) == pytest.approx(list(expected), rel=1e-12)


def test_a_parallel_loop_is_the_matrix_power_of_the_loop_one_step_late():
    delayed = np.block([[A, B[:, None]], [-GAINS[None, :], np.zeros((1, 1))]])  # of (x_k, u_{k-1})
    expected = np.linalg.matrix_power(delayed, 10) @ np.append(X0, U0)
    undelayed = np.linalg.matrix_power(A - np.outer(B, GAINS), 10) @ X0
    assert linear_loop([["plant", "controller"]], 10) == pytest.approx(list(expected[:2]), rel=1e-12)
    assert abs(expected[0] - undelayed[0]) > 1e-4  # the two could be told apart


# The whole exchange of a run, with stubs in place of the pendulum's FMUs.


def variable(name, causality="output", start=None, derivative=None, unit="1"):
    return SimpleNamespace(
        name=name, causality=causality, type="Real", valueReference=0,
        variability="tunable" if causality == "parameter" else "continuous", start=start, unit=unit, min=None, max=None,
        derivative=derivative, declaredType=None,
    )  # fmt: skip


def described(stub, *variables):
    described = {"modelVariables": list(variables), "unitDefinitions": [], "coSimulation": SimpleNamespace()}
    stub.description = SimpleNamespace(**described)
    return stub


def stubs(calls, fail_at=math.inf):
    held = [1.75, 0.75]

    def plant(inputs, t, h, tunables):
        if t >= fail_at:
            raise SlaveError("plant", "do_step", t, "returned discard")
        held[:] = tunables or held
        return [inputs[0], 100.0 * t, 0.25, inputs[0], *held]  # phi, phi_dot, der(phi_dot), u_held, m, l

    phi, phi_dot = variable("phi", start="1"), variable("phi_dot", start="0")
    return {
        "plant": described(
            Stub("plant", calls, [1.0, 0.0, 0.5, 0.0], plant),
            variable("m", "parameter", "1.75", unit="kg"),
            variable("l", "parameter", "0.75", unit="m"),
            variable("u", "input", "0"),
            phi,
            phi_dot,
            variable("der(phi)", "local", derivative=phi),
            variable("der(phi_dot)", derivative=phi_dot),
            variable("u_held"),
        ),
        "controller": described(
            Stub("controller", calls, [0.0], lambda i, *_: [i[0] + 1.0]),
            variable("m", "parameter", "1.75", unit="kg"),
            variable("l", "parameter", "0.75", unit="m"),
            variable("phi", "input", "0"),
            variable("phi_dot", "input", "0"),
            variable("phi_ref", "input", "0"),
            variable("phi_dot_ref", "input", "0"),
            variable("u"),
        ),
        "reference": described(
            Stub("reference", calls, [2.0, 0.0], lambda *_: [2.0, 0.0]), variable("phi_ref"), variable("phi_dot_ref")
        ),
    }


@pytest.fixture
def run_on_stubs(monkeypatch, pendulum):
    """Runs the pendulum scenario for three steps on stubs; returns the calls and the run."""

    def run(estimator, overrides, fail_at=math.inf):
        calls = []
        slaves = stubs(calls, fail_at)
        scenario = pendulum(overrides, stop_time=0.03)
        monkeypatch.setattr(cosim.runs.simulation, "open_slave", lambda path, name, **_: slaves[name])
        monkeypatch.setattr(
            cosim.runs.simulation, "fmu_paths", lambda scenario: dict.fromkeys(scenario.components, Path())
        )

        def progress(t, held):
            calls.append(f"progress at t={t:g}, m={held['m']:g}")

        return calls, cosim.runs.simulation.run(scenario, estimator, progress=progress)

    return run


CHANGES = {'changes."plant.m"': "[[0.0, 1.75], [0.02, 4.0]]", 'changes."plant.l"': "0.75"}


def test_a_run_exchanges_in_the_order_of_the_design_and_sets_parameters_only_where_they_change(run_on_stubs):
    calls, _ = run_on_stubs("true", CHANGES)
    n_before = calls.index("reference.get()") + 1
    assert calls[n_before:] == [
        "controller.begin_step(inputs=[1, 0, 2, 0], t=0, h=0.01, tunables=[1.75, 0.75])",
        "controller.end_step() at t=0",
        "plant.begin_step(inputs=[2], t=0, h=0.01, tunables=[1.75, 0.75])",
        "reference.begin_step(inputs=[], t=0, h=0.01, tunables=None)",
        "plant.end_step() at t=0",
        "reference.end_step() at t=0",
        "progress at t=0, m=1.75",
        "controller.begin_step(inputs=[2, 0, 2, 0], t=0.01, h=0.01, tunables=None)",
        "controller.end_step() at t=0.01",
        "plant.begin_step(inputs=[3], t=0.01, h=0.01, tunables=None)",
        "reference.begin_step(inputs=[], t=0.01, h=0.01, tunables=None)",
        "plant.end_step() at t=0.01",
        "reference.end_step() at t=0.01",
        "progress at t=0.01, m=1.75",
        "controller.begin_step(inputs=[3, 1, 2, 0], t=0.02, h=0.01, tunables=[4, 0.75])",
        "controller.end_step() at t=0.02",
        "plant.begin_step(inputs=[4], t=0.02, h=0.01, tunables=[4, 0.75])",
        "reference.begin_step(inputs=[], t=0.02, h=0.01, tunables=None)",
        "plant.end_step() at t=0.02",
        "reference.end_step() at t=0.02",
        "progress at t=0.02, m=4",
        "progress at t=0.03, m=4",
        "reference.close()",
        "controller.close()",
        "plant.close()",
    ]


def test_a_run_in_parallel_steps_all_at_once_and_the_input_is_one_step_late(run_on_stubs):
    calls, _ = run_on_stubs("none", CHANGES | {"scenario.coupling": "parallel"})
    steps = [call for call in calls if "begin_step" in call or "end_step" in call]
    assert steps[:6] == [
        "plant.begin_step(inputs=[0], t=0, h=0.01, tunables=[1.75, 0.75])",
        "controller.begin_step(inputs=[1, 0, 2, 0], t=0, h=0.01, tunables=[1.75, 0.75])",
        "reference.begin_step(inputs=[], t=0, h=0.01, tunables=None)",
        "plant.end_step() at t=0",
        "controller.end_step() at t=0",
        "reference.end_step() at t=0",
    ]
    assert steps[6] == "plant.begin_step(inputs=[2], t=0.01, h=0.01, tunables=None)"


def test_a_row_holds_what_belongs_to_its_time(run_on_stubs):
    _, run = run_on_stubs("none", CHANGES)
    rows = {name: run[name].tolist() for name in ("time", "plant.phi", "controller.u", "plant.u_held", "plant.m")}
    assert rows == {
        "time": [0.0, 0.01, 0.02, 0.03],
        "plant.phi": [1.0, 2.0, 3.0, 4.0],
        "controller.u": [2.0, 3.0, 4.0, 4.0],  # the law at each time; after the last there is no step
        "plant.u_held": [0.0, 2.0, 3.0, 4.0],
        "plant.m": [1.75, 1.75, 4.0, 4.0],
    }


def test_a_fault_keeps_the_rows_up_to_the_step_that_failed_and_closes_every_fmu(run_on_stubs):
    calls, run = run_on_stubs("none", CHANGES, fail_at=0.015)
    assert (run.status, run.error) == ("faulted", "plant: do_step at t = 0.020 s returned discard")
    assert run.time.tolist() == [0.0, 0.01, 0.02]
    assert calls[-3:] == ["reference.close()", "controller.close()", "plant.close()"]


@pytest.mark.parametrize(
    ("t", "formula"),
    [(0.0, "1/t"), (0.02, "1.75 if t < 0.015 else 1/(t - t)"), (0.02, "1.75 if t < 0.015 else log(-t)")],
)
def test_a_change_without_a_value_does_not_escape_as_an_arithmetic_error(run_on_stubs, t, formula):
    try:
        _, run = run_on_stubs("none", CHANGES | {'changes."plant.m"': formula})
    except cosim.CosimError as refused:
        assert "plant.m" in str(refused)
    else:
        assert run.status == "faulted"
        assert "plant.m" in run.error
        assert run.time[-1] <= t
