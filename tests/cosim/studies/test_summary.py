"""A study's table, summary, sensitivities and pictures, against numbers that are known in closed form."""

import numpy as np
import pyarrow as pa
import pytest
from PIL import Image

from cosim.cli import main
from cosim.pages.watched import WatchedStudy
from cosim.plots.study import draw_study
from cosim.runs.lock import new_locked_folder
from cosim.scenarios.scenario import Scenario
from cosim.studies.conduct import enter
from cosim.studies.definition import checked_definition
from cosim.studies.folder import open_study
from cosim.studies.ledger import open_ledger
from cosim.studies.plan import Study
from cosim.studies.sensitivity import sensitivities
from cosim.studies.summary import Share, summarised
from cosim.studies.table import read_results, write_results
from cosim.studies.texts import to_markdown, to_terminal
from cosim.terminal.study_output import tell_study

MASS = {"set": 'changes."plant.m"'}


def study(factors=None, **settings):
    table = {"name": "s", "scenarios": ["pendulum"], "estimators": ["none", "target"]} | settings
    definition = checked_definition({"study": table, "factors": factors or {"m": MASS | {"list": [1.5, 2.5]}}}, "s")
    return Study(definition, (Scenario.load("pendulum"),), ("pendulum",))


def table(*rows):
    """A table of (point, estimator, status, mse)."""
    names = ("point", "estimator", "status", "mse")
    columns = {name: [row[k] for row in rows] for k, name in enumerate(names)}
    n = len(rows)
    return pa.table(columns | {"scenario": ["pendulum"] * n, "seed": [0] * n, "largest error": [1.0] * n,
                               "m": [1.5 + row[0] for row in rows]})  # fmt: skip


@pytest.mark.parametrize("n", [1, 10, 200])
def test_the_interval_of_no_run_and_of_all_runs_is_that_of_clopper_and_pearson(n):
    limit = 0.025 ** (1.0 / n)
    assert Share(0, n).interval == (0.0, pytest.approx(1.0 - limit))
    assert Share(n, n).interval == (pytest.approx(limit), 1.0)


def test_the_interval_is_where_either_tail_has_a_fortieth():
    low, high = Share(3, 20).interval
    ks = np.arange(21)
    weights = np.array([float(np.prod([(20 - i) / (i + 1) for i in range(k)])) for k in ks])
    for p, tail in ((low, ks >= 3), (high, ks <= 3)):
        assert (weights * p**ks * (1 - p) ** (20 - ks))[tail].sum() == pytest.approx(0.025, rel=1e-6)


def test_one_run_of_the_nominal_controller_is_enough_for_all_seeds():
    rows = [("none", 4, 2.0), ("target", 0, 1.0), ("none", 1, 4.0), ("target", 1, 1.0), ("target", 2, 3.0)]
    columns = {name: [row[k] for row in rows] for k, name in enumerate(("estimator", "seed", "mse"))}
    constant = {"scenario": "pendulum", "point": 0, "status": "done", "largest error": 1.0}
    made = summarised(pa.table(columns | {name: [value] * len(rows) for name, value in constant.items()}))
    assert made.ratio.tolist() == [1.0, 0.5, 1.0, 0.25, 1.5]  # that of the same seed where there is one


def test_runs_are_compared_with_the_nominal_controllers_at_the_same_point():
    summary = summarised(
        table(
            (0, "none", "done", 1.0), (0, "target", "done", 0.5),
            (1, "target", "done", 4.0), (1, "none", "done", 2.0),
            (2, "none", "done", 1.0), (2, "target", "done", 1.005),
            (3, "none", "done", 1.0), (3, "target", "diverged", None),
            (4, "none", "diverged", None), (4, "target", "done", 1.0),
            (5, "none", "diverged", None), (5, "target", "diverged", None),
            (6, "none", "done", 1.0), (6, "target", "lost", None),
            (7, "target", "done", 1.0),
        )
    )  # fmt: skip
    none, target = summary.rows()
    assert (target.better.n, target.better.of) == (2, 6)  # half the error; a run that only re-tuning brought to its end
    assert (target.worse.n, target.worse.of) == (2, 6)  # twice the error; a run that only re-tuning lost
    assert (none.better.of, none.worse.of) == (0, 0)
    assert target.ratio == pytest.approx(1.005)  # the middle one of 0.5, 1.005 and 2
    assert target.statuses == {"diverged": 2, "done": 5, "lost": 1}
    assert summary.worst() == [7, 11, 2, 5, 1]  # those that diverged, then by ratio


def test_quantiles_are_of_the_runs_that_are_done():
    rows = [(k, "target", "done", float(k)) for k in range(101)] + [(101, "target", "diverged", 1e9)]
    (row,) = summarised(table(*rows)).rows()
    assert row.mse == (50.0, 95.0, 100.0)


@pytest.fixture
def written(tmp_path):
    """written(results): the table of a study, from a ledger in which runs ended with these results."""

    def write(results, points=None):
        with open_ledger(":memory:") as ledger:
            points = points or [
                {"scenario": "s", "point": k, "seed": 0, "estimator": "none"} for k in range(len(results))
            ]
            ledger.plan((f"k{k}", point) for k, point in enumerate(points))
            for k, result in enumerate(results):
                if result is not None:
                    ledger.finish(f"k{k}", ledger.lease(f"k{k}"), result, None, is_done=True)
            write_results(tmp_path, ledger)
        return read_results(tmp_path)

    return write


def test_the_table_has_a_row_for_every_run_and_all_columns(written):
    made = written([{"status": "done", "mse": 1.0}, None, {"status": "done", "mse": 2, "error m [kg]": 0.5}])
    assert made["status"].to_pylist() == ["done", "queued", "done"]
    assert made["mse"].to_pylist() == [1.0, None, 2.0]
    assert made["error m [kg]"].to_pylist() == [None, None, 0.5]
    assert made["key"].to_pylist() == ["k0", "k1", "k2"]


def test_values_of_several_kinds_are_texts(written):
    base = {"scenario": "s", "point": 0, "seed": 0, "estimator": "none"}
    made = written([None] * 3, [base | {"f": value} for value in ("innovation", 1.5, [1, 2])])
    assert made["f"].to_pylist() == ["innovation", "1.5", "[1, 2]"]


@pytest.mark.parametrize("values", [(10**20,), (1, 10**20), (1.5, -(10**20))])
def test_integers_of_more_than_64_bits_are_texts(written, values):
    base = {"scenario": "s", "point": 0, "seed": 2**63 - 1, "estimator": "none"}
    made = written([None] * len(values), [base | {"f": value} for value in values])
    assert made["f"].to_pylist() == [str(value) for value in values]
    assert summarised(made).columns["seed"].tolist() == [2**63 - 1] * len(values)


def test_a_table_without_any_result_can_be_summarised(written):
    summary = summarised(written([None, None]))
    assert summary.rows()[0].statuses == {"queued": 2}
    assert "2 of them still to be made" in to_terminal(study(), summary)


@pytest.mark.parametrize(("n", "told"), [(1, "1 run was lost: "), (2, "2 runs were lost: ")])
def test_runs_that_were_lost_are_counted(n, told):
    rows = [(0, "none", "done", 1.0), *((k + 1, "target", "lost", None) for k in range(n))]
    assert told in to_terminal(study(), summarised(table(*rows)))


def test_sensitivities_are_the_parts_of_the_variance():
    # log(mse) = 3 a + b with a, b uniform: 9/10 and 1/10 of the variance
    n = 512
    factors = {name: {"set": f'changes."plant.{name}"', "uniform": [0.0, 1.0]} for name in "ab"}
    made = study(factors, sampling="latin-hypercube", samples=n, estimators=["target"])
    a, b = np.array([[p.values["a"], p.values["b"]] for _, p in made.places()]).T
    columns = {
        "scenario": ["pendulum"] * n, "estimator": ["target"] * n, "status": ["done"] * n, "point": range(n),
        "seed": [0] * n, "mse": np.exp(3 * a + b), "largest error": np.ones(n), "a": a, "b": b,
    }  # fmt: skip
    found = sensitivities(made.definition, summarised(pa.table(columns), ("a", "b")))
    assert [s.factor for s in found] == ["a", "b"]
    assert [s.first_order for s in found] == pytest.approx([0.9, 0.1], abs=0.04)
    assert all(0.0 < s.half_width < 0.2 for s in found)


@pytest.mark.full
def test_pictures_and_markdown_name_each_other(tmp_path):
    made = study({"m": MASS | {"list": [1.5, 2.5]}, "b": {"set": "estimation.budget", "list": [10, 20]}})
    rows = table(*((p, e, "done", 1.0 + p) for p in range(4) for e in ("none", "target")))
    summary = summarised(rows.append_column("b", pa.array([10, 10, 20, 20] * 2)), ("m", "b"))
    files = draw_study(tmp_path, summary, ("m", "b"))
    assert [path.name for path in files] == ["errors.png", "shares.png", "planes-target.png"]
    for path in files:
        assert len(np.unique(np.asarray(Image.open(path).convert("L")))) > 10  # not blank
    text = to_markdown(made, summary, [path.name for path in files])
    assert all(f"({path.name})" in text for path in files)
    assert "retune run pendulum --only --estimator target --seed 0 --set 'changes.\"plant.m\"=2.5'" in text


def test_pictures_can_be_drawn_whatever_there_is(tmp_path):
    nothing = table((0, "none", "diverged", None), (0, "target", "queued", None))
    assert [path.name for path in draw_study(tmp_path, summarised(nothing, ("m",)), ("m",))] == ["errors.png"]
    alone = table((0, "target", "done", 1.0))
    assert [path.name for path in draw_study(tmp_path, summarised(alone, ("m",)), ("m",))] == ["errors.png"]


def test_a_plane_is_drawn_of_two_factors_that_a_scenario_has(tmp_path):
    """Either scenario has two numeric factors of its own: the other's have no value in its rows."""
    columns = {"estimator": ["none", "target"] * 8, "scenario": ["pendulum"] * 8 + ["other"] * 8}
    columns |= {"point": np.repeat(range(8), 2), "mse": np.repeat(np.arange(1.0, 9.0), 2), "status": ["done"] * 16}
    columns |= {"seed": [0] * 16, "largest error": [1.0] * 16}
    for k, name in enumerate(("m", "b", "c", "d")):
        own = np.repeat([[1.5, 2.5, 1.5, 2.5], [10.0, 10.0, 20.0, 20.0]][k % 2], 2).tolist()
        columns[name] = [None] * 8 + own if k > 1 else own + [None] * 8
    names = ("m", "b", "c", "d")
    files = draw_study(tmp_path, summarised(pa.table(columns), names), names)
    assert [path.name for path in files] == ["errors.png", "shares.png", "planes-target.png"]
    of_one = draw_study(tmp_path, summarised(pa.table(columns), ("m", "c")), ("m", "c"))
    assert [path.name for path in of_one] == ["errors.png", "shares.png"]  # no scenario has both


def test_a_picture_that_fails_does_not_take_the_summary_along(tmp_path, capsys, monkeypatch):
    def fails(*_):
        raise ValueError("no picture")

    monkeypatch.setattr("cosim.plots.study.draw_study", fails)
    made = study()
    with open_ledger(":memory:") as ledger:
        enter(made, {run.key: run for run in made.runs()}, ledger)
        with pytest.raises(ValueError, match="no picture"):
            tell_study(made, ledger, tmp_path, is_json=False)
    assert "4 runs over m and 1 seed" in capsys.readouterr().out
    assert "4 runs over m and 1 seed" in (tmp_path / "summary.md").read_text()


@pytest.mark.full
def test_a_study_becomes_a_page_with_pictures_and_links_to_the_runs_that_are_kept(tmp_path, capsys):
    made = study(keep=True)
    out = tmp_path / "out"
    with new_locked_folder("s", out), open_study(out, made, "study") as ledger:
        runs = {run.key: run for run in made.runs()}
        enter(made, runs, ledger)
        for k, (key, run) in enumerate(runs.items()):
            result = {"status": "done", "mse": 1.0 + k, "run": f"{run.estimator}-{k}"}
            ledger.finish(key, ledger.lease(key), result, None, is_done=True)
        write_results(out, ledger)
    assert main(["report", str(out)]) == 0
    page = (out / "report.html").read_text()
    assert page.count("<img ") == page.count("data:image/png;base64") == 2
    assert 'href="runs/target-1"' in page
    assert main(["report", str(out)]) == 2  # it is there already
    assert "exists" in capsys.readouterr().err


@pytest.mark.full
def test_a_study_that_goes_on_has_a_page_that_grows(tmp_path):
    made, out = study(keep=True), tmp_path / "out"
    with new_locked_folder("s", out), open_study(out, made, "study") as ledger:
        runs = {run.key: run for run in made.runs()}
        enter(made, runs, ledger)
        page = WatchedStudy(out, [out / "runs" / "target-0"])
        assert "queued" in page.html()
        before = page.news("")
        assert page.news(before["version"]).get("parts") is None  # nothing is new
        ledger.finish(
            next(iter(runs)), ledger.lease(next(iter(runs))), {"status": "done", "run": "target-0"}, None, True
        )
        after = page.news(before["version"])
        assert after["parts"]["rows"].count("done") > before["parts"]["rows"].count("done") == 0
        assert 'href="run/0/"' in after["parts"]["rows"]
        assert "<img " in after["parts"]["summary"]
    assert not (out / "results.parquet").exists()  # who looks writes nothing
