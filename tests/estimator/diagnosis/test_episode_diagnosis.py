"""Diagnosis of sequences in the loop, on a linear system that is simulated exactly: the test is the controller."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from estimator import EpisodeWindow, Evaluation, Parameter, ParameterSpace, Sample, TargetVector
from estimator.baselines.solvers import LeastSquares
from estimator.diagnosis.episode_diagnosis import EpisodeDiagnosis
from estimator.diagnosis.settings import PASSED, DiagnosisSettings
from estimator.episode_window import Tracked
from estimator.retuning.factory import make_episodes
from estimator.retuning.search import Budget
from estimator.triggers import InnovationSettings

SPACE = ParameterSpace((Parameter("a", 0.5, 0.98), Parameter("b", 0.1, 2.0)))
TRUE, CHANGED = np.array([0.9, 0.5]), np.array([0.8, 0.9])
SIGMA = np.array([0.01, 0.02])
STARTS = {"target": TargetVector, "least-squares": LeastSquares}
SEARCHES = pytest.mark.parametrize("estimator", STARTS)
PUSH = 0.3
LENGTH = 20
UNKNOWN = Tracked(np.empty(0), np.empty(0))  # as where a simulation begins, or has failed


def after(x, u, theta, moment=0.0):
    """The next state of x0' = a x0 + b u, x1' = 0.7 x1 + 0.5 x0 + 1e4 moment: the plant and its model."""
    return np.array([theta[0] * x[0] + theta[1] * u, 0.7 * x[1] + 0.5 * x[0] + 1e4 * moment])


class Simulated:
    """Objective that simulates a sequence from its first, known state; the outputs are both states."""

    is_ready = is_of_outputs = True

    def add_sample(self, sample):
        self.newest = sample

    def snapshot(self, is_needed):
        return self.newest.x

    def evaluate(self, thetas, stretch):
        return [self.one(theta, stretch) for theta in thetas]

    def one(self, theta, stretch):
        x, rows = np.array(stretch.origin), []
        for sample in stretch.samples[1:]:
            x = after(x, sample.u[0], theta, *sample.u[1:])
            rows.append(np.nan_to_num((x - sample.y) / SIGMA))
        rows = np.array(rows)
        return Evaluation(rows.T.reshape(-1), None, np.sum(rows**2, axis=1))

    def track(self, theta, stretch):
        return self.one(theta, stretch).residual

    def revert(self, theta): ...

    def move_inputs(self, moved, stretch): ...

    def accept(self, theta, stretch):
        pass

    def describe(self):
        return "simulated"


@dataclass
class Run:
    """A loop, its plant and its controller, which writes what nothing else explains."""

    estimator: str = "target"
    noise: float = 1.0  # in declared standard deviations
    correlation: float = 0.0  # of the noise, from sample to sample
    missing: float = 0.0  # share of the measurements
    every: int = 0  # samples from one measurement to the next of a slow sensor of y1 alone; none: both at each
    slow: int = 1  # samples from one measurement of y1 to the next, beside y0
    factor: float = 1.0  # of the noise of y0
    seed: int = 0
    settings: DiagnosisSettings = field(default_factory=DiagnosisSettings)
    inputs: tuple[str, ...] = ("u",)
    is_bold: bool = False  # also writes what a disturbance would explain, as the guard does where it is safe
    jumps: bool = True  # whether parameters that the diagnosis has found end a search
    objective: Simulated = field(default_factory=Simulated)
    events: list = field(default_factory=list)
    writes: list = field(default_factory=list)
    undone: list = field(default_factory=list)
    unsure: list = field(default_factory=list)
    if_noise: list = field(default_factory=list)  # what holds if it is noise, of each proposal

    def __post_init__(self):
        self.rng = np.random.default_rng(self.seed)
        self.window = window = EpisodeWindow(self.objective, LENGTH)
        self.diagnosis = EpisodeDiagnosis(window, ("y0", "y1"), self.inputs, self.settings, SPACE)
        search = STARTS[self.estimator](SPACE, TRUE, np.random.default_rng(self.seed + 1))
        trigger, describe = InnovationSettings(), Simulated().describe
        self.retuner = make_episodes(
            search, window, trigger, Budget(24, 6), describe, diagnosis=self.diagnosis, jumps=self.jumps
        )
        self.held, self.k, self.x, self.last = TRUE, 0, np.zeros(2), np.zeros(2)

    def go(self, n, truth=TRUE, push=0.0, drive=None, moment=0.0):
        """Take n samples; push: added to the input unseen, a value or a function of the sample's number; drive: the
        input, where it is constant; moment: of the plant alone."""
        for i in range(n):
            u = float(np.sin(0.35 * self.k) + 0.6 * np.sign(np.sin(0.11 * self.k))) if drive is None else drive
            if self.k:
                self.x = after(self.x, u + (push(i) if callable(push) else push), truth, moment)
            rho, new = self.correlation, self.noise * SIGMA * self.rng.standard_normal(2) * [self.factor, 1.0]
            self.last = rho * self.last + np.sqrt(1.0 - rho**2) * new
            y = self.x + self.last
            if self.missing:
                y[self.rng.random(2) < self.missing] = np.nan
            if self.every:
                y = np.array([np.nan, np.nan if self.k % self.every else y[1]])
            if self.k % self.slow:
                y[1] = np.nan
            inputs = (u, 0.0)[: len(self.inputs)] or (u,)
            self.take(Sample(0.1 * self.k, tuple(self.x.tolist()), inputs, (), tuple(y.tolist())))
        return self

    def take(self, sample):
        proposal = self.retuner.step(sample.t, sample, 0.0, self.held)
        self.events += [(self.k, event) for event in proposal.events]
        if proposal.theta is not None:
            self.if_noise.append(proposal.if_noise)
        if proposal.possible_disturbance is not None:
            self.unsure.append((self.k, proposal.possible_disturbance))
        if proposal.possible_disturbance is not None and not self.is_bold:
            pass
        elif proposal.theta is not None:
            self.held = proposal.theta
            self.writes.append((self.k, proposal.theta))
        if proposal.undo is not None:
            self.held = proposal.undo
            self.undone.append(self.k)
        self.k += 1

    def of(self, *kinds):
        return [(k, event) for k, event in self.events if event.kind in kinds]


def near(theta, truth, share=0.02):
    """Whether theta is that share of the scaled bounds from the truth, at most."""
    return bool(np.abs(SPACE.to_unit(theta) - SPACE.to_unit(truth)).max() < share)


def sine(i):
    return 1.5 * np.sin(0.9 * i)


def test_nothing_begins_while_the_parameters_in_force_explain_everything():
    run = Run("least-squares").go(5000)
    assert (run.retuner.n_episodes, run.events, run.writes) == (0, [], [])


def test_one_sample_that_contradicts_begins_nothing_and_two_do():
    """It may have an isolated value, which only the next one tells."""
    for n, begins in ((1, False), (2, True)):
        run = Run().go(105).go(n, push=4.0)
        assert ("trigger" in [event.kind for _, event in run.events]) == begins


@pytest.mark.parametrize("seed", range(3))
def test_nothing_happens_where_isolated_values_are_corrected(seed):
    """Each is corrected as the next sample comes, as by the screen; the plant and its parameters stay the same."""
    run = Run(seed=seed)
    for k in range(300):
        run.go(1)
        if k % 20 == 10:
            newest = run.window.newest
            run.window._recent[-1] = Sample(newest.t, newest.x, newest.u, (), (newest.y[0] + 50.0, newest.y[1]))
            run.diagnosis.reason(lambda *_: "", run.window.newest, 0.0, run.held)
            run.retuner.correct(Sample(newest.t, newest.x, newest.u, (), (float("nan"), newest.y[1])))
    assert run.events == []


@SEARCHES
def test_changed_parameters_are_written_once_a_window_is_full(estimator):
    run = Run(estimator).go(100).go(60, CHANGED)
    assert 100 < run.writes[0][0] <= 100 + LENGTH
    assert near(run.held, CHANGED)
    assert run.of("disturbance", "unexplained", "rest", "undo") == []
    assert run.retuner.n_episodes == 1


def test_the_evidence_on_record_is_for_what_has_happened():
    changed = Run("least-squares").go(100).go(60, CHANGED)
    pushed = Run("least-squares").go(100).go(60, push=PUSH)
    for run, won in ((changed, "parameters"), (pushed, "disturbance")):
        *_, (_, last) = run.of("evidence")
        assert min(last.detail["scores"], key=last.detail["scores"].get) == won
        assert won in last.detail["explained"]


def test_parameters_that_the_comparison_has_found_end_the_search_at_once():
    """It has simulated them anyway; without them the search goes on over several steps, and writes on its way."""
    at_once, searched = (Run(jumps=jumps).go(100).go(5 * LENGTH, CHANGED) for jumps in (True, False))
    for run, n_writes in ((at_once, 1), (searched, 2)):
        assert [event.detail["episode"] for _, event in run.of("end")] == [1]
        assert len(run.writes) >= n_writes
        assert near(run.held, CHANGED)
    assert len(at_once.writes) == 1
    assert at_once.of("end")[0][1].detail["reason"] == "parameters that explain the samples"
    assert at_once.writes[0][0] < searched.writes[-1][0]
    assert at_once.retuner.n_model_calls < searched.retuner.n_model_calls
    assert near(at_once.go(3 * LENGTH, TRUE).held, TRUE)  # the search has ended, and the next one begins


def test_the_uncertainty_of_what_the_comparison_has_found_is_the_cramer_rao_bound():
    """Sensitivities by differentiating the recursion of `after`, not by differences of simulations."""
    run = Run().go(100)
    while not run.writes:
        run.go(1, CHANGED)
    ((_, end),) = run.of("end")
    x, to_a, to_b, information = np.array(run.window.sequence.origin), np.zeros(2), np.zeros(2), np.zeros((2, 2))
    a, b = end.detail["theta"]
    for sample in run.window.sequence.samples[1:]:
        u = sample.u[0]
        to_a = np.array([x[0] + a * to_a[0], 0.7 * to_a[1] + 0.5 * to_a[0]])
        to_b = np.array([u + a * to_b[0], 0.7 * to_b[1] + 0.5 * to_b[0]])
        x = after(x, u, (a, b))
        rows = np.column_stack([to_a, to_b]) / SIGMA[:, None]
        information += rows.T @ rows
    assert_allclose(end.detail["std"], np.sqrt(np.linalg.inv(information).diagonal()), rtol=0.01)


@pytest.mark.parametrize("seed", range(5))
def test_changed_parameters_are_found_whatever_the_noise(seed):
    run = Run("least-squares", seed=seed).go(60 + 7 * seed).go(60, CHANGED)
    assert near(run.held, CHANGED)
    assert run.of("disturbance", "unexplained", "rest", "undo") == []


@SEARCHES
@pytest.mark.parametrize("seed", range(5))
def test_a_change_far_above_coloured_noise_is_found_whatever_that_leaves_unexplained(estimator, seed):
    """Four declared deviations, by which the end of the first search is unexplained; noise is as large from then on."""
    run = Run(estimator, noise=4.0, correlation=0.9, seed=seed).go(LENGTH + 8, CHANGED)
    assert near(run.held, CHANGED, 0.1)
    assert run.of("disturbance", "unexplained", "rest", "undo") == []
    scales = [channel["scale"] for channel in run.diagnosis.summary()["channels"].values()]
    assert 1.5 < max(scales) < 8.0


@SEARCHES
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("n_quiet", "size", "rests_at"),
    [(0, 1.0, TRUE), (0, 0.1, CHANGED), (100, 1.0, CHANGED)],
    ids=["at once", "far better", "lasted"],
)
def test_a_rest_is_not_at_parameters_that_only_adopted_noise_spoke_for(estimator, seed, n_quiet, size, rests_at):
    """Unless they have explained a window's samples since, or the sequence far better than those before."""
    run = Run(estimator, noise=4.0, correlation=0.9, seed=seed).go(LENGTH + 8 + n_quiet, CHANGED)
    run.go(160, CHANGED, lambda i: size * sine(i))
    assert len(run.of("rest")) == 1
    assert near(run.held, rests_at, 0.1)


@pytest.mark.parametrize("seed", range(5))
def test_what_comes_and_goes_leaves_the_parameters_from_before_it(seed):
    """Those are in force again, not others near them that a search on the samples after it finds."""
    run = Run("least-squares", seed=seed).go(60 + 7 * seed).go(60, CHANGED).go(60, TRUE)
    assert run.held.tolist() == TRUE.tolist()
    assert run.of("disturbance", "unexplained", "rest") == []
    assert len(run.undone) == 1


def test_a_search_on_samples_that_turn_out_to_be_doubtful_ends_and_is_undone():
    run = Run("target", jumps=False).go(100)
    assert run.retuner.suspend(10.0, run.held, 20) is None
    while not run.writes:
        run.go(1, CHANGED)
    proposal = run.retuner.suspend(13.0, run.held, 20)
    assert_array_equal(proposal.undo, TRUE)
    run.held = TRUE
    sample = Sample(0.1 * run.k, (0.0, 0.0), (0.5,), (), (0.0, 0.0))
    run.retuner.keep_input(sample)  # of which a later simulation needs the input
    assert run.window.newest is sample
    assert run.retuner.suspend(13.1, TRUE, 20) is None
    run.go(80, CHANGED)
    assert near(run.held, CHANGED)


def test_what_was_written_on_samples_that_turn_out_to_be_doubtful_is_undone_though_its_search_has_ended():
    """While the sensor has failed nothing would show that it was wrong; what more samples speak for stays."""
    run = Run("target", every=5).go(100).go(45, CHANGED)
    wrong = run.held
    assert near(wrong, CHANGED)
    assert len(run.of("trigger")) == len(run.of("end"))
    assert run.retuner.suspend(12.5, wrong, 3) is None
    assert_array_equal(run.retuner.suspend(12.5, wrong, 100).undo, TRUE)
    assert run.retuner.suspend(12.5, TRUE, 100) is None
    right = Run("target").go(100).go(LENGTH + 5, CHANGED)
    assert right.retuner.suspend(12.5, right.held, 200) is None  # forty values speak for it


def test_what_is_undone_for_doubtful_samples_is_undone_in_histories_too():
    """A roll-out from the start would have the plant's parameters wrong for a while."""
    run = Run("target", every=5).go(100).go(45, CHANGED)
    reverted = []
    run.objective.revert = lambda theta: reverted.append(theta.tolist())
    run.retuner.suspend(12.5, run.held, 100)
    assert reverted == [TRUE.tolist()]


def test_doubtful_samples_bring_nothing_back_that_the_guard_has_reverted():
    run = Run("target").go(100)
    run.held = CHANGED
    run.go(2)
    run.held = TRUE
    run.retuner.reverted(TRUE)
    run.go(2)
    found = run.retuner.suspend(10.4, TRUE, 3)  # CHANGED was in force before these
    assert found is None or found.undo is None


@pytest.mark.parametrize("estimator", ["target", "least-squares"])
def test_a_value_that_turns_out_to_be_wrong_as_the_window_fills_ends_no_search(estimator):
    """As many values are compared with as before: a surrogate has those of the candidates so far."""
    run = Run(estimator, jumps=False).go(100)
    while run.window.sequence is None:
        run.go(1, CHANGED)
    newest = run.window.newest
    run.retuner.correct(replace(newest, y=(np.nan, newest.y[1])))
    run.go(60, CHANGED)
    assert near(run.held, CHANGED)


@pytest.mark.parametrize("slow", [1, 3, 10])
def test_a_larger_noise_is_known_beside_a_slow_sensor(slow):
    run = Run(slow=slow).go(60)
    run.factor = 5.0
    run.go(140)
    assert run.diagnosis.summary()["channels"]["y0"]["scale"] == pytest.approx(5.0, rel=0.35)
    assert run.of("rest") == []


def test_samples_of_which_nothing_was_measured_do_not_show_that_something_has_passed():
    run = Run().go(60).go(30, push=lambda i: 0.4 * np.sin(0.8 * i)).go(10)
    assert run.of("unexplained")
    run.every = 10**6
    run.go(60)
    assert run.of("disturbance") == []
    run.every = 0
    run.go(60)
    assert len(run.of("disturbance")) == 1


@SEARCHES
def test_a_disturbance_of_the_input_is_named_with_its_size_and_its_end(estimator):
    run = Run(estimator).go(100).go(100, TRUE, PUSH)
    ((named, event),) = run.of("disturbance")
    assert named <= 100 + LENGTH + 4
    assert_allclose(event.detail["size"]["u"], PUSH, rtol=0.1)
    assert_allclose(run.diagnosis.summary()["inputs"]["u"], PUSH, rtol=0.1)
    run.go(100)
    (_, (over, event)) = run.of("disturbance")
    assert (event.detail["size"], event.detail["reason"]) == ({}, "the disturbance is over")
    assert over <= 200 + LENGTH + 4
    assert run.diagnosis.summary()["inputs"]["u"] == 0.0
    assert run.of("unexplained", "rest") == []


@SEARCHES
def test_of_two_disturbances_in_different_units_one_goes_on_when_the_other_is_over(estimator):
    """The moment is a thousandth of a thousandth of what the force is, and its input is zero until then."""
    moment = 2e-5
    run = Run(estimator, inputs=("u", "moment")).go(100).go(100, TRUE, PUSH, moment=moment)
    assert_allclose(list(run.diagnosis.summary()["inputs"].values()), [PUSH, moment], rtol=0.1)
    run.go(100, TRUE, moment=moment)
    assert_allclose(run.diagnosis.summary()["inputs"]["moment"], moment, rtol=0.1)
    assert abs(run.diagnosis.summary()["inputs"]["u"]) < 0.1 * PUSH
    assert all(event.detail["size"] for _, event in run.of("disturbance"))
    run.go(100)
    assert run.diagnosis.summary()["inputs"] == {"u": 0.0, "moment": 0.0}


@SEARCHES
def test_what_a_disturbance_explains_is_not_written_in_the_end(estimator):
    run = Run(estimator).go(100).go(100, TRUE, PUSH)
    assert_array_equal(run.held, TRUE)
    assert bool(run.writes) == bool(run.undone)
    reasons = {event.detail["reason"] for _, event in run.of("undo")}
    assert reasons <= {"a constant disturbance of the inputs explains the samples, changed parameters do not"}


@SEARCHES
@pytest.mark.parametrize("truth", [np.array([0.9, 0.8]), TRUE], ids=["parameters", "push"])
def test_what_cannot_be_told_apart_is_judged_on_more_samples(estimator, truth):
    """At a constant input a larger gain b is a push: both move b u by 0.3; what tells them apart comes later."""
    run = Run(estimator).go(100, drive=1.0)
    push = 0.0 if truth is not TRUE else 0.6  # b u = 0.5 (1 + 0.6) = 0.8
    run.go(LENGTH + 6, truth, push, drive=1.0)
    assert run.writes == []
    run.go(3 * LENGTH, truth, push)
    extended = [event for _, event in run.of("trigger") if "fewer samples" in event.detail["reason"]]
    assert extended[0].detail["samples"].startswith(f"the last {2 * LENGTH},")
    assert near(run.held, truth)
    assert bool(run.of("disturbance")) == bool(push)


@SEARCHES
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("truth", [np.array([0.9, 0.8]), TRUE], ids=["parameters", "push"])
def test_what_was_written_for_a_disturbance_is_undone_once_the_next_search_tells(estimator, truth, seed):
    """Both explain the first samples; of the later ones, what was found then explains only what it was."""
    run = Run(estimator, seed=seed, is_bold=True).go(100, drive=1.0)
    push = 0.0 if truth is not TRUE else 0.6
    run.go(2 * LENGTH, truth, push, drive=1.0)
    assert run.unsure
    assert not near(run.held, TRUE)
    run.go(4 * LENGTH, truth, push)
    assert near(run.held, truth)
    assert bool(run.undone) == bool(push)
    sizes = [event.detail["size"]["u"] for _, event in run.of("disturbance")]
    assert sizes == ([pytest.approx(push, abs=0.03)] if push else [])
    assert run.of("unexplained", "rest") == []


@SEARCHES
def test_a_disturbance_that_is_known_begins_no_other_episode(estimator):
    run = Run(estimator).go(100).go(100, TRUE, PUSH)
    assert run.retuner.n_episodes == 1


@SEARCHES
def test_parameters_that_change_while_a_disturbance_acts_are_found(estimator):
    run = Run(estimator).go(100).go(100, TRUE, PUSH).go(80, CHANGED, PUSH)
    assert near(run.held, CHANGED)
    assert_allclose(run.diagnosis.summary()["inputs"]["u"], PUSH, rtol=0.1)


@SEARCHES
def test_a_model_that_lacks_a_sine_rests_after_three_failed_searches(estimator):
    run = Run(estimator).go(100).go(400, TRUE, sine)
    assert len(run.of("unexplained")) == 3
    ((k, event),) = run.of("rest")
    assert event.detail["channels"] == ["y0", "y1"]
    assert_array_equal(run.held, TRUE)
    assert run.retuner.n_episodes == 3
    assert not [event for n, event in run.events if n > k]
    summary = run.diagnosis.summary()
    assert (summary["unexplained"], summary["rest"]) == (3, 1)
    assert all(row["is_resting"] for row in summary["channels"].values())


@SEARCHES
def test_a_push_that_nothing_has_explained_is_named_when_it_has_passed(estimator):
    """Half a sine of the force: 0.64 of its height in the mean."""
    run = Run(estimator).go(100).go(LENGTH, TRUE, lambda i: np.sin(np.pi * i / LENGTH))
    assert run.of("disturbance") == []
    run.go(3 * LENGTH)
    assert len(run.of("unexplained")) == 1
    ((k, event),) = run.of("disturbance")
    assert k >= 100 + 2 * LENGTH
    assert 0.2 < event.detail["size"]["u"] < 1.0
    assert (event.detail["is_known"], event.detail["reason"]) == (False, PASSED)
    assert run.diagnosis.summary()["inputs"]["u"] == 0.0
    assert run.diagnosis.summary()["disturbance"] == 1
    run.go(200)
    assert len(run.of("disturbance")) == 1


@SEARCHES
@pytest.mark.parametrize("seed", range(3))
def test_the_search_after_one_in_vain_is_on_samples_after_it(estimator, seed):
    """A push that ends soon after the first window: what is left of it is not taken for changed parameters."""
    length = LENGTH + LENGTH // 5
    run = Run(estimator, seed=seed).go(100).go(length, TRUE, lambda i: 1.0 - np.cos(2.0 * np.pi * i / length))
    run.go(5 * LENGTH)
    (first, _), *_ = run.of("unexplained")
    later = [event.detail["samples"] for k, event in run.of("trigger") if k > first]
    assert later
    assert all(text == f"the next {LENGTH}" for text in later)
    assert_array_equal(run.held, TRUE)
    assert run.writes == []


@SEARCHES
@pytest.mark.parametrize("seed", range(3))
def test_a_rest_ends_and_what_it_was_for_is_named_when_that_has_passed(estimator, seed):
    """As long after it as it had lasted; the change that follows is found."""
    run = Run(estimator, seed=seed).go(100).go(6 * LENGTH, TRUE, sine)
    ((began, _),) = run.of("rest")
    run.go(20 * LENGTH)
    ((k, event),) = run.of("disturbance")
    assert (event.detail["is_known"], event.detail["reason"]) == (False, PASSED)
    assert 2 * (began - 100) < k - 100 < 15 * LENGTH
    assert near(run.go(3 * LENGTH, CHANGED).held, CHANGED)


@SEARCHES
def test_a_change_during_a_search_is_not_named_a_disturbance_once_it_is_found(estimator):
    run = Run(estimator).go(100).go(LENGTH // 2, CHANGED).go(120, np.array([0.6, 1.5]))
    assert near(run.held, [0.6, 1.5])
    assert run.of("unexplained")
    assert run.of("disturbance") == []


@SEARCHES
def test_nothing_is_said_to_have_passed_in_a_rest_or_while_it_acts(estimator):
    run = Run(estimator, settings=DiagnosisSettings(rest=200)).go(100).go(400, TRUE, sine)
    assert run.of("rest")
    assert run.of("disturbance") == []


@SEARCHES
@pytest.mark.parametrize("is_reverted", [False, True], ids=["written", "reverted to"])
def test_a_failed_search_returns_to_what_lasted_where_that_explains_more(estimator, is_reverted):
    """Parameters that were written while something came and went are not what the next search goes back to.

    Unless it was the guard that went back to them.
    """
    run = Run(estimator).go(100)
    for i in range(60):
        run.go(1, TRUE, sine(i))
        if run.of("unexplained"):
            break
    if is_reverted:
        run.retuner.reverted(CHANGED)
    run.held = CHANGED
    run.go(60, TRUE, sine)
    assert_array_equal(run.held, CHANGED if is_reverted else TRUE)
    reasons = {event.detail["reason"] for _, event in run.of("undo")}
    assert reasons == (set() if is_reverted else {"no parameters explain y0, y1"})


def test_after_a_rest_changed_parameters_are_found_again():
    settings = DiagnosisSettings(rest=100, longest_rest=100)
    run = Run("least-squares", settings=settings).go(100).go(80, TRUE, sine)
    assert len(run.of("rest")) == 1
    run.go(200).go(60, CHANGED)
    assert near(run.held, CHANGED)


@SEARCHES
@pytest.mark.parametrize("seed", range(4))
def test_noise_much_larger_than_declared_is_known_after_a_search_or_two(estimator, seed):
    run = Run(estimator, noise=10.0, seed=seed).go(200)
    assert run.of("disturbance", "rest") == []
    assert len(run.of("unexplained")) <= 1
    assert run.retuner.n_episodes <= 2
    assert_allclose(run.diagnosis._state.scale.values, 10.0, rtol=0.5)
    assert_array_equal(run.held, TRUE)
    run.go(80, CHANGED)
    assert near(run.held, CHANGED, 0.2)


@pytest.mark.parametrize(("noise", "missing"), [(2.0, 0.0), (10.0, 0.0), (2.0, 0.4)])
def test_noise_larger_than_declared_is_learnt_within_two_rests(noise, missing):
    settings = DiagnosisSettings(rest=100, longest_rest=100)
    run = Run("least-squares", noise=noise, missing=missing, settings=settings).go(1200)
    assert_allclose(run.diagnosis._state.scale.values, noise, rtol=0.3)
    assert len(run.of("rest")) <= 2
    assert near(run.held, TRUE, 0.1)
    run.go(80, CHANGED)
    assert near(run.held, CHANGED, 0.1)


@pytest.mark.parametrize("seed", range(4))
def test_what_passes_for_the_second_time_is_noise_if_it_is_small_enough(seed):
    """Six to twelve standard deviations; a third time it contradicts nothing. Larger ones are named each time."""
    small, large = (lambda i, size=size: size * np.sin(0.9 * i) for size in (0.12, 1.5))
    run = Run("least-squares", seed=seed).go(100).go(LENGTH, push=small).go(60).go(LENGTH, push=small).go(60)
    assert len(run.of("disturbance")) == 1
    assert max(channel["scale"] for channel in run.diagnosis.summary()["channels"].values()) > 3.0
    n = len(run.events)
    assert len(run.go(LENGTH, push=small).go(60).events) == n
    run = Run("least-squares", seed=seed).go(100).go(LENGTH, push=large).go(60).go(LENGTH, push=large).go(60)
    assert len(run.of("disturbance")) == 2
    assert {channel["scale"] for channel in run.diagnosis.summary()["channels"].values()} == {1.0}


def test_what_noise_of_ten_times_the_size_would_explain_says_so():
    """The guard predicts it in the plant of before, too; not so a change that is larger than that."""
    small = lambda i: 0.05 * np.sin(0.9 * i)  # noqa: E731
    doubtful = [Run("least-squares", seed=seed).go(100).go(LENGTH, push=small).go(60).if_noise for seed in range(5)]
    assert sum(map(len, doubtful)) >= 2
    assert all(theta is not None for found in doubtful for theta in found)
    changed = Run("least-squares").go(100).go(60, CHANGED)
    assert changed.if_noise
    assert all(theta is None for theta in changed.if_noise)


@pytest.mark.parametrize("noise", [1.25, 0.1])
def test_noise_that_is_nearly_as_declared_needs_nothing(noise):
    run = Run("least-squares", noise=noise).go(1000)
    assert run.of("rest", "unexplained", "disturbance") == []
    run.go(60, CHANGED)
    assert near(run.held, CHANGED)


def test_the_disturbance_that_may_act_is_least_squares_of_a_linear_system():
    """The outputs are linear in the input, so that one step of differences finds NumPy's least squares."""
    run, found = Run("least-squares").go(100), []
    search = run.diagnosis._disturbed
    run.diagnosis._disturbed = lambda held: found.append((run.diagnosis._window.sequence, search(held))) or found[-1][1]
    run.go(60, TRUE, PUSH)
    sequence, disturbed = found[-1]
    x = x_aside = np.array(sequence.origin)
    rows, slopes = [], []
    for sample in sequence.samples[1:]:
        x, x_aside = after(x, sample.u[0], TRUE), after(x_aside, sample.u[0] + 1.0, TRUE)
        rows.append((sample.y - x) / SIGMA)
        slopes.append((x_aside - x) / SIGMA)
    rows, slopes = np.array(rows).reshape(-1), np.array(slopes).reshape(-1, 1)
    best = np.linalg.lstsq(slopes, rows, rcond=None)[0]
    assert_allclose(disturbed.inputs, best, rtol=1e-6)
    assert_allclose(disturbed.fit.squares, np.sum((rows - slopes @ best) ** 2), rtol=1e-6)


def test_a_truth_beyond_the_bounds_leaves_the_parameters_within():
    run = Run("least-squares").go(60).go(100, np.array([0.8, 2.6]))
    assert all(p.contains(v) for _, theta in run.writes for p, v in zip(SPACE, theta, strict=True))
    assert all(p.contains(v) for p, v in zip(SPACE, run.held, strict=True))


@SEARCHES
def test_samples_without_a_value_stop_nothing(estimator):
    run = Run(estimator).go(60)
    for _ in range(3):
        run.take(Sample(0.1 * run.k, tuple(run.x.tolist()), (0.0,), (), (np.nan, 0.0)))
    run.go(100).go(80, CHANGED)
    assert all(np.all(np.isfinite(theta)) for _, theta in run.writes)
    assert near(run.held, CHANGED)


@SEARCHES
def test_a_change_of_a_hundredth_is_found_though_most_measurements_are_missing(estimator):
    """As a residual of zero each of these would make the others look smaller: none was found then."""
    runs = [Run(estimator, seed=seed, missing=0.8).go(400).go(600, np.array([0.9, 0.505])) for seed in range(3)]
    assert all(len(run.writes) >= 1 for run in runs)
    assert all(abs(run.held[1] - 0.505) < 0.0035 for run in runs)


@pytest.mark.parametrize("every", [5, 10])
@SEARCHES
def test_a_slow_sensor_alone_does_not_take_what_the_model_lacks_for_parameters(estimator, every):
    run = Run(estimator, every=every).go(400).go(500, TRUE, sine)
    assert near(run.held, TRUE)
    assert len(run.writes) <= 1
    change = Run(estimator, every=every).go(400).go(400, CHANGED)
    assert near(change.held, CHANGED)


def test_the_size_of_the_residuals_in_a_rest_is_known_after_it_whatever_its_last_sample_had():
    """That a simulation has none, as where it begins or has failed, is no reason to forget the others."""
    settings = DiagnosisSettings(rest=100, longest_rest=100)
    run = Run("least-squares", settings=settings).go(100).go(80, TRUE, sine)
    state, track = run.diagnosis._state, run.window.track
    run.go(state.rests_until - state.n_samples - 2, TRUE, sine)
    run.window.track = lambda theta: UNKNOWN
    run.go(1, TRUE, sine)
    run.window.track = track
    assert state.n_samples == state.rests_until - 1
    assert np.all(state.scale.values > 2.0)


@pytest.mark.parametrize("ends", ["outgrown", "calm"])
def test_what_a_rest_was_for_is_not_taken_for_noise_by_the_next_one(ends):
    """Residuals grow from 6 to 200 standard deviations, or have been 50 and are noise again; then another rest."""
    run = Run("least-squares").go(10)
    state, rest, rng = run.diagnosis._state, run.diagnosis._rest, np.random.default_rng(5)
    state.n_failures, state.restless_since = 3, state.n_samples
    rest.begin(0.0)
    for i in range(400):
        noise = rng.standard_normal(2)
        size = 6.0 * noise + 200.0 * (i >= 60) if ends == "outgrown" else noise + 50.0 * np.sin(i) * (i < 100)
        state.n_samples += 1
        rest.take(size)
        if not rest.is_on:
            break
    assert not rest.is_on
    before = state.scale.values
    assert np.all(before < 10.0)
    rest.begin(1.0)
    assert_array_equal(state.scale.values, before)


def test_samples_without_a_value_in_a_rest_are_not_learnt_from():
    settings = DiagnosisSettings(rest=100, longest_rest=100)
    run = Run("least-squares", settings=settings).go(100).go(80, TRUE, sine)
    assert len(run.of("rest")) == 1
    run.take(Sample(0.1 * run.k, tuple(run.x.tolist()), (0.0,), (), (np.nan, 0.0)))
    run.go(150).go(80, CHANGED)
    assert np.all(np.isfinite(run.diagnosis._state.scale.values))
    assert near(run.held, CHANGED)


def test_a_plant_without_inputs_has_no_disturbance():
    run = Run("least-squares", inputs=())
    run.go(60).go(60, TRUE, sine)
    assert run.of("disturbance") == []
    assert run.of("unexplained") != []


class Failing(Simulated):
    """Fails where b is above a limit, or a above another: as a root of a negative number in a user's function."""

    def __init__(self, a, b):
        self.limit = np.array([a, b])

    def one(self, theta, stretch):
        return Evaluation(np.array([np.nan]), "failed") if np.any(theta > self.limit) else super().one(theta, stretch)


@pytest.mark.parametrize("seed", range(6))
@SEARCHES
def test_candidates_beside_ones_that_fail_end_no_run(estimator, seed):
    """The truth lies where they do, so that the search ends at the edge and the diagnosis looks beyond it."""
    run = Run(estimator, seed=seed, objective=Failing(0.98, 0.7)).go(60).go(120, CHANGED)
    assert run.retuner.n_episodes > 0
    assert np.all(np.isfinite(run.held))


def test_nothing_begins_in_a_rest_though_no_simulation_succeeds():
    run = Run().go(30)
    state, sample = run.diagnosis._state, Sample(3.0, (0.0, 0.0), (0.0,), (), (0.0, 0.0))
    state.rests_until, run.window.track = state.n_samples + 50, lambda theta: UNKNOWN
    reasons = [run.diagnosis.reason(lambda *a: "tracking", sample, 1.0, TRUE) for _ in range(60)]
    assert reasons == [None] * 49 + ["tracking"] * 11
