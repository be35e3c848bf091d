"""The head of a study against an executor that answers as it is told: what becomes of each answer."""

import re
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from importlib.resources import files
from pathlib import Path

import pytest

from cosim.errors import ScenarioError, UnfinishedError
from cosim.scenarios.scenario import Scenario
from cosim.studies.conduct import enter
from cosim.studies.definition import checked_definition
from cosim.studies.engines import Engine
from cosim.studies.head import Head, StudyError
from cosim.studies.ledger import open_ledger
from cosim.studies.plan import Study
from cosim.studies.recipe import Answer, KilledFmuError

DONE = Answer("result", row={"status": "done", "mse": 1.0})


class Scripted(Executor):
    """An executor whose calls end at once, as the script says of the estimator."""

    def __init__(self, script):
        self.script = {name: list(answers) for name, answers in script.items()}
        self.calls, self.seeds = [], []

    def submit(self, fn, recipe, *rest):
        self.calls.append((fn.__name__, recipe.estimator, *rest))
        self.seeds.append(recipe.seed)
        future, answers = Future(), self.script[recipe.estimator]
        outcome = answers.pop(0) if len(answers) > 1 else answers[0]
        if isinstance(outcome, BaseException):
            future.set_exception(outcome)
        else:
            future.set_result(outcome)
        return future


@pytest.fixture
def made():
    """made(script): the ledger's states by estimator and the executor, once the study was made as scripted."""

    def make(script, is_here=True, seeds=1, factors=None, **options):
        study = {"name": "s", "scenarios": ["pendulum"], "estimators": list(script), "seeds": seeds}
        definition = checked_definition({"study": study, "factors": factors or {}}, "s")
        made = Study(definition, (Scenario.load("pendulum"),), ("pendulum",))
        runs = {run.key: run for run in made.runs()}
        executor = Scripted(script)
        engine = Engine("it", executor, lambda: 1, is_here, ends=(CancelledError,))
        with open_ledger(":memory:") as ledger:
            enter(made, runs, ledger)
            try:
                Head(made, ledger, engine, **options).make(runs)
                error = None
            except Exception as e:
                error = e
            return {entry.point["estimator"]: entry.state for entry in ledger.entries()}, executor, error

    return make


def test_results_are_committed_failures_among_them(made):
    failed = Answer("result", row={"status": "diverged", "mse": 9.0})
    assert made({"none": [DONE], "target": [failed]})[0] == {"none": "done", "target": "failed"}


def test_a_study_that_is_stopped_has_made_every_point_about_as_often(made):
    budgets = {"budget": {"set": "estimation.budget", "list": [10, 15, 20]}}
    _, executor, _ = made({"none": [DONE], "target": [DONE]}, seeds={"none": 1, "target": 3}, factors=budgets)
    assert executor.seeds == [0] * 6 + [1] * 3 + [2] * 3


def test_a_worker_that_dies_three_times_is_no_matter_the_fourth_time_is(made):
    killed = BrokenExecutor("its process has ended with exit code -9")
    states, executor, error = made({"none": [killed] * 3 + [DONE], "target": [killed]})
    assert (states, error) == ({"none": "done", "target": "lost"}, None)
    assert [estimator for _, estimator in executor.calls].count("target") == 4


def test_a_run_of_which_an_fmu_was_killed_from_outside_is_made_again(made):
    assert made({"none": [KilledFmuError("plant: the FMU's process was ended by SIGKILL"), DONE]})[0] == {
        "none": "done"
    }


def test_a_worker_without_memory_is_lost_and_not_a_result(made):
    assert made({"none": [MemoryError(), DONE]})[0] == {"none": "done"}


@pytest.mark.parametrize(
    ("outcome", "kind", "told"),
    [
        (Answer("unfinished", "cannot write /x: No space left on device."), UnfinishedError, "No space left"),
        (Answer("unfit", "it has numpy 1 instead of 2"), ScenarioError, "a worker is refused: it has numpy 1"),
        (CancelledError("scheduler-connection-lost"), UnfinishedError, "it has gone"),
        (ModuleNotFoundError("No module named 'cosim'"), UnfinishedError, "No module named 'cosim'"),
    ],
    ids=["full disk", "other versions", "the scheduler has gone", "a worker without the package"],
)
def test_what_ends_a_study_leaves_the_run_queued_and_no_loss_counted(made, outcome, kind, told):
    states, _, error = made({"none": [DONE], "target": [outcome]})
    assert states == {"none": "done", "target": "queued"}
    assert isinstance(error, kind)
    assert told in str(error)
    assert len(str(error).splitlines()) == 1


def test_a_refused_run_ends_a_comparison_but_no_study(made):
    refused = Answer("refused", "no output of controller is called 'v'.")
    assert made({"none": [refused], "target": [DONE]})[0] == {"none": "refused", "target": "done"}
    states, _, error = made({"none": [refused], "target": [DONE]}, is_compared=True)
    assert states == {"none": "queued", "target": "queued"}
    assert isinstance(error, StudyError)


def test_no_clock_on_the_wall_is_looked_at():
    found = [
        path.name
        for path in Path(str(files("cosim.studies"))).glob("*.py")
        if re.search(
            r"\btime\.time\b|from time import time\b|datetime|strftime|CURRENT_TIME|julianday", path.read_text()
        )
    ]
    assert found == []


def test_files_travel_to_a_worker_elsewhere_only_when_it_lacks_them(made):
    states, executor, _ = made({"none": [Answer("missing"), DONE], "target": [DONE]}, is_here=False)
    assert states == {"none": "done", "target": "done"}
    assert executor.calls == [
        ("make_run_far_away", "none", None), ("make_run_far_away", "none", {}), ("make_run_far_away", "target", None),
    ]  # fmt: skip
