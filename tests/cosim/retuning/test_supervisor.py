"""From a sample to a write: the order of screen, retuner and guard, and the way back from an outlier.

The plant is y = theta . x, measured with SIGMA; the estimator is the least-squares solution of its window, by hand.
"""

from math import sqrt

import numpy as np
import pytest

from cosim.errors import ScenarioError
from cosim.retuning.data_support import DataSupport, NoDataSupport
from cosim.retuning.decision import Point
from cosim.retuning.guard import Guard
from cosim.retuning.supervisor import ReadBack, Supervisor
from cosim.sampling.screen import Screened
from cosim.scenarios.schema.guard import GuardSettings
from estimator import DerivativeResidual, Estimate, Parameter, ParameterSpace, Sample
from estimator.diagnosis.sample_diagnosis import Diagnosis
from estimator.diagnosis.settings import DiagnosisSettings
from estimator.effects.step_means import StepMeans
from estimator.retuning.factory import make_retuner
from estimator.retuning.proposal import Proposal
from estimator.retuning.search import Budget
from estimator.samples import RememberingModel
from estimator.triggers import InnovationSettings

SPACE = ParameterSpace((Parameter("a", 0.0, 10.0),))
START, CHANGED = np.array([2.0]), np.array([4.0])
SIGMA = 0.1
OUTLIER = 5.0


class Mean:
    """The mean of the window's samples, from the residual at zero."""

    is_whitened = True

    def __init__(self, log):
        self.log = log

    def restart(self, start):
        self.found = start

    def solve(self, objective):
        self.log.append("estimate")
        self.found = np.array([SIGMA * np.mean(objective.residual(np.zeros(1)))])

    def estimate(self):
        return Estimate(self.found, np.full(1, SIGMA), (True,), 0.0, 1, "mean")


class ScriptedScreen:
    """Screens samples as a script says, by communication point."""

    def __init__(self, log, **script):
        self.log, self.script = log, script

    def step(self, t, sample, theta):
        self.log.append(f"screen {theta[0]:g}")
        return self.script.get(f"at_{round(t * 100)}", Screened)(sample)

    def summary(self):
        return {"kept_out": 0}


def suspect(sample):
    return Screened(sample, is_suspect=True)


def kept_out(sample):
    return Screened(None)


def after_an_outlier(sample):
    return Screened(sample, was_outlier=True)


class Loop:
    """A supervisor, and a controller that takes what is written, unless it is deaf."""

    def __init__(self, model=lambda x, u, a: [a], rate=1.0, **script):
        self.log = []
        self.model = RememberingModel(model)
        residual = DerivativeResidual(self.model, SPACE, (0,), (SIGMA,))
        retuner = make_retuner(Mean(self.log), residual, InnovationSettings(), Budget(3), 1)
        support = DataSupport(residual.rows, SPACE, 1, 30)
        self.guard = Guard(GuardSettings(tolerance=0.5, rate=rate), SPACE, START, 100.0, support)
        screen = ScriptedScreen(self.log, **script)
        read_back = ReadBack(("controller.a",), (0,), np.ndarray.tolist)
        self.supervisor = Supervisor("mine", retuner, support, screen, self.guard, read_back, model=self.model)
        self.held = START

    def step(self, k, y, error=0.0, read=None):
        t = 0.01 * k
        sample = Sample(t, (1.0,), (), (y,))
        decision = self.supervisor.step(
            Point(k, t, sample, error, sample, [self.held[0] if read is None else read]), self.held
        )
        if decision.write is not None:
            self.held = decision.write
        return decision


def kinds(decision):
    return [event.kind for event in decision.events]


def test_a_changed_parameter_is_screened_estimated_and_written_in_this_order():
    loop = Loop()
    assert kinds(loop.step(1, 2.0)) == []
    decision = loop.step(2, 4.0)
    assert decision.write == pytest.approx(CHANGED)
    assert kinds(decision) == ["trigger", "candidate", "write"]
    assert decision.events[-1].detail["theta"] == decision.write.tolist()
    assert loop.log == ["screen 2", "screen 2", "estimate"]


def test_a_write_has_the_root_mean_square_error_of_what_is_written():
    """The mean is 4 +- 0.1, of which 3 is written: half of the way from 2."""
    *_, limit, write = Loop(rate=0.1).step(2, 4.0).events
    assert [limit.kind, write.kind] == ["limit", "write"]
    assert write.detail["theta"] == pytest.approx([3.0])
    assert write.detail["std"] == pytest.approx([sqrt(1.0**2 + 0.1**2)])
    assert write.detail["is_identifiable"] == [False]
    assert Loop().step(2, 4.0).events[-1].detail["std"] == [0.1]


def test_the_first_point_takes_no_sample():
    loop = Loop()
    assert loop.step(0, 9.0).write is None
    assert loop.log == []


def test_what_the_guard_refuses_is_not_announced_as_written():
    loop = Loop()
    decision = loop.step(1, 20.0)  # outside the bounds
    assert decision.write is None
    assert kinds(decision) == ["trigger", "candidate", "veto"]
    assert decision.estimate is not None


def test_a_write_for_an_outlier_is_taken_back_at_the_next_sample():
    loop = Loop(at_2=suspect, at_3=after_an_outlier)
    loop.step(1, 2.0)
    assert loop.step(2, OUTLIER).write == pytest.approx(OUTLIER)
    decision = loop.step(3, 2.0)
    assert decision.write.tolist() == START.tolist()
    assert [e.detail.get("reason") for e in decision.events] == ["the sample before was an outlier"]
    assert loop.supervisor.summary()["guard"]["retracted"] == 1
    assert loop.step(4, 2.0, error=9.0).write is None  # what was taken back is not on probation any more
    assert loop.supervisor.n_episodes == 1


def test_after_an_outlier_a_change_is_written_at_once():
    loop = Loop(at_2=suspect, at_3=after_an_outlier)
    loop.step(2, OUTLIER)
    decision = loop.step(3, 4.0)
    assert decision.write == pytest.approx(CHANGED)
    assert kinds(decision) == ["trigger", "candidate", "write"]


def test_an_outlier_for_which_nothing_was_written_leaves_the_guard_as_it_was():
    loop = Loop(at_2=suspect, at_3=after_an_outlier)
    loop.step(2, 20.0)  # vetoed
    assert loop.step(3, 2.0).write is None
    assert loop.supervisor.summary()["guard"]["retracted"] == 0


def test_what_is_undone_at_an_outlier_stays_so(monkeypatch):
    """At the outlier the diagnosis goes back to the parameters of the start: the next sample changes nothing."""
    loop = Loop(at_3=suspect, at_4=after_an_outlier)
    loop.step(1, 2.0)
    assert loop.step(2, 4.0).write == pytest.approx(CHANGED)
    with monkeypatch.context() as patch:
        patch.setattr(loop.supervisor._retuner, "step", lambda *_: Proposal(undo=START))
        assert loop.step(3, OUTLIER).write.tolist() == START.tolist()
    monkeypatch.setattr(loop.supervisor._retuner, "step", lambda *_: Proposal())
    assert loop.step(4, 4.0).write is None
    assert loop.held.tolist() == START.tolist()


def test_a_revert_is_not_undone_by_an_outlier_that_came_with_it():
    """At the outlier the write before it is taken back, for its tracking error: the next sample changes nothing."""
    loop = Loop(at_3=suspect, at_4=after_an_outlier)
    loop.step(2, 4.0)
    decision = loop.step(3, OUTLIER, error=1.2)  # so large that no sample keeps it
    assert (kinds(decision)[-1], decision.write.tolist()) == ("revert", START.tolist())
    assert loop.step(4, 4.0).write is None
    assert loop.held.tolist() == START.tolist()


def test_a_controller_that_does_not_hold_what_was_written_stops_re_tuning_before_the_sample_is_looked_at():
    loop = Loop()
    loop.step(2, 4.0)
    loop.log.clear()
    decision = loop.step(3, 7.0, read=2.0)
    assert (kinds(decision), decision.write) == (["stop"], None)
    assert loop.log == []
    assert loop.step(4, 7.0) == type(decision)()


def test_re_tuning_that_stops_where_an_outlier_is_taken_back_writes_nothing_more():
    loop = Loop(at_2=suspect, at_3=after_an_outlier)
    loop.step(2, OUTLIER)
    decision = loop.step(3, 2.0, read=2.0)
    assert (kinds(decision), decision.write) == (["stop"], None)
    assert loop.step(4, 9.0).write is None


def test_the_newest_samples_derivatives_are_computed_once_for_what_is_held():
    """Screen, trigger, window and guard all ask for them: the held parameters once, and the candidate once."""
    asked = []

    def model(x, u, a):
        asked.append((x[0], a))
        return [a]

    loop = Loop(model)
    residual = DerivativeResidual(loop.model, SPACE, (0,), (SIGMA,))
    loop.supervisor.step(Point(1, 0.01, sample := Sample(0.01, (3.0,), (), (2.0,)), 0.0, sample, [2.0]), START)
    assert asked == [(3.0, 2.0)]
    residual(START, sample)
    assert asked == [(3.0, 2.0)]
    residual(START, Sample(0.0, tuple([3.0]), (), (2.0,)))  # equal, but another sample
    assert len(asked) == 2


def test_the_input_of_a_sample_is_known_whatever_becomes_of_it():
    """An outlier waits for the next sound sample, one sample is late, and one ends a search."""

    def doubtful(sample):
        return Screened(sample, n_doubtful=1)

    residual = DerivativeResidual(lambda x, u, a: [a], SPACE, (0,), (SIGMA,))
    diagnosis = Diagnosis(residual, ("plant.der(x)",), DiagnosisSettings(), None)
    retuner = make_retuner(Mean([]), residual, InnovationSettings(), Budget(20), 5, diagnosis=diagnosis)
    script = {"at_5": suspect, "at_6": kept_out, "at_7": after_an_outlier, "at_9": kept_out, "at_12": doubtful}
    supervisor = Supervisor("mine", retuner, NoDataSupport(), ScriptedScreen([], **script))
    suspicious = []
    for k in range(1, 14):
        y = OUTLIER if k == 5 or k > 10 else 2.0
        sample = Sample(0.01 * k if k != 9 else 0.01, (1.0,), (float(k),), (y,))
        supervisor.step(Point(k, 0.01 * k, sample, 0.0), START)
        suspicious += [k] * diagnosis.is_suspicious
    inputs = diagnosis.snapshot().inputs
    assert suspicious == [5, 6, 11, 13]
    assert inputs._inputs == [(float(k),) for k in range(1, 14)]
    assert inputs._times == pytest.approx([0.01 * k for k in range(1, 14)])


def test_the_inputs_of_the_steps_are_known_where_samples_have_means_of_them():
    """At every point, whether there is a sample, one is kept out, or re-tuning goes on; a sample's own is none."""
    residual = DerivativeResidual(lambda x, u, a: [a], SPACE, (0,), (SIGMA,))
    means = StepMeans((0.5, 0.5), 0.01, 3)
    diagnosis = Diagnosis(residual, ("plant.der(x)",), DiagnosisSettings(), None, means=means)
    retuner = make_retuner(Mean([]), residual, InnovationSettings(), Budget(20), 5, diagnosis=diagnosis)
    supervisor = Supervisor("mine", retuner, NoDataSupport(), ScriptedScreen([], at_6=lambda _: Screened(None)))
    for k in range(14):
        sample = None if k % 3 or not k else Sample(0.01 * k - 0.01, (1.0,), (k - 0.5,), (2.0,))
        measured = Sample(0.01 * k, (1.0,), (float(k),), ())
        supervisor.step(Point(k, 0.01 * k, sample, 0.0, measured), START)
    inputs = diagnosis.snapshot().inputs
    assert inputs._inputs == [(float(k),) for k in range(1, 14)]
    assert inputs._sampled == pytest.approx([0.02, 0.08, 0.11])


def test_the_sample_that_ends_a_search_is_kept_as_it_was_screened():
    """For roll-outs: a bad value in it is NaN, and its time is that of the communication point."""

    class Suspending:
        kept = []
        suspend = staticmethod(lambda t, held, n: Proposal(undo=START))

        def keep_input(self, sample):
            self.kept.append(sample)

    screened = Sample(0.01, (1.0,), (5.0,), (), (np.nan,))
    screen = ScriptedScreen([], at_1=lambda _: Screened(screened, n_doubtful=40))
    supervisor = Supervisor("mine", Suspending(), NoDataSupport(), screen)
    decision = supervisor.step(Point(1, 0.01, Sample(0.0, (1.0,), (5.0,), (), (2.0,)), 0.0), CHANGED)
    assert decision.write.tolist() == START.tolist()
    assert Suspending.kept == [screened]


def test_a_model_that_raises_in_the_screen_is_a_fault_with_its_name():
    def fails(sample):
        raise KeyError("mine")

    with pytest.raises(ScenarioError, match=r"estimation.model failed at t = 0.010 s: KeyError: 'mine'."):
        Loop(at_1=fails).step(1, 2.0)


class Slope(Mean):
    """The least-squares solution for y = a x."""

    def solve(self, objective):
        at_zero, at_one = objective.residual(np.zeros(1)), objective.residual(np.ones(1))
        slope = at_one - at_zero
        self.found = np.clip([-slope @ at_zero / (slope @ slope)], 0.0, 10.0)


def test_a_search_that_fails_does_not_return_to_what_the_guard_has_reverted():
    """a changes to 4; from the 48th sample on a sine is added, which nothing explains, and the error grows."""
    model = RememberingModel(lambda x, u, a: [a * x[0]])
    residual = DerivativeResidual(model, SPACE, (0,), (SIGMA,))
    diagnosis = Diagnosis(residual, ("plant.der(x)",), DiagnosisSettings(), None)
    retuner = make_retuner(Slope([]), residual, InnovationSettings(), Budget(20), 5, diagnosis=diagnosis)
    support = DataSupport(diagnosis.residuals.rows, SPACE, 1, 30)
    guard = Guard(GuardSettings(tolerance=0.5, rate=1.0), SPACE, START, 100.0, support)
    supervisor = Supervisor("mine", retuner, support, None, guard, model=model)
    held, rng, told = START, np.random.default_rng(0), []
    for k in range(1, 300):
        x = 1.0 + k % 3
        added = 30.0 * np.sin(0.3 * k) if k >= 48 else 0.0
        y = (2.0 if k < 40 else 4.0) * x + added + SIGMA * rng.standard_normal()
        sample = Sample(0.01 * k, (x,), (), (y,))
        error = 5.0 if k == 48 else 0.0
        decision = supervisor.step(Point(k, sample.t, sample, error, sample, [held[0]]), held)
        told += [(k, kind) for kind in kinds(decision) if kind in ("write", "revert", "unexplained", "undo")]
        held = held if decision.write is None else decision.write
        assert k < 48 or held.tolist() == START.tolist()
    before = {kind for k, kind in told if k < 48}
    assert before == {"write"}
    assert [kind for k, kind in told if k == 48] == ["revert"]
    assert {kind for k, kind in told if k > 48} == {"unexplained"}


@pytest.mark.parametrize(("returned", "told"), [([], "IndexError: .*"), (None, "TypeError: .*"), ({}, "KeyError: 0")])
def test_a_model_that_fails_in_a_search_is_told_as_the_model(returned, told):
    """And not as the estimator, which has called it: at the parameters in force it has a value."""
    residual = DerivativeResidual(lambda x, u, a: [a] if a == START[0] else returned, SPACE, (0,), (SIGMA,))
    retuner = make_retuner(Mean([]), residual, InnovationSettings(), Budget(3), 1)
    supervisor = Supervisor("mine", retuner, DataSupport(residual.rows, SPACE, 1, 30))
    with pytest.raises(ScenarioError, match=rf"^estimation\.model failed at t = 0.010 s: {told}"):
        supervisor.step(Point(1, 0.01, Sample(0.01, (1.0,), (), (9.0,)), 0.0), START)


def test_an_estimator_that_raises_is_a_fault_with_its_name():
    class Broken(Mean):
        def solve(self, objective):
            raise SystemExit(3)

    residual = DerivativeResidual(lambda x, u, a: [a], SPACE, (0,), (SIGMA,))
    retuner = make_retuner(Broken([]), residual, InnovationSettings(), Budget(3), 1)
    broken = Supervisor("mine", retuner, DataSupport(residual.rows, SPACE, 1, 30))
    with pytest.raises(ScenarioError, match=r"estimator 'mine' failed at t = 0.010 s: SystemExit: 3."):
        broken.step(Point(1, 0.01, Sample(0.01, (1.0,), (), (9.0,)), 0.0), START)
