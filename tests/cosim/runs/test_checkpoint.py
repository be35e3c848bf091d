"""Checkpoints hold a run whole, shared parts shared; they are data, and what is not stays the new run's own."""

import threading
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from cosim.errors import FolderError, NotResumableError
from cosim.runs.checkpoint import Checkpoints, read_checkpoint, restore
from cosim.runs.record import Recorder
from cosim.runs.run_files import CHECKPOINT
from cosim.runs.run_state import StartObjects


@dataclass
class Engine:
    """Lives: it saves its own state."""

    speed: float = 0.0
    lock: Any = field(default_factory=threading.Lock)

    def to_checkpoint(self):
        return self.speed

    def from_checkpoint(self, saved):
        self.speed = saved


class Run:
    def __init__(self, *engines):
        rng = np.random.default_rng(0)
        self.rng, self.held = rng, {"rng": rng, "engines": list(engines)}
        self.engines = engines


@pytest.fixture
def recorder(tmp_path):
    recorder = Recorder(tmp_path, ["time"])
    yield recorder
    recorder.release()


def writer(folder, run, every=1):
    return Checkpoints(folder, every, StartObjects(run))


def saved(folder, recorder, run):
    writer(folder, run).offer(0, recorder)
    return read_checkpoint(folder)


def test_numbers_go_on_where_they_were_and_what_was_shared_is_shared(tmp_path, recorder):
    run = Run(Engine(1.0), Engine(2.0))
    run.rng.random(5)
    checkpoint = saved(tmp_path, recorder, run)
    other = Run(Engine(), Engine())
    restore(StartObjects(other), checkpoint)
    assert other.held["rng"] is other.rng
    assert other.rng.random(3).tolist() == run.rng.random(3).tolist()


def test_what_lives_is_the_new_runs_own_and_gets_its_state_back(tmp_path, recorder):
    checkpoint = saved(tmp_path, recorder, Run(Engine(1.0), Engine(2.0)))
    a, b = Engine(), Engine()
    other = Run(a, b)
    restore(StartObjects(other), checkpoint)
    assert other.engines == (a, b)
    assert other.held["engines"][0] is a
    assert (a.speed, b.speed) == (1.0, 2.0)


def test_a_run_that_begins_otherwise_is_told(tmp_path, recorder):
    checkpoint = saved(tmp_path, recorder, Run(Engine(), Engine()))
    with pytest.raises(NotResumableError, match="does not fit the run: ValueError: another run begins otherwise"):
        restore(StartObjects(Run(Engine())), checkpoint)


def test_what_cannot_be_saved_says_why_and_does_not_stop_the_run(tmp_path, recorder):
    run = Run()
    run.lines = (line for line in "abc")
    with pytest.raises(NotResumableError, match=r"its state cannot be saved: Run\.lines is a generator"):
        saved(tmp_path, recorder, run)


def test_an_earlier_checkpoint_outlives_one_that_cannot_be_made(tmp_path, recorder):
    run = Run()
    checkpoints = writer(tmp_path, run)
    checkpoints.offer(0, recorder)
    before = (tmp_path / CHECKPOINT).read_bytes()
    run.lines = (line for line in "abc")
    checkpoints.offer(1, recorder)
    assert (tmp_path / CHECKPOINT).read_bytes() == before
    del run.lines
    checkpoints.offer(2, recorder)  # given up: trying again and again would cost
    assert (tmp_path / CHECKPOINT).read_bytes() == before


@pytest.mark.parametrize(("every", "points"), [(0, []), (1, [0, 1, 2, 3, 4, 5, 6]), (3, [0, 3, 6])])
def test_one_is_written_every_so_many_points(tmp_path, recorder, every, points):
    checkpoints, seen = writer(tmp_path, Run(), every), []
    for k in range(7):
        (tmp_path / CHECKPOINT).unlink(missing_ok=True)
        checkpoints.offer(k, recorder)
        if (tmp_path / CHECKPOINT).exists():
            seen.append(k)
    assert seen == points


def test_the_record_is_on_the_disk_before_its_checkpoint(tmp_path, recorder):
    recorder.row([0.0])
    recorder.event(0.0, "write", {})
    place = saved(tmp_path, recorder, Run()).place
    recorder.row([1.0])
    recorder.flush()
    assert place.series.digest_of(tmp_path / "series.arrow") is not None
    assert place.events.digest_of(tmp_path / "events.jsonl") is not None
    recorder.release()
    again = Recorder(tmp_path, ["time"], place)
    again.row([2.0])
    assert again.close()["time"].tolist() == [0.0, 2.0]


def test_a_record_of_other_bytes_is_not_gone_on_with(tmp_path, recorder):
    recorder.row([0.0])
    place = recorder.place()
    recorder.release()
    content = bytearray((tmp_path / "series.arrow").read_bytes())
    content[-20] ^= 1
    (tmp_path / "series.arrow").write_bytes(content)
    with pytest.raises(FolderError, match=r"is damaged: series\.arrow has changed"):
        Recorder(tmp_path, ["time"], place)
    assert (tmp_path / "series.arrow").read_bytes() == content


def test_every_flipped_bit_of_a_checkpoint_is_seen(tmp_path, recorder):
    saved(tmp_path, recorder, Run(Engine()))
    whole = (tmp_path / CHECKPOINT).read_bytes()
    for i in np.random.default_rng(0).choice(len(whole), 200, replace=False).tolist():
        (tmp_path / CHECKPOINT).write_bytes(whole[:i] + bytes([whole[i] ^ 4]) + whole[i + 1 :])
        with pytest.raises(FolderError, match=r"is damaged: checkpoint\.bin is not as it was written"):
            read_checkpoint(tmp_path)
