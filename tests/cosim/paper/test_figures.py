"""The paper's figures and table: what is drawn and written is what the runs hold."""

import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.colors import to_hex
from PIL import Image

from cosim import Run, Scenario
from cosim.errors import FolderError
from cosim.paper.figures import chosen, draw_figures, figures
from cosim.paper.pictures import LABELS, SHOWN, draw_altitude, draw_mse, draw_pendulum, ending_text
from cosim.paper.table import PAPER_ROWS, PAPER_TRUTH, markdown, measured, prediction_time, rows
from cosim.plots.canvas import new_figure, save_svg
from cosim.studies.head import StudyError
from cosim.system.plant import Plant

GONE = {f"components.{name}.fmu": "gone.fmu" for name in ("plant", "controller", "reference")}
THETA = ("m", "J_x", "J_y", "J_z")
TRUTH, HELD = (1.25, 3.3, 3.3, 6.6), (1.75, 3.6, 3.7, 6.6)  # errors 0.5 and |(0.3, 0.4, 0)| = 0.5

PLANT = Plant("plant", (), {}, ())
"""Nothing here looks at samples."""


def quadrotor(estimator: str = "target", end: float = 16.0, error: float = 0.1, **changed: object) -> Run:
    """A run until `end` whose errors are that, twice and three times that, of alternating sign."""
    time = np.arange(round(end / 0.01) + 1) * 0.01
    sign = np.where(np.arange(len(time)) % 2, 1.0, -1.0)
    series = {"time": time}
    for k, axis in enumerate("xyz"):
        series[f"reference.r_d_{axis}"] = np.sin(time)
        series[f"plant.r_{axis}"] = np.sin(time) + (k + 1) * error * sign
    for name, true, held in zip(THETA, TRUTH, HELD, strict=True):
        series |= {f"plant.{name}": np.full(len(time), true), f"controller.{name}": np.full(len(time), held)}
    run = Run(
        scenario=Scenario.load("quadrotor", GONE), plant=PLANT, estimator=estimator, seed=3, series=series,
        status="done", error=None, n_evaluations=0, n_episodes=0, latencies=(), wall=1.0, folder=None,
    )  # fmt: skip
    return replace(run, **changed)


def pendulum(estimator: str = "target", n: int = 1001) -> Run:
    time = 0.01 * np.arange(n)
    has_jumped = time >= 3.0
    columns = {
        "plant.phi": np.cos(time), "reference.phi_ref": np.ones(n), "controller.u": 10.0 * time,
        "plant.m": np.where(has_jumped, 4.271, 1.75), "plant.l": np.where(has_jumped, 0.981, 0.75),
        "controller.m": np.full(n, 1.75), "controller.l": np.full(n, 0.75),
    }  # fmt: skip
    scenario = Scenario.load("pendulum", GONE)
    return Run(scenario, PLANT, estimator, 3, {"time": time} | columns, "done", None, 0, 0, (), 1.0, None)


DIVERGED = quadrotor("sqp", end=4.2, error=20.0, status="diverged")
ALL = {
    "none": quadrotor("none", error=1.0),
    "paper": quadrotor("paper", error=2.0),
    "ipm-scipy": quadrotor("ipm-scipy"),
    "sqp": DIVERGED,
    "target": quadrotor("target", error=0.01),
    "true": quadrotor("true", error=0.001),
}


def test_each_bar_is_as_high_as_the_mean_squared_error_of_its_run() -> None:
    (axes,) = draw_mse(ALL).axes
    drawn = {c.get_label(): [bar.get_height() for bar in c] for c in axes.containers}
    assert drawn == {LABELS[name]: pytest.approx(run.mse) for name, run in ALL.items() if name != "true"}
    # Errors of constant size e, 2 e and 3 e have these means.
    assert drawn[LABELS["paper"]] == pytest.approx([4.0, 16.0, 36.0])
    assert axes.get_yscale() == "log"


def test_the_floor_is_a_line_across_each_axis_bars() -> None:
    (axes,) = draw_mse(ALL).axes
    (floor,) = [c for c in axes.collections if c.get_label() == LABELS["true"]]
    assert [s[0, 1] for s in floor.get_segments()] == pytest.approx(ALL["true"].mse)
    for k, segment in enumerate(floor.get_segments()):
        bars = [c[k] for c in axes.containers]
        assert segment[0, 0] < min(b.get_x() for b in bars)
        assert max(b.get_x() + b.get_width() for b in bars) < segment[1, 0]


def test_bars_do_not_overlap() -> None:
    (axes,) = draw_mse(ALL).axes
    bars = sorted((b.get_x(), b.get_x() + b.get_width()) for c in axes.containers for b in c)
    assert all(end < begin for (_, end), (begin, _) in pairwise(bars))


def test_a_diverged_run_is_marked_with_its_time_and_no_other_is() -> None:
    texts = [t.get_text() for t in draw_mse(ALL).axes[0].texts]
    assert [t for t in texts if "diverged" in t] == [f"{e:.2g}, diverged at 4.2 s" for e in DIVERGED.mse]
    assert len(texts) == 3 * (len(ALL) - 1)


def test_no_text_of_the_bars_is_clipped_or_hides_another() -> None:
    figure = draw_mse(ALL)
    figure.draw_without_rendering()
    (axes,) = figure.axes
    boxes = [t.get_window_extent() for t in axes.texts]
    inside = axes.get_window_extent()
    assert all(inside.x0 <= b.x0 and b.x1 <= inside.x1 and inside.y0 <= b.y0 and b.y1 <= inside.y1 for b in boxes)
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


@pytest.mark.parametrize("error", [np.nan, np.inf, 1e160, 0.0], ids=str)
@pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning")  # the mean of squares that big
def test_whatever_the_errors_they_are_drawn(error: float) -> None:
    bad = {"none": quadrotor("none", error=error), "target": quadrotor("target", end=0.0, status="faulted")}
    nothing = {name: values[:0] for name, values in bad["none"].series.items()}
    bad["sqp"] = quadrotor("sqp", series=nothing, status="faulted")
    for figure in (draw_mse(bad), draw_altitude(bad)):
        figure.draw_without_rendering()
    assert ending_text(bad["sqp"]) == "faulted at the start"
    assert measured(bad["sqp"], [], 1.5) is None


def test_the_altitude_error_is_drawn_for_each_estimator_and_crossed_where_it_ends() -> None:
    figure = draw_altitude(ALL)
    panels = {axes.get_title(): axes for axes in figure.axes if axes.get_visible()}
    assert set(panels) == {text for name, text in LABELS.items() if name in ALL and name != "sqp"} | {
        f"{LABELS['sqp']}: diverged at 4.2 s"
    }
    for shown in SHOWN:
        if shown.name not in ALL:
            continue
        (axes,) = [a for title, a in panels.items() if title.startswith(shown.text)]
        (curve,) = [c for c in axes.lines if c.get_label() == shown.text]
        assert to_hex(curve.get_color()) == shown.colour.lower()
        error = ALL[shown.name].errors["plant.r_z"]
        limit = axes.get_ylim()[1]
        visible = np.abs(error) < limit
        assert np.array_equal(curve.get_ydata()[visible], error[visible])
        crosses = [c for c in axes.lines if c.get_marker() == "X"]
        assert [float(c.get_xdata()[0]) for c in crosses] == ([4.2] if shown.name == "sqp" else [])


def test_the_pendulums_position_and_force_are_drawn_beside_reference_and_jump() -> None:
    runs = {name: pendulum(name) for name in ("none", "paper", "target", "true")}
    figure = draw_pendulum(runs, [])
    assert figure is not None
    above, below = figure.axes
    shown = {c.get_label(): np.asarray(c.get_ydata()) for c in above.lines}
    assert np.array_equal(shown[LABELS["target"]], runs["target"]["plant.phi"])
    assert np.array_equal(shown["reference"], np.ones(1001))
    assert LABELS["true"] not in shown
    jumps = [c.get_xdata()[0] for c in above.lines if c.get_label() == "parameters change"]
    assert jumps == pytest.approx([3.0])
    assert {LABELS["none"], LABELS["paper"], LABELS["target"]} <= {c.get_label() for c in below.lines}


EPISODES = [
    event
    for n, t in enumerate((1.0, 1.4, 7.0), 1)
    for event in (
        {"t": t, "kind": "trigger", "episode": n},
        {"t": t, "kind": "candidate"},
        {"t": t, "kind": "candidate"},
        {"t": t + 0.2, "kind": "candidate"},
        {"t": t + 0.2, "kind": "end", "episode": n},
    )
]
LATENCIES = ((0.1, 0.2), (0.4,), (1.0, 2.0), (4.0,), (10.0, 20.0), (40.0,))


@pytest.mark.parametrize(
    ("estimator", "t", "seconds"),
    [
        ("target", 1.1, None),
        ("target", 1.5, 0.7),  # the second has begun but not ended
        ("target", 5.0, 7.0),
        ("paper", 8.0, 70.0),
        ("sqp", 5.0, 4.0),
    ],
)
def test_the_prediction_time_is_of_the_last_whole_episode(estimator: str, t: float, seconds: float | None) -> None:
    run = quadrotor(estimator, latencies=LATENCIES)
    assert prediction_time(run, EPISODES, t) == (seconds if seconds is None else pytest.approx(seconds))
    assert prediction_time(run, EPISODES[:-2], t) is None, "a record that is cut short"


def test_between_episodes_the_estimate_is_what_the_controller_holds() -> None:
    run = quadrotor("target", latencies=LATENCIES)
    held = run["controller.m"].copy()
    held[330:] = 4.0  # followed since the second episode, which ended at 1.6 s
    run = replace(run, series=dict(run.series) | {"controller.m": held})
    found = measured(run, EPISODES, 5.0)
    assert found is not None
    assert found["estimate"] == [4.0, *HELD[1:]]


def test_the_estimate_is_the_last_whole_episodes_and_not_a_candidate() -> None:
    run = quadrotor("paper", latencies=LATENCIES)
    held = run["controller.m"].copy()
    held[141:160] = 4.0  # within the second episode
    run = replace(run, series=dict(run.series) | {"controller.m": held})
    found = measured(run, EPISODES, 1.5)
    assert found is not None
    assert found["estimate"] == list(HELD)
    assert found["mass_error"] == pytest.approx(0.5)
    assert found["inertia_error"] == pytest.approx(0.5)
    assert measured(DIVERGED, [], 5.0) is None


def test_the_table_sets_what_the_paper_prints_beside_what_was_measured() -> None:
    table = rows(ALL, dict.fromkeys(ALL, EPISODES))
    assert [(r["t"], r["estimator"]) for r in table[:4]] == [(1.5, n) for n in ("paper", "ipm-scipy", "sqp", "target")]
    assert len(table) == 5 * 4
    lines = markdown(ALL, table, LABELS, jobs=2).splitlines()
    assert "2 runs, which slow one another, at a time" in lines[2]
    errors = [[c.strip() for c in line.split("|")[1:-1]] for line in lines if re.match(r"\| \d", line)][:20]
    by_place = {(row[0], row[1]): row[2:] for row in errors}
    assert by_place["1.5", LABELS["paper"]][::2] == ["0.185", "1.255", "0.324"]
    assert by_place["8", LABELS["ipm-scipy"]][:4:2] == ["0.7622", "3.212"]
    assert by_place["8", LABELS["target"]] == ["-", "0.5", "-", "0.5", "-", "-"]
    assert by_place["5", LABELS["sqp"]][1::2] == ["-", "-", "-"], "its run had diverged"
    widths = [line.count("|") for line in lines if line.startswith("|")]
    assert set(widths[:22]) == {9}
    assert set(widths[22:]) == {11}


def test_the_quoted_table_is_whole() -> None:
    assert [(r.t, r.method) for r in PAPER_ROWS] == [(t, m) for t in PAPER_TRUTH for m in ("BO", "IPM", "SQP")]
    assert tuple(PAPER_TRUTH) == Scenario.load("quadrotor", GONE).estimation.instants
    sums = [sum(getattr(r, f) for r in PAPER_ROWS) for f in ("mass_error", "inertia_error", "prediction_time")]
    assert sums == pytest.approx([4.369, 80.028, 1.984])  # added up from the LaTeX source by another parser
    assert sum(sum(r.estimate) for r in PAPER_ROWS) == pytest.approx(179.38)


@pytest.mark.full
def test_files_are_written_whole_and_hold_what_is_drawn(tmp_path: Path) -> None:
    paths = draw_figures(tmp_path, {"none": pendulum("none"), "target": pendulum()}, ALL, seed=3)
    assert sorted(tmp_path.iterdir()) == sorted(paths)
    names = {"illustration", "pendulum-tracking", "quadrotor-mse", "quadrotor-altitude"}
    assert {p.name for p in paths} == {f"{n}.{e}" for n in names for e in ("png", "svg")} | {"table.md", "figures.json"}
    for path in paths:
        if path.suffix == ".png":
            with Image.open(path) as image:
                assert min(image.size) > 300
                image.load()
        if path.suffix == ".svg":
            assert ElementTree.parse(path).getroot().tag.endswith("svg")

    def refuse(text: str) -> None:
        raise AssertionError(f"{text} is not JSON")

    numbers = json.loads((tmp_path / "figures.json").read_text(), parse_constant=refuse)
    assert {n: r["mse"] for n, r in numbers["quadrotor"].items()} == {n: pytest.approx(r.mse) for n, r in ALL.items()}
    assert numbers["quadrotor"]["sqp"]["diverged_at"] == pytest.approx(4.2)
    assert numbers["quadrotor"]["none"]["altitude_error"] == pytest.approx({"rms": 3.0, "largest": 3.0})
    assert numbers["table"][0]["paper"]["mass_error"] == 0.185
    assert [len(s["x"]) for s in numbers["illustration"]["stages"]] == [3, 4, 5, 6, 7, 8]


def test_an_svg_is_the_same_bytes_for_the_same_figure(tmp_path: Path) -> None:
    written = []
    for name in ("a.svg", "b.svg"):
        figure = new_figure(3.0, 2.0)
        figure.subplots().plot([0.0, 1.0], clip_on=True)
        written.append(save_svg(figure, tmp_path / name).read_bytes())
    assert written[0] == written[1]
    assert b"<dc:date>" not in written[0]


def test_ipopt_is_preferred_and_its_stand_in_is_named() -> None:
    without = ("target", "paper", "ipm-scipy", "sqp", "ukf")
    assert set(chosen((*without, "ipm"))) == {"target", "paper", "ipm", "sqp", "none", "true"}
    assert set(chosen(without)) == {"target", "paper", "ipm-scipy", "sqp", "none", "true"}
    assert "without Ipopt" in LABELS["ipm-scipy"]


@pytest.mark.full
@pytest.mark.fmu
@pytest.mark.usefixtures("leaves_nothing")
def test_the_runs_are_made_in_processes_of_their_own_and_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    short = {"scenario.stop_time": "0.2", 'changes."plant.m"': "[[0.0, 1.75], [0.05, 4.271]]"}
    scenarios = (Scenario.load("pendulum", short), Scenario.load("quadrotor", {"scenario.stop_time": "0.05"}))
    monkeypatch.setattr("cosim.paper.figures.PENDULUM", ("target", "none"))
    monkeypatch.setattr("cosim.paper.figures.QUADROTOR", ("target", "true"))
    seen: list[tuple[str, str, int, int]] = []
    paths = figures(
        tmp_path / "out", 3, 2, lambda r, k, n: seen.append((r["scenario"], r["estimator"], k, n)), scenarios
    )
    assert sorted(seen)[0][:2] == ("pendulum", "none")
    assert [s[2:] for s in seen] == [(k, 4) for k in (1, 2, 3, 4)]
    assert all(p.is_file() for p in paths)
    assert {p.stem for p in paths} >= {"pendulum-solution", "pendulum-tracking", "quadrotor-mse", "table"}
    numbers = json.loads((tmp_path / "out" / "figures.json").read_text())
    run = numbers["pendulum"]["target"]
    assert (run["run"], run["seed"], run["status"], numbers["jobs"]) == ("runs/pendulum-target", 3, "done", 2)
    assert run["evaluations"] > 0
    recorded = json.loads((tmp_path / "out" / run["run"] / "result.json").read_text())
    assert {k: run[k] for k in recorded if k != "run"} == {k: v for k, v in recorded.items() if k != "run"}


@pytest.mark.full
@pytest.mark.fmu
@pytest.mark.usefixtures("leaves_nothing")
def test_a_run_that_is_refused_is_one_line_and_leaves_no_process(tmp_path: Path) -> None:
    wrong = Scenario.load("quadrotor", {'connections."plant.F"': "controller.g"})
    with pytest.raises(StudyError, match=r"quadrotor.*seed 0: .*no output of controller") as caught:
        figures(tmp_path / "out", jobs=2, scenarios=(Scenario.load("pendulum"), wrong))
    assert len(str(caught.value).splitlines()) == 1


def test_a_folder_that_is_not_empty_is_refused_before_anything_runs(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("kept")
    with pytest.raises(FolderError, match="is not empty"):
        figures(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]
