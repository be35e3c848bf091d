"""Evidence against what is held: the number that a trigger reports, and nothing of a user's model."""

import json
import re

import numpy as np
import pytest

from cosim.runs.innovations import innovation_limit, innovations
from cosim.runs.simulation import run


@pytest.mark.full
@pytest.mark.fmu
def test_the_innovations_are_those_that_triggered(pendulum, tmp_path):
    jump = {"changes": '{"plant.m" = [[0.0, 1.75], [0.25, 4.271]]}', "estimation.trigger": '{kind = "innovation"}'}
    made = run(pendulum(jump), "target", 0, tmp_path)
    squared = innovations(made)
    events = [json.loads(line) for line in (tmp_path / "events.jsonl").read_text().splitlines()]
    triggers = [e for e in events if e["kind"] == "trigger"]
    assert triggers
    for event in triggers:
        reported = float(re.search(r"squared (\S+) exceeds", event["reason"])[1])
        assert squared[np.searchsorted(made.time, event["t"] - 1e-9)] == pytest.approx(reported, rel=1e-3)
    before = squared[(made.time < triggers[0]["t"] - 1e-9)][1:]
    assert np.all(before < innovation_limit(made))


def test_a_model_of_the_users_own_is_not_called(pendulum):
    from tests.cosim.plots.made_up import made_up_run

    made = made_up_run(None)
    assert innovations(made) is not None
    estimation = made.scenario.estimation.model_copy(update={"model": "mine:derivative"})
    own = made_up_run(None, scenario=made.scenario.model_copy(update={"estimation": estimation}))
    assert innovations(own) is None
