"""Where a run has its wall time: the stacks that are sampled, and the parts that they belong to."""

import ast
from pathlib import Path
from time import perf_counter, sleep

import pytest

from benchmarks import real_time

ROOT = Path(__file__).parents[2]


def busy(seconds):
    end = perf_counter() + seconds
    while perf_counter() < end:
        pass


def test_what_computes_and_what_waits_are_sampled_by_their_wall_time():
    """On a machine that has other work the signals of what computes come late, and some as one."""
    with real_time.sampled_stacks() as stacks:
        busy(0.3)
        sleep(0.3)
    is_busy = [any(function == "busy" for _, function in stack) for stack in stacks]
    assert len(stacks) > 100
    assert 0.1 < sum(is_busy) / len(is_busy) < 0.9
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
