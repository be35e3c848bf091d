"""Roll-outs on the way to their processes: together, and each for itself where one of them fails."""

from contextlib import contextmanager
from dataclasses import replace

import pytest

from cosim.errors import SlaveError
from cosim.fmi.trial_batch import TrialLeg, TrialOutputs
from cosim.objectives.rollout_plan import Leg, Plan
from cosim.objectives.rollout_pool import Outcome, Pool

LEG = TrialLeg([0.0, 1.0, 2.0], [[0.0], [0.0]])


class StubSlave:
    """A slave whose outputs are its tunable; "gone" ends its process, "odd" fails in time; "killed" is, by others."""

    n_killed = 1
    """Times that "killed" will be, in all slaves."""

    def __init__(self, log, is_single=False):
        self.log, self.is_closed = log, False
        self.is_single = is_single  # whether its process can have it once only

    def answer(self, gain):
        if gain == "gone":
            raise SlaveError("shadow", "trials", None, "the process has gone")
        if gain == "killed" and StubSlave.n_killed > 0:
            StubSlave.n_killed -= 1
            raise SlaveError("shadow", "trials", None, "the FMU's process was ended by SIGKILL")
        if gain == "odd":
            raise SlaveError("shadow", "do_step", 1.0, "odd")
        return [(gain,), (gain,)]

    def trials(self, batch, start):
        gains = [trial.legs[-1][1] for trial in batch.trials]
        self.log.append(gains)
        if self.is_single and batch.state is None and len(gains) > 1:
            return TrialOutputs([self.answer(gains[0])], SlaveError("shadow", "instantiate", None, "no second one"))
        if "gone" in gains:
            self.answer("gone")
        n = gains.index("odd") if "odd" in gains else len(gains)
        fault = SlaveError("shadow", "do_step", 1.0, "odd") if n < len(gains) else None
        return TrialOutputs([self.answer(gain) for gain in gains[:n]], fault)

    def many_steps(self, times, inputs, tunables):
        self.log.append(tunables)
        self.gain = self.gain if tunables is None else tunables
        return self.answer(self.gain)[: len(inputs)]

    def initialize(self, *_):
        pass

    set_state = initialize

    def close(self):
        self.is_closed = True


@contextmanager
def pool(log, jobs=1, is_warm=True):
    with Pool(lambda: StubSlave(log), jobs, True) as pool:
        if is_warm:  # so that a message may have some hundred steps
            for _ in range(4):
                pool.simulate([plan(0.0)] * 64)
        log.clear()
        yield pool


def plan(gain):
    return Plan({}, 0.0, 10.0, b"state", (), Leg(LEG.times, LEG.inputs, gain))


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_batch_of_candidates_is_one_message_a_process(jobs):
    log = []
    with pool(log, jobs) as warm:
        assert warm.simulate([plan(i) for i in range(10)]) == [Outcome([(i,), (i,)]) for i in range(10)]
    assert sorted(log) == ([list(range(10))] if jobs == 1 else [[0, 1, 2, 3, 4], [5, 6, 7, 8, 9]])


def test_one_that_fails_is_told_and_the_others_are_simulated_all_the_same():
    log = []
    with pool(log) as warm:
        outcomes = warm.simulate([plan(gain) for gain in (1.0, "odd", 2.0, "gone", 3.0)])
    assert [o.result for o in outcomes] == [[(1.0,)] * 2, None, [(2.0,)] * 2, None, [(3.0,)] * 2]
    assert outcomes[1].reason == "shadow: do_step at t = 1.000 s odd"
    assert "the process has gone" in outcomes[3].reason


@pytest.mark.parametrize(("n_kills", "result"), [(2, [("killed",)] * 2), (9, None)])
def test_one_that_was_killed_from_outside_is_simulated_once_more(monkeypatch, n_kills, result):
    log = []
    with pool(log) as warm:
        monkeypatch.setattr(StubSlave, "n_killed", n_kills)
        outcomes = warm.simulate([plan(gain) for gain in (1.0, "killed", 2.0)])
    assert [o.result for o in outcomes] == [[(1.0,)] * 2, result, [(2.0,)] * 2]


def test_an_fmu_that_its_process_can_have_once_only_gets_a_new_one_for_each_roll_out():
    """As pythonfmu 0.7.0 cannot, where the FMU's class is in a module of its own, though it declares that it can."""
    log, slaves = [], []

    def opened():
        slaves.append(StubSlave(log, is_single=True))
        return slaves[-1]

    with Pool(opened, 1, True) as pool:
        for _ in range(2):
            outcomes = pool.simulate([replace(plan(gain), state=None) for gain in (1.0, 2.0, 3.0)] * 20)
            assert [o.result for o in outcomes] == [[(gain,)] * 2 for gain in (1.0, 2.0, 3.0)] * 20
    assert len(slaves) >= 60 + 57
    assert all(slave.is_closed for slave in slaves)


def test_the_first_messages_are_short_whatever_a_step_takes():
    log = []
    with pool(log, is_warm=False) as cold:
        assert cold.simulate([plan(4.0)]) == [Outcome([(4.0,), (4.0,)])]
    assert log == [4.0, None]  # a step each
