"""The table [record] of a scenario: which columns a run folder holds, and whether as CSV too."""

import pytest

from cosim.cli import main
from cosim.errors import ScenarioError
from cosim.runs.result import read_run
from cosim.runs.simulation import run

pytestmark = [pytest.mark.fmu, pytest.mark.usefixtures("leaves_nothing")]

SHORT = {"scenario.isolation": '"none"', "estimation.instants": "[]"}


def columns_of(pendulum, columns):
    return set(run(pendulum(SHORT | {"record.columns": columns}, stop_time=0.05), "none").series)


@pytest.mark.full
def test_columns_are_chosen_but_for_those_that_others_need(pendulum):
    everything, needed = columns_of(pendulum, '["*"]'), columns_of(pendulum, "[]")
    assert needed < everything
    assert {"time", "plant.phi", "reference.phi_ref", "plant.m", "controller.m"} <= needed
    assert everything - needed >= {"controller.u", "plant.der(phi)"}
    assert columns_of(pendulum, '["controller.*", "plant.der(phi)"]') == needed | {"controller.u", "plant.der(phi)"}


@pytest.mark.full
def test_a_run_without_them_is_replayed_and_drawn(pendulum, tmp_path, capsys):
    scenario = pendulum(SHORT | {"record.columns": "[]"}, stop_time=0.1)
    run(scenario, "target", out=tmp_path / "run")
    for command in (["replay", tmp_path / "run", "--estimator", "target"], ["report", tmp_path / "run"]):
        assert main([str(word) for word in command]) == 0, capsys.readouterr().err


def test_a_column_that_there_is_not_is_refused(pendulum):
    with pytest.raises(ScenarioError, match=r"^record.columns: no output 'plant.fi'; did you mean 'plant.phi'\?$"):
        columns_of(pendulum, '["plant.fi"]')


@pytest.mark.full
def test_a_long_run_has_its_csv_when_asked_for(pendulum, tmp_path, capsys):
    small, large = tmp_path / "small", tmp_path / "large"
    run(pendulum(SHORT, stop_time=0.05), "none", out=small)
    run(pendulum(SHORT | {"record.csv": "1e-4"}, stop_time=0.05), "none", out=large)
    assert not (large / "series.csv").exists()
    assert main(["csv", str(large)]) == 0
    assert capsys.readouterr().out.startswith(f"{large / 'series.csv'}  6 rows of ")
    assert (large / "series.csv").read_bytes() == (small / "series.csv").read_bytes()
    assert read_run(large).status == "done"  # with it beside what was sealed
    assert main(["csv", str(small)]) == 0
    assert "is there already" in capsys.readouterr().out
    mine = tmp_path / "mine.csv"
    mine.write_text("mine")
    assert main(["csv", str(small), "-o", str(mine)]) == 2
    assert mine.read_text() == "mine"
    assert main(["csv", str(tmp_path)]) == 2
    assert "has no readable series.arrow" in capsys.readouterr().err
    manifest = (large / "manifest.json").read_text()
    (large / "manifest.json").write_text(manifest.replace('"status": "done"', '"status": "running"'))
    assert main(["csv", str(large), "-o", str(tmp_path / "new.csv")]) == 2
    assert "manifest.json is not as it was written" in capsys.readouterr().err
    with (small / "events.jsonl").open("a") as file:
        file.write("x\n")
    for more in ([], ["-o", str(tmp_path / "new.csv")]):
        assert main(["csv", str(small), *more]) == 2
        assert capsys.readouterr().err == f"retune: {small} is damaged: events.jsonl is not as it was written.\n"
    assert not (tmp_path / "new.csv").exists()
