"""Roll-outs over a log begin in the state at the window's beginning, not at the start again."""

import numpy as np
import pytest
from scipy.signal import cont2discrete

from benchmarks.native_fmus import FOREIGN, build_c
from cosim.objectives.rollout_plan import History
from cosim.offline.online import run_online
from cosim.offline.request import Request, Sought
from cosim.slaves.slave import Slave
from estimator import Sample

pytestmark = pytest.mark.fmu
STEP = 0.02  # s
STATES = 'canGetAndSetFMUstate="true" canSerializeFMUstate="true"'


def log_of_a_jump(path, seconds, at):
    """Position of m s'' = f - 8 s - s' as CSV; the mass is 2 kg, as in the FMU, from `at` [s] on 3 kg."""
    n = round(seconds / STEP)
    t = np.arange(n + 1) * STEP
    f = 3.0 * np.sign(np.sin(2.3 * t))
    x = np.zeros((n + 1, 2))
    for i in range(n):
        m = 2.0 if t[i] < at else 3.0
        continuous = (np.array([[0.0, 1.0], [-8.0 / m, -1.0 / m]]), np.array([[0.0], [1.0 / m]]))
        a, b, *_ = cont2discrete((*continuous, np.eye(2), np.zeros((2, 1))), STEP)
        x[i + 1] = a @ x[i] + b[:, 0] * f[i]
    s = x[:, 0] + 1e-3 * np.random.default_rng(0).standard_normal(n + 1)
    np.savetxt(path, np.column_stack([t, f, s]), "%.9g", ",", header="time,f,s", comments="")
    return path


def n_steps(batch):
    """Number of steps in a message of several simulations."""
    return sum(len(batch.legs[place].inputs) for trial in batch.trials for place, _ in trial.legs)


@pytest.fixture
def watched(tmp_path, monkeypatch):
    """watched(attributes, seconds, edit): the replay of a log, and the number of steps that it took."""
    counts = []
    many_steps, trials = Slave.many_steps, Slave.trials
    monkeypatch.setattr(
        Slave, "many_steps", lambda self, t, u, p=None: counts.append(len(u)) or many_steps(self, t, u, p)
    )

    monkeypatch.setattr(
        Slave, "trials", lambda self, batch, starts: counts.append(n_steps(batch)) or trials(self, batch, starts)
    )

    def watch(attributes, seconds=6.0, at=3.0, source=FOREIGN / "Axis.c"):
        counts.clear()
        text = (FOREIGN / "Axis.xml").read_text().replace("<CoSimulation ", f"<CoSimulation {attributes} ")
        request = Request(
            build_c(source, text, tmp_path / "Axis.fmu"), (log_of_a_jump(tmp_path / "log.csv", seconds, at),),
            (Sought("mass.m", 0.5, 20.0),), {"mass.s": "s"}, {"f": "f"}, evaluations=15,
        )  # fmt: skip
        return run_online(request, 30).watched[0], sum(counts)

    return watch


@pytest.mark.full
def test_the_result_is_that_from_the_start(watched):
    """The FMU that saves its state is asked for a third of the steps."""
    (again, n_again), (saved, n_saved) = watched(""), watched(STATES)
    assert saved.n_candidates == again.n_candidates > 0
    assert saved.theta == pytest.approx(again.theta, rel=1e-9)
    assert [(e.t, e.kind) for e in saved.events] == [(e.t, e.kind) for e in again.events]
    assert n_saved < n_again / 3


@pytest.mark.full
def test_the_cost_does_not_grow_with_the_log(watched):
    """Each sample is simulated once with the parameters in use, once to save the state; a candidate has its window."""
    (short, n_short), (long, n_long) = watched(STATES, 6.0, 3.0), watched(STATES, 12.0, 9.0)
    per_candidate = [(n - 2 * seconds / STEP) / one.n_candidates
                     for n, seconds, one in ((n_short, 6.0, short), (n_long, 12.0, long))]  # fmt: skip
    assert per_candidate[1] < 1.5 * per_candidate[0]


@pytest.mark.full
def test_an_fmu_that_does_not_restore_what_it_says_is_simulated_from_the_start(watched, tmp_path):
    source = tmp_path / "Lying.c"
    lie = "#define memcpy(a, b, n) (memcpy(a, b, n), (void)(((n) == sizeof(Model)) && (((Model *)(a))->v[S] = 0.0)))\n"
    text = (FOREIGN / "Axis.c").read_text()
    source.write_text(text.replace('#include "fmi_model.h"', "#include <string.h>\n" + lie + '#include "fmi_model.h"'))
    honest, _ = watched("")
    lying, _ = watched(STATES, source=source)
    assert lying.theta == pytest.approx(honest.theta, rel=1e-9)


@pytest.mark.parametrize("place", range(9))
def test_legs_from_a_place_on_are_the_rest_of_those_from_the_start(place):
    """Each step with the parameters accepted for it, whether the state on the way has them or a leg sets them."""
    history = History(0.0, (2.0,))
    for k in range(8):
        history.add_sample(Sample(k + 1.0, (), (float(k),), ()))
    history.accept(2, (3.0,))
    history.accept(5, (4.0,))

    def held(legs, theta=(2.0,)):
        steps = []
        for leg in legs:
            theta = leg.tunables or theta
            steps += [(t, u, theta) for t, u in zip(leg.times[:-1], leg.inputs, strict=True)]
        return steps

    before = held(history.legs(place))
    assert before + held(history.legs(8, place), before[-1][2] if before else (2.0,)) == held(history.legs(8))
