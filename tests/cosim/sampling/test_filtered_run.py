"""Runs whose derivatives come from a filter: on a plant that has none, what is recorded, and how well it re-tunes."""

from pathlib import Path

import numpy as np
import pytest

from cosim.authoring.check import check
from cosim.campaigns.compare import compare
from cosim.campaigns.replay import replayed
from cosim.errors import CosimError, ScenarioError
from cosim.estimator_fmu.settings import estimator_settings
from cosim.runs.result import read_run
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario

pytestmark = pytest.mark.fmu

STATE_VARIABLE = {"sampling.filter": '{ kind = "state-variable", cutoff = 60.0 }'}
FILTER = 'filter = { kind = "savitzky-golay", points = 9, order = 3 }\n'
SAMPLED = f"""[sampling]
derivatives = {{ "plant.der(mass.v)" = {{ of = "plant.mass.v" }} }}
states = {{ "plant.mass.v" = {{ noise = 1e-5 }}, "plant.mass.s" = {{ noise = 1e-5 }} }}
{FILTER}"""


@pytest.fixture
def bare(axis, bare_axis) -> Path:
    """The scenario of an axis that declares no derivatives."""
    return axis(
        ("stop_time = 1.0", "stop_time = 4.0"),
        ('"Axis.fmu"', '"BareAxis.fmu"'),
        ('"controller.vRef" = "reference.v_ref"\n', ""),
        ("[0.3, 3.0]", "[1.0, 3.0]"),
        ('[sampling.derivatives]\n"plant.der(mass.v)" = { noise = 1e-3 }\n', SAMPLED),
        ('trigger = { kind = "innovation" }', 'trigger = { kind = "innovation" }\nbudget = 100'),
        steps="\n".join(f"{t}, {s}, 0" for k in range(4) for t, s in ((k, k % 2), (k + 1, k % 2))),
    )


@pytest.mark.full_but("target-savitzky-golay")
@pytest.mark.parametrize("overrides", [{}, STATE_VARIABLE], ids=["savitzky-golay", "state-variable"])
@pytest.mark.parametrize("estimator", ["target", "least-squares"])
def test_the_mass_of_an_axis_without_derivatives_is_found(bare, overrides, estimator):
    result = run(Scenario.load(bare, overrides), estimator)
    assert result["controller.m"][90] == pytest.approx(2.0, rel=0.01)  # no false alarm of consequence before the change
    assert result["controller.m"][-1] == pytest.approx(3.0, rel=0.01)
    assert result.n_episodes >= 1


WRONG_STATES = {
    "stuck": ('{ kind = "stuck", sensor = "plant.mass.v", start = 0.5 }', "stuck plant.mass.v"),
    "in a wrong unit": ('{ kind = "scale", sensor = "plant.mass.v", size = 3.6 }', "inconsistent plant.mass.s"),
    "late": ('{ kind = "late", steps = 3, start = 0.5 }', "late sample"),
}


@pytest.mark.parametrize(("fault", "told"), WRONG_STATES.values(), ids=WRONG_STATES)
def test_nothing_is_written_for_a_state_whose_sensor_is_wrong(bare, fault, told):
    """Neither the plant nor its controller has anything to do with it: only what the filter gets is wrong."""
    overrides = {"sampling.faults": f"[{fault}]", "changes": '{ "plant.mass.m" = 2.0 }'}
    result = run(Scenario.load(bare, overrides), "target")
    assert told in result.observations["found"]
    assert result["controller.m"][-1] == 2.0


FRICTION = {
    "scenario.stop_time": "2.9",  # before anything changes
    "sampling": (
        '{ derivatives = { "plant.der(phi_dot)" = { of = "plant.phi_dot" } }, '
        'filter = { kind = "savitzky-golay", points = 9, order = 3 }, '
        'states = { "plant.phi" = { noise = 1e-4 }, "plant.phi_dot" = { noise = 1e-4 } } }'
    ),
}


@pytest.mark.full_but("0-target")
@pytest.mark.parametrize("estimator", ["target", "least-squares"])
@pytest.mark.parametrize("seed", range(3))
def test_friction_and_a_dead_band_within_a_filter_s_mean_are_no_changed_parameters(tmp_path, estimator, seed):
    """Neither where it runs nor where it is replayed: the true parameters explain each sample that is judged."""
    result = run(Scenario.load("stiction", FRICTION), estimator, seed, _new(tmp_path))
    assert result.n_episodes == 0
    assert [result.diagnosis[kind] for kind in ("disturbance", "unexplained", "rest")] == [0, 0, 0]
    assert replayed(read_run(tmp_path / "run"), estimator, seed).n_episodes == 0


SPEEDS = [f"plant.{name}" for name in ("v_x", "v_y", "v_z", "Omega_x", "Omega_y", "Omega_z")]
PLACES = [f"plant.{name}" for name in ("r_x", "r_y", "r_z", *(f"R_{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)))]


@pytest.mark.full
@pytest.mark.parametrize(
    ("seed", "n_points", "every", "noisy", "budget"),
    [(1, 9, 8, SPEEDS, 30), (3, 11, 11, [*PLACES, *SPEEDS], 150), (2, 11, 5, [*PLACES, *SPEEDS], 30)],
)
def test_a_jump_soon_after_a_drift_is_found(seed, n_points, every, noisy, budget):
    """The mass drifts for seconds, so that samples are suspicious all the time: that a search has failed follows from
    those since it began. It began on a mean over the jump at t = 9 s, which no parameters explain; of samples that
    overlap there are two."""
    derivatives = {f"plant.der({name.removeprefix('plant.')})": {"of": name} for name in SPEEDS}
    states = {name: {"noise": 1e-4} for name in noisy}
    points = {"kind": "savitzky-golay", "points": n_points, "order": 3, "every": every}
    sampling = {"derivatives": derivatives, "filter": points, "states": states}
    settings = {"scenario.stop_time": 9.6, "sampling": sampling, "estimation.budget": budget}
    result = run(Scenario.load("quadrotor", settings), "target", seed)
    assert result.diagnosis["rest"] == 0
    assert result["plant.m"][[890, 960]].round(2).tolist() == [1.33, 2.1]
    assert result["controller.m"][[890, 930, 960]] == pytest.approx(result["plant.m"][[890, 930, 960]], rel=0.02)


def test_what_the_filter_made_is_recorded_with_its_time_beside_what_was_measured(bare, tmp_path):
    """Against NumPy's fit of a polynomial to the points measured, not SciPy's coefficients."""
    result = run(Scenario.load(bare, {"scenario.stop_time": "1.0"}), "none", out=_new(tmp_path))
    rows = np.flatnonzero(np.isfinite(result["filtered.time"]))
    assert rows.tolist() == list(range(8, 101, 8))
    assert result["filtered.time"][rows] == pytest.approx(result.time[rows] - 0.04)
    measured = result["sampled.plant.mass.v"]
    assert np.std(measured - result["plant.mass.v"]) == pytest.approx(1e-5, rel=0.3)
    for k in rows:
        points = slice(k - 8, k + 1)
        fit = np.polynomial.Polynomial.fit(result.time[points], measured[points], 3)
        assert result["filtered.plant.der(mass.v)"][k] == pytest.approx(fit.deriv()(result.time[k] - 0.04), rel=1e-6)
        forces = result["held.plant.f"][k - 7 : k + 1]
        assert forces.min() - np.ptp(forces) <= result["filtered.plant.f"][k] <= forces.max() + np.ptp(forces)
    assert "nan" not in (tmp_path / "run" / "result.json").read_text().lower()


def _new(folder: Path) -> Path:
    (folder / "run").mkdir()
    return folder / "run"


@pytest.mark.full
def test_compare_runs_on_filtered_derivatives(bare):
    comparison = compare(Scenario.load(bare, {"scenario.stop_time": "2.0"}), ["target"], 2, jobs=1)
    assert len(comparison.runs) == 6
    assert {record["status"] for record in comparison.runs} == {"done"}


@pytest.mark.full
def test_the_pendulum_is_re_tuned_from_sampled_states():
    """Its mean squared error is 0.32 rad^2 as it is; with measured derivatives 0.0005, here 0.0018 to 0.0035."""
    overrides = {
        "sampling.derivatives": '{ "plant.der(phi_dot)" = { of = "plant.phi_dot" } }',
        "sampling.states": '{ "plant.phi" = { noise = 1e-4 }, "plant.phi_dot" = { noise = 1e-4 } }',
        "sampling.filter": '{ kind = "savitzky-golay" }',
        "scenario.stop_time": "6.0",
    }
    result = run(Scenario.load("pendulum", overrides))
    assert result.mse[0] < 0.01
    assert result["controller.m"][-1] == pytest.approx(4.271, rel=0.02)
    assert result["controller.l"][-1] == pytest.approx(0.981, rel=0.02)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        pytest.param({"sampling.filter": '{ kind = "savitzky-golay", points = 4 }'},
                     r"sampling\.filter: points must be odd and more than order, got 4 and 3", id="even"),
        pytest.param({"sampling.filter": '{ kind = "savitzky-golay", order = 11 }'},
                     "more than order, got 11 and 11", id="too few for the order"),
        pytest.param({"sampling.filter": '{ kind = "butterworth" }'}, r"sampling\.filter", id="no such kind"),
        pytest.param({"sampling.filter.pionts": "5"}, r"sampling\.filter\.pionts: unknown key; did you mean 'points'",
                     id="misspelt"),
        pytest.param({"sampling.filter": '{ kind = "state-variable" }'}, r"sampling\.filter\.cutoff", id="no cutoff"),
        pytest.param({"sampling.filter": '{ kind = "state-variable", cutoff = 1e-6 }'},
                     r"sampling\.filter\.cutoff: must be 0\.187 rad/s at least, got 1e-06", id="endless"),
        pytest.param({"sampling.filter.points": "100001"}, r"sampling\.filter\.points: .*5001", id="too many points"),
        pytest.param({'sampling.derivatives."plant.der(mass.v)"': "{ noise = 1.0 }"}, "must say of which state",
                     id="of nothing"),
        pytest.param({'sampling.states."plant.mass.v".noise': "0"}, "'plant.mass.v' must have noise > 0",
                     id="without noise"),
        pytest.param({"sampling.outputs": '{ "plant.mass.s" = { noise = 1.0 } }',
                      "sampling.states": '{ "plant.mass.v" = { noise = 1e-5 } }'}, "roll-outs", id="outputs too"),
    ],
)  # fmt: skip
def test_a_filter_that_cannot_be_is_refused_in_one_line(bare, overrides, message):
    with pytest.raises(ScenarioError, match=message) as refused:
        Scenario.load(bare, overrides)
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        pytest.param({'sampling.states."plant.mass.q".noise': "1.0"}, r"plant\.mass\.q", id="no such state"),
        pytest.param({'sampling.states."plant.mass.m".noise': "1.0"}, r"plant\.mass\.m", id="a parameter"),
        pytest.param({'sampling.states."controller.f_cmd".noise': "1.0"}, r"controller\.f_cmd", id="another FMU's"),
    ],
)
def test_states_that_cannot_be_sampled_are_refused_and_found(bare, overrides, message):
    with pytest.raises(CosimError, match=message):
        run(Scenario.load(bare, overrides), "none")
    assert any(f.is_error and message.replace("\\", "") in str(f) for f in check(bare, overrides))


def test_without_a_filter_a_derivative_of_a_state_is_refused(bare):
    bare.write_text(bare.read_text().replace(FILTER, ""))
    with pytest.raises(ScenarioError, match=r"must have noise > 0, or sampling\.filter, which makes it"):
        Scenario.load(bare)


def test_the_estimator_fmu_has_no_filter_and_says_so(bare):
    with pytest.raises(ScenarioError, match=r"sampling\.filter cannot be built into an FMU"):
        estimator_settings(Scenario.load(bare))


WARNED = {
    "hardly smooths": (
        {"sampling.filter": '{ kind = "savitzky-golay", points = 5, order = 3 }'},
        "hardly smooths: 67%",
    ),
    "shared noise": ({"sampling.filter.every": "2"}, "samples every 2 points share noise, up to 8 points apart"),
    "few samples an episode": ({"estimation.budget": "30"}, "30 evaluations, 1 per macro step, sees 3 samples"),
    "long for the plant": ({"sampling.filter.points": "201"}, "time constant of the plant is 0.5 s"),
    "the states' own noise": (
        {'sampling.states."plant.mass.s".noise': "1e-3"},
        "through the model the states' noise adds",
    ),
}


@pytest.mark.parametrize(("overrides", "message"), WARNED.values(), ids=WARNED)
def test_settings_that_do_not_fit_are_warned_of(bare, overrides, message):
    """sqrt(c/m) = 2 rad/s."""
    assert [f for f in check(bare) if "sampling" in f.where or "budget" in f.where] == []
    assert any(message in str(f) and not f.is_error for f in check(bare, overrides))


def test_a_filter_longer_than_the_run_is_an_error(bare):
    (found,) = [f for f in check(bare, {"scenario.stop_time": "0.05"}) if f.is_error]
    assert "it needs 9 points, and the run ends before" in found.what
