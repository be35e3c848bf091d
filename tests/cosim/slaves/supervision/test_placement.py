"""FMUs' processes share the caller's core while their steps are short, and are let go when they are not."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.slaves.supervision.placement import SLOW_S, Placement, same_addresses

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2, reason="needs Linux and two cores"
)


@pytest.fixture
def process():
    with subprocess.Popen(["sleep", "60"]) as process:
        yield process
        process.kill()


def test_a_fast_process_comes_to_the_callers_core_and_a_slow_one_is_let_go(process):
    placement, everywhere = Placement(process.pid), os.sched_getaffinity(0)
    placement.review(0.0)
    placement.follow()
    assert len(os.sched_getaffinity(process.pid)) == 1
    placement.let_run()
    placement.review(0.9 * SLOW_S)
    placement.follow()
    assert len(os.sched_getaffinity(process.pid)) == 1
    placement.review(1.1 * SLOW_S)
    placement.follow()
    assert os.sched_getaffinity(process.pid) == everywhere
    placement.review(0.9 * SLOW_S)  # between the two limits it stays as it is
    placement.follow()
    assert os.sched_getaffinity(process.pid) == everywhere
    placement.review(0.4 * SLOW_S)
    placement.follow()
    assert len(os.sched_getaffinity(process.pid)) == 1


def test_the_process_follows_the_caller(process):
    placement, everywhere = Placement(process.pid), os.sched_getaffinity(0)
    try:
        for core in everywhere:
            os.sched_setaffinity(0, {core})
            placement.follow()
            assert os.sched_getaffinity(process.pid) == {core}
    finally:
        os.sched_setaffinity(0, everywhere)


def test_a_process_that_has_ended_is_no_error(process):
    placement = Placement(process.pid)
    process.kill()
    process.wait()
    placement.follow()
    placement.review(1.0)
    assert process.returncode == -signal.SIGKILL


def test_the_callers_own_address_layout_stays_random():
    before = Path("/proc/self/personality").read_text()
    with same_addresses():
        inside = Path("/proc/self/personality").read_text()
    assert Path("/proc/self/personality").read_text() == before
    assert int(inside, 16) in (int(before, 16), int(before, 16) | 0x0040000)
