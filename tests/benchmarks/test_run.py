"""Where a run's time goes: what is counted to which part. No time is asserted."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def printed(program):
    """What the program, with benchmarks.run at hand as `b`, prints as JSON in its last line."""
    command = [sys.executable, "-c", "import json, sys\nimport benchmarks.run as b\n" + program]
    done = subprocess.run(command, cwd=ROOT, env=os.environ, check=True, capture_output=True, text=True, timeout=120)
    return json.loads(done.stdout.splitlines()[-1])


def test_a_part_has_its_own_time_without_that_of_the_parts_it_calls():
    program = """
ticks = iter([0.0, 1.0, 3.0, 3.5, 4.0, 10.0])  # outer begins, inner begins and ends, twice, outer ends
b.perf_counter = lambda: next(ticks)
clock = b.Clock()
inner = clock._timed(lambda: None, "inner")
clock._timed(lambda: (inner(), inner()), "outer")()
print(json.dumps(clock.seconds))
"""
    assert printed(program) == {"inner": 2.5, "outer": 7.5}


@pytest.mark.full
@pytest.mark.fmu
def test_every_part_of_a_run_is_found_and_the_product_is_left_as_it_was():
    program = """
methods = [(owner, name, owner.__dict__[name]) for _, owner, names in b._OWNERS for name in names]
scenario = b.Scenario.load("pendulum", {"scenario.stop_time": "3.2", "estimation.instants": "[]"})
parts = b.measured(scenario, "target", 0)
assert all(owner.__dict__[name] is method for owner, name, method in methods)
print(json.dumps(parts))
"""
    parts = printed(program)
    always = ["whole run", "FMUs", "sampling", "trigger", "window", "ask", "tell", "belief", "model calls", "recording"]
    assert all(parts[part] > 0.0 for part in always)
