"""Runs on machines that share nothing with the head: what travels, once, and what is refused."""

import sys
from dataclasses import replace

import pytest

from cosim.cli import main
from cosim.runs.result import read_run
from cosim.scenarios.scenario import Scenario
from cosim.studies.definition import checked_definition
from cosim.studies.engines import engine_for
from cosim.studies.parcels import unpacked
from cosim.studies.plan import Study
from cosim.studies.recipe import Parcel, Recipe
from cosim.studies.row import WALL_TIMES
from cosim.studies.versions import all_versions
from cosim.studies.worker import make_run, make_run_far_away
from tests.cosim.studies.chaos import Cluster, bytes_of


@pytest.fixture(autouse=True)
def _no_module_of_another_test(monkeypatch):
    """Forget the axis_model of another test's folder, which stays loaded where that folder has stayed in the path."""
    monkeypatch.delitem(sys.modules, "axis_model", raising=False)


def recipe_of(scenario, path, estimator="target"):
    """The recipe of a run as it travels, and the head's files of its parcel."""
    definition = checked_definition({"study": {"name": "s", "scenarios": [str(path)]}}, "s")
    study = Study(definition, (scenario,), (str(path),))
    moved, parcel, files = study.packed(scenario, estimator)
    return Recipe(moved, estimator, 0, all_versions(), parcel=parcel), files


def figures(answer):
    assert answer.kind == "result", answer.why
    return {name: value for name, value in answer.row.items() if name not in WALL_TIMES}


@pytest.mark.full
@pytest.mark.fmu
def test_fmus_a_table_and_a_module_travel_once_and_nothing_else_is_looked_for(
    axis, tmp_path, monkeypatch, leaves_nothing
):
    monkeypatch.chdir(tmp_path)
    scenario = Scenario.load(axis(("stop_time = 1.0", "stop_time = 0.4")))
    here = make_run(Recipe(scenario, "target", 0, all_versions()))
    recipe, files = recipe_of(scenario, tmp_path / "axis.toml")
    names = sorted(name.rpartition("/")[2] for name in files)
    assert names == ["Axis.fmu", "AxisController.fmu", "axis_model.py", "steps.csv"]
    content = {name: path.read_bytes() for name, path in files.items()}
    for path in tmp_path.iterdir():
        if path.suffix in (".fmu", ".py", ".csv", ".toml"):
            path.unlink()  # the head's files are not there
    monkeypatch.setenv("FMU_RETUNE_CACHE", str(tmp_path / "elsewhere"))
    assert make_run_far_away(recipe).kind == "missing"
    with engine_for(None, 1) as engine:  # in a thread's own process, as on a worker
        there = engine.executor.submit(make_run_far_away, recipe, content).result()
        again = engine.executor.submit(make_run_far_away, recipe).result()
    assert figures(there) == figures(here) == figures(again)
    assert figures(here)["triggers"] > 0


def test_a_worker_of_other_versions_is_refused_in_one_line(tmp_path):
    recipe, _ = recipe_of(Scenario.load("pendulum"), "pendulum")
    answer = make_run_far_away(replace(recipe, versions=all_versions() | {"numpy": "1.0", "scipy": "2.0"}))
    assert answer.kind == "unfit"
    assert answer.why.startswith(f"it has numpy {all_versions()['numpy']} instead of 1.0, scipy ")
    assert len(answer.why.splitlines()) == 1


def test_a_file_that_has_changed_on_its_way_is_not_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("FMU_RETUNE_CACHE", str(tmp_path))
    recipe, _ = recipe_of(Scenario.load("pendulum"), "pendulum")
    parcel = Parcel({"scenario/Plant.fmu": "0" * 64}, "name")
    answer = make_run_far_away(replace(recipe, parcel=parcel), {"scenario/Plant.fmu": b"other"})
    assert (answer.kind, answer.why) == ("unfinished", "scenario/Plant.fmu has changed since the study began.")
    assert unpacked(parcel, None) is None
    assert list((tmp_path / "studies").iterdir()) == []


def test_a_changed_file_is_another_parcel(axis, tmp_path):
    path = axis()
    first, _ = recipe_of(Scenario.load(path), path)
    with open(tmp_path / "axis_model.py", "a") as file:
        file.write("\n# changed\n")
    second, _ = recipe_of(Scenario.load(path), path)
    assert first.parcel.name != second.parcel.name


@pytest.mark.full
@pytest.mark.fmu
def test_a_study_of_ones_own_fmus_on_a_cluster_is_that_of_this_machine(axis, tmp_path, leaves_nothing):
    axis(("stop_time = 1.0", "stop_time = 0.4"))
    study = tmp_path / "study.toml"
    study.write_text(
        '[study]\nname = "axis"\nscenarios = ["axis.toml"]\nestimators = ["none", "target"]\nkeep = true\n'
        '[factors.mass]\nset = \'changes."plant.mass.m"\'\nto = "[[0.0, 2.0], [0.1, {}]]"\nlist = [2.5, 3.5]\n'
    )
    assert main(["study", str(study), "--out", str(tmp_path / "here")]) == 0
    cluster = Cluster(tmp_path / "cluster")
    try:
        cluster.keep_up()
        assert main(["study", str(study), "--out", str(tmp_path / "there"), "--on", cluster.address]) == 0
    finally:
        cluster.stop()
    assert bytes_of(tmp_path / "here") == bytes_of(tmp_path / "there")
    folders = sorted((tmp_path / "there" / "runs").iterdir())
    assert len(folders) == 4
    for folder in folders:
        here = read_run(tmp_path / "here" / "runs" / folder.name)
        assert read_run(folder).mse == here.mse


@pytest.mark.parametrize(
    ("on", "told"),
    [
        ("tls://127.0.0.1:9", "--on tls://127.0.0.1:9: give Dask's configuration a certificate"),
        ("mpi", "--on mpi: begin with mpiexec -n 9 python -m mpi4py.futures -m cosim.cli"),
    ],
)
def test_an_engine_that_is_not_set_up_is_one_line(capsys, tmp_path, monkeypatch, on, told):
    pytest.importorskip("mpi4py" if on == "mpi" else "distributed")
    study = tmp_path / "s.toml"
    study.write_text('[study]\nname = "s"\nscenarios = ["pendulum"]\n')
    assert main(["study", str(study), "--out", str(tmp_path / "out"), "--on", on]) == 2
    error = capsys.readouterr().err
    assert told in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_no_scheduler_is_one_line(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("cosim.studies.engines._CONNECT_S", 0.5)
    study = tmp_path / "s.toml"
    study.write_text('[study]\nname = "s"\nscenarios = ["pendulum"]\n')
    assert main(["study", str(study), "--out", str(tmp_path / "out"), "--on", "tcp://127.0.0.1:9"]) == 2
    error = capsys.readouterr().err
    assert "--on tcp://127.0.0.1:9: no Dask scheduler answers" in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()
