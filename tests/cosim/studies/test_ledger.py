"""The ledger: states, leases, losses, and what a process that dies leaves in it."""

import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.errors import FolderError
from cosim.studies.ledger import LEDGER, MOST_LOSSES, open_ledger

RUNS = [(f"k{i}", {"scenario": "s", "point": i, "seed": 0, "estimator": "none"}) for i in range(3)]


@pytest.fixture
def ledger():
    with open_ledger(":memory:") as opened:
        opened.plan(RUNS)
        yield opened


def counts(ledger):
    return {state: n for state, n in ledger.counts().items() if n}


def test_a_run_is_queued_leased_and_done(ledger):
    assert ledger.queued() == ["k0", "k1", "k2"]
    lease = ledger.lease("k1")
    assert counts(ledger) == {"queued": 2, "leased": 1}
    assert ledger.finish("k1", lease, {"mse": 1.5}, {"whole": True}, is_done=True)
    assert counts(ledger) == {"queued": 2, "done": 1}
    assert [(e.key, e.state, e.result) for e in ledger.entries()][1] == ("k1", "done", {"mse": 1.5})
    assert list(ledger.records()) == [{"whole": True}]


def test_a_run_that_failed_is_a_result_and_is_not_tried_again(ledger):
    ledger.finish("k0", ledger.lease("k0"), {"status": "diverged"}, None, is_done=False)
    ledger.plan(RUNS)
    assert ledger.queued() == ["k1", "k2"]


def test_what_comes_late_from_a_worker_that_was_given_up_is_dropped(ledger):
    first = ledger.lease("k0")
    ledger.lose("k0", first, "killed")
    second = ledger.lease("k0")
    assert second == first + 1
    assert not ledger.finish("k0", first, {"mse": 1.0}, None, is_done=True)
    assert counts(ledger) == {"queued": 2, "leased": 1}
    assert ledger.finish("k0", second, {"mse": 2.0}, None, is_done=True)
    assert not ledger.finish("k0", second, {"mse": 3.0}, None, is_done=True)  # nor what comes twice
    assert next(ledger.entries()).result == {"mse": 2.0}


def test_a_run_whose_worker_dies_is_tried_again_three_times_and_then_lost(ledger):
    states = [ledger.lose("k0", ledger.lease("k0"), f"death {k}") for k in range(1 + MOST_LOSSES)]
    assert states == ["queued"] * 3 + ["lost"]
    assert ledger.queued() == ["k1", "k2"]
    assert ledger.reasons() == [("death 3", 1)]


def test_a_run_that_is_leased_cannot_be_leased_again(ledger):
    ledger.lease("k0")
    with pytest.raises(FolderError, match="not queued"):
        ledger.lease("k0")


def test_the_end_of_the_head_is_no_loss(ledger):
    for _ in range(10):
        ledger.lease("k0")
        ledger.plan(RUNS)  # as the next process does
    assert ledger.lose("k0", ledger.lease("k0"), "killed") == "queued"


def test_an_extended_study_keeps_what_is_done_and_leaves_out_what_it_no_longer_has(ledger):
    ledger.finish("k2", ledger.lease("k2"), {"mse": 1.0}, None, is_done=True)
    ledger.plan([("new", RUNS[0][1]), RUNS[2]])
    assert ledger.queued() == ["new"]
    assert [e.key for e in ledger.entries()] == ["new", "k2"]
    ledger.plan(RUNS)
    assert counts(ledger) == {"queued": 2, "done": 1}


def test_what_was_refused_or_lost_is_tried_anew_once_nothing_else_is_left(ledger):
    ledger.refuse("k0", ledger.lease("k0"), "no such estimator")
    ledger.retry()
    assert counts(ledger) == {"queued": 2, "refused": 1}
    for key in ("k1", "k2"):
        ledger.finish(key, ledger.lease(key), {}, None, is_done=True)
    ledger.retry()
    assert ledger.queued() == ["k0"]


def test_what_was_lost_is_tried_anew_at_once_where_every_run_is_wanted(ledger):
    for k in range(1 + MOST_LOSSES):
        ledger.lose("k0", ledger.lease("k0"), f"death {k}")
    ledger.retry(at_once=True)
    assert ledger.queued() == ["k0", "k1", "k2"]


def test_looking_writes_nothing_and_needs_no_right_to(tmp_path):
    path = tmp_path / LEDGER
    with open_ledger(path) as ledger:
        ledger.plan(RUNS)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    with open_ledger(path, is_read_only=True) as ledger:
        assert counts(ledger) == {"queued": 3}
        with pytest.raises(FolderError, match="readonly"):
            ledger.lease("k0")
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before == {LEDGER: before[LEDGER]}


def test_another_process_sees_what_is_committed_while_the_study_goes_on(tmp_path):
    with open_ledger(tmp_path / LEDGER) as ledger:
        ledger.plan(RUNS)
        ledger.lease("k0")
        with open_ledger(tmp_path / LEDGER, is_read_only=True) as reader:
            assert counts(reader) == {"queued": 2, "leased": 1}


KILLED = """
import os, signal, sys
from cosim.studies.ledger import Ledger
ledger = Ledger(sys.argv[1])
ledger.plan([(f"k{i}", {}) for i in range(3)])
ledger.finish("k0", ledger.lease("k0"), {"mse": 1.0}, None, is_done=True)
ledger.lease("k1")
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_is_committed_outlives_a_kill(tmp_path):
    subprocess.run([sys.executable, "-c", KILLED, tmp_path / LEDGER], check=False)
    with open_ledger(tmp_path / LEDGER, is_read_only=True) as reader:
        assert counts(reader) == {"queued": 1, "leased": 1, "done": 1}
    with open_ledger(tmp_path / LEDGER) as ledger:
        ledger.plan([(f"k{i}", {}) for i in range(3)])
        assert ledger.queued() == ["k1", "k2"]
        assert next(ledger.entries()).result == {"mse": 1.0}


FULL = """
import resource, sys
from cosim.errors import UnfinishedError
from cosim.studies.ledger import Ledger
ledger = Ledger(sys.argv[1])
ledger.plan([("k0", {}), ("k1", {})])
lease = ledger.lease("k0")
resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, resource.RLIM_INFINITY))
try:
    ledger.finish("k0", lease, {"error": "x" * 100_000}, None, is_done=True)
except UnfinishedError as e:
    print(e)
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
assert ledger.finish("k0", lease, {"error": "x" * 100_000}, None, is_done=True)
ledger.close()
"""


def test_a_full_disk_leaves_the_ledger_as_it_was_and_is_no_refusal(tmp_path):
    command = [sys.executable, "-c", FULL, tmp_path / LEDGER]
    told = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert told.startswith("cannot use ")
    assert len(told.splitlines()) == 1


@pytest.mark.parametrize("content", [b"", b"no database at all" * 100], ids=["empty", "garbage"])
def test_what_is_no_ledger_is_one_line(tmp_path, content):
    (tmp_path / LEDGER).write_bytes(content)
    with pytest.raises(FolderError) as caught, open_ledger(tmp_path / LEDGER, is_read_only=True) as ledger:
        ledger.counts()
    assert len(str(caught.value).splitlines()) == 1


ACTIONS = st.lists(st.tuples(st.sampled_from(["lease", "finish", "lose", "head", "back"]), st.integers(0, 2)))


@given(ACTIONS)
def test_whatever_happens_nothing_that_is_done_runs_again(actions):
    done, leases = set(), {}
    with open_ledger(":memory:") as ledger:
        ledger.plan(RUNS)
        for action, i in actions:
            key = f"k{i}"
            if action == "lease" and key in ledger.queued():
                assert key not in done
                leases[key] = ledger.lease(key)
            elif action == "finish" and key in leases and ledger.finish(key, leases[key], {}, None, is_done=True):
                assert key not in done
                done.add(key)
            elif action == "lose" and key in leases:
                ledger.lose(key, leases[key], "killed")
            elif action == "back" and key in leases:
                ledger.give_back(key, leases[key])
            elif action == "head":
                ledger.plan(RUNS)
        assert {e.key for e in ledger.entries() if e.state == "done"} == done
