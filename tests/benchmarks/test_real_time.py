"""Where a run has its wall time: the stacks that are sampled, and the parts that they belong to."""

import ast
from pathlib import Path
from time import perf_counter, sleep

import pytest

from benchmarks import real_time

ROOT = Path(__file__).parents[2]


def busy(stacks, n):
    end = perf_counter() + 30.0
    while len(stacks) < n and perf_counter() < end:
        pass


def idle(stacks, n):
    end = perf_counter() + 30.0
    while len(stacks) < n and perf_counter() < end:
        sleep(0.05)


def test_what_computes_and_what_waits_are_both_sampled():
    """Numbers of samples, not shares: a busy machine may take a process off its core for any time."""
    with real_time.sampled_stacks() as stacks:
        busy(stacks, 50)
        n_busy = len(stacks)
        idle(stacks, n_busy + 50)
    functions = [{function for _, function in stack} for stack in stacks]
    assert sum("busy" in names for names in functions) >= 45
    assert sum("idle" in names for names in functions) >= 45
    assert not any({"busy", "idle"} <= names for names in functions)
    n = len(stacks)
    sleep(0.02)
    assert len(stacks) == n


@pytest.mark.parametrize(("part", "file", "function"), [row for row in real_time.PARTS if row[1]])
def test_each_part_is_there(part, file, function):
    (path,) = [
        path for top in ("cosim", "estimator") for path in (ROOT / top).rglob("*.py") if str(path).endswith(file)
    ]
    names = {node.name for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)}
    assert not function or function in names
    assert real_time._part_of([("/x/json.py", "loads"), (f"/x/{file}", function or "any")]) == part


def test_a_stack_is_in_the_first_part_that_has_a_frame_there():
    stack = [("/x/cosim/system/master.py", "begin"), ("/x/cosim/retuning/lookahead.py", "peak")]
    assert real_time._part_of(stack) == "loop simulated ahead"
    assert real_time._part_of([("/x/cosim/runs/simulation.py", "run")]) == "start and end of a run"
