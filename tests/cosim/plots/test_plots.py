"""Figures: drawn for what a run can be at its worst, and the numbers behind them are right."""

import dataclasses
import json
from itertools import pairwise
from math import sin
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image
from scipy.optimize import minimize_scalar

from cosim import Run, Scenario, run
from cosim.errors import FolderError
from cosim.paper.illustration import global_minimum, illustrate, optimise, unknown
from cosim.plots.canvas import label, set_log
from cosim.plots.overlay import columns_of, draw_overlay, plot_run
from cosim.plots.palette import BASELINES, BLACK, RUNS
from cosim.plots.panels import Curve, panels
from cosim.plots.ranges import tame, value_range
from cosim.plots.response import response_surface
from cosim.plots.runs import draw_run, draw_tracking
from cosim.runs.result import Status
from cosim.variable_name import VariableName
from estimator import Sample
from tests.cosim.plots.made_up import GONE, made_up_run

OVER_TIME = {"tracking.png", "error.png", "parameters.png"}


def write_events(folder: Path, *events: object) -> None:
    (folder / "events.jsonl").write_text("".join(json.dumps(e) + "\n" for e in events))


def check_pictures(paths: list[Path]) -> set[str]:
    """Names of files that are whole PNGs and larger than a thumbnail."""
    for path in paths:
        with Image.open(path) as image:
            assert image.format == "PNG"
            assert min(image.size) > 300
            image.load()
    return {path.name for path in paths}


@pytest.mark.full
@pytest.mark.fmu
def test_a_run_of_the_pendulum_has_all_four_figures(tmp_path: Path) -> None:
    scenario = Scenario.load("pendulum", {"scenario.stop_time": "3.6"})
    result = run(scenario, "target", 0, out=tmp_path)
    baselines = {name: run(scenario, name, 0) for name in ("none", "true")}
    before = {p.name for p in tmp_path.iterdir()}
    paths = draw_run(result, baselines)
    assert check_pictures(paths) == OVER_TIME | {"response.png"}
    assert {p.name for p in tmp_path.iterdir()} == before | {p.name for p in paths}, "a temporary file is left"
    first = [p.read_bytes() for p in paths]
    assert [p.read_bytes() for p in draw_run(result, baselines)] == first


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_run_of_few_rows_is_drawn(tmp_path: Path, n: int) -> None:
    assert check_pictures(draw_run(made_up_run(tmp_path, n), {})) == OVER_TIME


def test_a_run_without_a_row_is_not_drawn(tmp_path: Path) -> None:
    assert draw_run(made_up_run(tmp_path, 0), {}) == []


def test_a_baseline_without_a_row_is_left_out(tmp_path: Path) -> None:
    assert check_pictures(draw_run(made_up_run(tmp_path), {"none": made_up_run(None, 0)})) == OVER_TIME


HUGE = np.where(np.arange(50) < 40, 1.0, 1e300)


@pytest.mark.full_but("nan")
@pytest.mark.parametrize(
    "columns",
    [
        {"plant_phi": np.nan, "controller_m": np.nan, "plant_m": np.nan},
        {"plant_phi": HUGE, "controller_m": HUGE, "plant_l": HUGE},
        {"plant_phi": -HUGE, "reference_phi_ref": HUGE},
        {"plant_phi": np.inf, "controller_m": -np.inf, "controller_l": 0.0},
        {"plant_phi": np.inf, "reference_phi_ref": np.inf},
        {"plant_phi": 1.0, "reference_phi_ref": 1.0, "controller_m": 1.0, "plant_m": 1.0},
        {"plant_phi": 0.0, "reference_phi_ref": 5e-324, "controller_l": -1.0},
    ],
    ids=["nan", "huge", "huge-difference", "infinite", "infinite-both", "constant", "denormal"],
)
def test_whatever_the_values_they_are_drawn(tmp_path: Path, columns: dict[str, object]) -> None:
    bad = made_up_run(tmp_path, **columns)
    assert check_pictures(draw_run(bad, {"none": bad, "true": made_up_run(None)})) == OVER_TIME


def test_events_that_say_little_or_are_cut_short_are_survived(tmp_path: Path) -> None:
    write_events(
        tmp_path,
        {"t": 0.1, "kind": "trigger"},
        {"t": 0.1, "kind": "candidate", "theta": [1.0, None], "cost": None},
        {"t": 0.1, "kind": "candidate"},
        {"t": 0.1, "kind": "write", "theta": [1.0, 1.0], "std": [None, 1e300]},
        {"t": None, "kind": "write"},
        {"t": 0.2, "kind": "something new"},
        [1, 2],
    )
    with open(tmp_path / "events.jsonl", "a", encoding="utf-8") as file:
        file.write('{"t": 0.3, "kind": "cand')
    assert check_pictures(draw_run(made_up_run(tmp_path), {})) == OVER_TIME | {"response.png"}


@pytest.mark.full
def test_seven_outputs_with_long_and_odd_names_are_drawn(tmp_path: Path) -> None:
    names = [f"plant.{'very_long_' * 6}name[{i}].$x^_{{" for i in range(7)]
    tracking = dict.fromkeys(map(VariableName, names), VariableName("reference.phi_ref"))
    scenario = Scenario.load("pendulum", GONE).model_copy(update={"tracking": tracking})
    base = made_up_run(tmp_path, scenario=scenario)
    series = dict(base.series) | dict.fromkeys(names, base["plant.phi"])
    run_ = Run(**{f: getattr(base, f) for f in Run.__dataclass_fields__} | {"series": series})
    assert check_pictures(draw_run(run_, {"none": run_})) == OVER_TIME


def test_the_picture_of_the_tracking_has_the_input_the_title_and_what_the_guard_refused() -> None:
    made_up = made_up_run(None)
    events = [{"t": 0.1, "kind": "veto"}, {"t": 0.3, "kind": "veto"}, {"t": 0.2, "kind": "revert"}]
    figure = draw_tracking(made_up, [Curve(made_up, "mine", RUNS[0], 2.0)], events)
    above, below = figure.axes
    assert (above.get_ylabel(), below.get_ylabel()) == (r"$\phi$", "$u$")
    drawn = next(line for line in below.lines if line.get_label() == "mine")
    np.testing.assert_array_equal(drawn.get_ydata(), made_up["held.plant.u"])
    marks = {line.get_label(): list(line.get_xdata()) for line in below.lines if line.get_marker() in "xv"}
    assert marks == {"refused by the guard": [0.1, 0.3], "reverted": [0.2]}
    (legend,) = figure.legends
    assert legend.get_title().get_text() == "pendulum, target, seed 0"


def test_runs_laid_over_one_another_are_told_apart_without_colour() -> None:
    runs = [made_up_run(None), dataclasses.replace(made_up_run(None), seed=1)]
    figure = draw_overlay(runs)
    assert [legend.get_title().get_text() for legend in figure.legends] == ["pendulum, target"]
    assert [axes.get_ylabel() for axes in figure.axes] == [r"$\phi$", "$u$", "$m$ [kg]", "$l$ [m]"]
    for axes in figure.axes:
        styles = {line.get_label(): line.get_linestyle() for line in axes.lines if "seed" in str(line.get_label())}
        assert set(styles) == {"seed 0", "seed 1"}
        assert styles["seed 0"] != styles["seed 1"]
    dashes = [style.dashes for style in (*RUNS, *(style for _, style in BASELINES.values()))]
    assert len(set(dashes)) >= len(RUNS)


@pytest.mark.parametrize("names", [{}, {"m": "mass", "l": "length"}], ids=["same-names", "other-names"])
def test_each_run_has_the_band_of_its_own_parameter(tmp_path: Path, names: dict[str, str]) -> None:
    """The second run has its parameters in the other order."""
    scenario = Scenario.load("pendulum", GONE)
    parameters = [
        p.model_copy(update={"name": names.get(p.name, p.name), "true": VariableName(f"plant.{p.name}")})
        for p in reversed(scenario.estimation.parameters)
    ]
    estimation = scenario.estimation.model_copy(update={"parameters": parameters})
    runs: list[Run] = []
    for name, estimated, theta in (("a", scenario.estimation, [1.0, 2.0]), ("b", estimation, [2.0, 1.0])):
        (tmp_path / name).mkdir()
        write_events(tmp_path / name, {"t": 0.1, "kind": "write", "theta": theta, "std": [0.1, 0.1]})
        runs.append(made_up_run(tmp_path / name, scenario=scenario.model_copy(update={"estimation": estimated})))
    for axes, value in zip(draw_overlay(runs).axes[2:], (1.0, 2.0), strict=True):
        edges = [band.get_paths()[0].vertices[:, 1] for band in axes.collections]
        assert [np.sqrt(y.min() * y.max()) for y in edges] == pytest.approx([value, value])


@pytest.mark.parametrize(
    ("n", "status", "wanted", "is_own"),
    [
        (50, "done", 1.0, False),
        (50, "done", 2.0, True),
        (20, "diverged", 1.0, True),
        (20, "running", 1.0, False),
        (20, "running", 2.0, True),
    ],
    ids=["same", "other", "goes-on", "ahead", "other-ahead"],
)
def test_a_truth_and_a_reference_are_drawn_again_where_they_differ(
    n: int, status: Status, wanted: float, is_own: bool
) -> None:
    first = dataclasses.replace(made_up_run(None, n, plant_m=1.0, reference_phi_ref=1.0), status=status)
    other = dataclasses.replace(made_up_run(None, plant_m=wanted, reference_phi_ref=wanted), seed=1)
    phi, _, m, _ = draw_overlay([first, other]).axes
    for axes, text in ((phi, "reference"), (m, "truth")):
        drawn = {str(line.get_label()): line for line in axes.lines if str(line.get_label()).startswith(text)}
        colours = {text: BLACK} | ({f"{text}, seed 1": RUNS[1].colour} if is_own else {})
        assert {key: line.get_color() for key, line in drawn.items()} == colours
        assert max(float(np.max(line.get_ydata())) for line in drawn.values()) == wanted


def test_the_axis_of_time_has_all_runs() -> None:
    longer = Scenario.load("pendulum", GONE | {"scenario.stop_time": "12.0"})
    figure = draw_overlay([made_up_run(None), made_up_run(None, scenario=longer)])
    assert {axes.get_xlim() for axes in figure.axes} == {(0.0, 12.0)}


def test_a_run_is_drawn_on_the_axes_that_are_given_and_on_new_ones() -> None:
    made_up, figure = made_up_run(None), Figure()
    axes = figure.subplots()
    assert plot_run(made_up, ["plant.phi"], axes) is axes
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), made_up["plant.phi"])
    assert len(plot_run(made_up, [], list(figure.subplots(4)))) == len(columns_of(made_up)) == 4
    with pytest.raises(KeyError, match=r"no column 'plant\.phy'; did you mean 'plant.phi'"):
        plot_run(made_up, ["plant.phy"], axes)
    with pytest.raises(ValueError, match="2 columns need as many axes, got 1"):
        plot_run(made_up, ["plant.phi", "plant.m"], axes)


def test_a_run_of_the_users_own_estimator_is_drawn(tmp_path: Path) -> None:
    assert check_pictures(draw_run(made_up_run(tmp_path, estimator="mine:Estimator"), {})) == OVER_TIME


def test_a_run_without_a_folder_is_refused() -> None:
    with pytest.raises(ValueError, match="run it with `out`"):
        draw_run(made_up_run(None), {})


def test_a_folder_that_is_gone_is_named(tmp_path: Path) -> None:
    with pytest.raises(FolderError, match=r"cannot write .*tracking\.png: No such file"):
        draw_run(made_up_run(tmp_path / "gone"), {})


def test_episodes_that_follow_one_another_are_shaded_as_one(tmp_path: Path) -> None:
    made_up = made_up_run(tmp_path)
    events = [{"t": t, "kind": "candidate"} for t in (0.10, 0.11, 0.12, 0.30, 0.31)]
    _, (axes,) = panels(made_up, events, 1)
    assert [(p.get_x(), p.get_x() + p.get_width()) for p in axes.patches] == [
        pytest.approx((0.10, 0.12)),
        pytest.approx((0.30, 0.31)),
    ]


def test_the_response_surface_is_least_at_the_true_parameters() -> None:
    scenario = Scenario.load("pendulum")
    m, l, b, g = 2.0, 0.8, 0.1, 9.81
    states = [(0.2, 1.0, 3.0), (1.0, -2.0, 10.0), (-0.7, 0.5, -6.0)]
    samples = [Sample(0.0, (p, v), (u,), (-g / l * sin(p) - b / m * v + u / (m * l),)) for p, v, u in states]
    masses, lengths, level = response_surface(made_up_run(None, scenario=scenario), samples)
    row, column = np.unravel_index(np.argmin(level), level.shape)
    assert masses[column] == pytest.approx(m, rel=np.log(50.0) / 59)  # half a step of the grid, and a valley
    assert lengths[row] == pytest.approx(l, rel=np.log(30.0) / 59)


@pytest.mark.parametrize(
    ("name", "unit", "text"),
    [
        ("phi", "rad", r"$\phi$ [rad]"),
        ("J_x", "kg.m2", "$J_{x}$ [kg m²]"),
        ("r_x", "m/s2", "$r_{x}$ [m/s²]"),
        ("gain", "s-1", "gain [s⁻¹]"),
        ("cost$", "1", r"cost\$"),
        ("x" * 60, None, "x" * 14 + "…" + "x" * 13),
    ],
)
def test_labels_are_set_as_in_print(name: str, unit: str | None, text: str) -> None:
    assert label(name, unit) == text


def test_values_off_the_axes_stay_finite_and_off_the_axes() -> None:
    y = tame([np.nan, np.inf, -1e300, 0.5, 1e300], (0.0, 1.0))
    assert np.isnan(y[:2]).all()
    assert y[2] < 0.0
    assert y[3] == 0.5
    assert y[4] > 1.0
    assert np.isnan(tame([-1.0, 0.0], (0.1, 1.0), is_log=True)).all()
    assert value_range([[np.nan], [np.inf, 1e300]]) is None


@pytest.mark.parametrize("limits", [(1.2, 1.3), (0.5, 4.0), (0.1, 12.0), (1e-9, 1.0), (1e-3, 1e30)])
def test_a_logarithmic_axis_has_between_three_and_eight_ticks(limits: tuple[float, float], tmp_path: Path) -> None:
    figure, (axes,) = panels(made_up_run(tmp_path), [], 1)
    shown = set_log(axes, "y", limits)
    figure.draw_without_rendering()
    assert 3 <= sum(shown[0] <= t <= shown[1] for t in axes.get_yticks()) <= 8


def test_the_illustrations_minimum_is_its_least() -> None:
    found = minimize_scalar(unknown, bounds=(0.1, 0.4), method="bounded", options={"xatol": 1e-10})
    place, value = global_minimum()
    assert place == pytest.approx(found.x, abs=0.001)  # half a step of the grid
    assert value == pytest.approx(found.fun, abs=1e-4)
    x = np.linspace(0.0, 1.0, 5001)
    assert unknown(x).min() >= found.fun - 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_eight_evaluations_find_the_global_minimum(seed: int) -> None:
    stages = optimise(seed, 8)
    assert [len(s.x) for s in stages] == [3, 4, 5, 6, 7, 8]
    assert stages[-1].best_place == pytest.approx(global_minimum()[0], abs=0.03)
    for stage, later in pairwise(stages):
        assert later.x[-1] == stage.next_place
        assert np.all(stage.improvement >= -1e-12)


def test_the_illustration_is_a_picture_and_the_same_for_the_same_seed(tmp_path: Path) -> None:
    path = illustrate(tmp_path / "a.png")
    assert check_pictures([path]) == {"a.png"}
    assert illustrate(tmp_path / "b.png").read_bytes() == path.read_bytes()


def test_too_few_evaluations_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 3"):
        optimise(0, 2)
