"""Logs taken sample by sample, against closed forms and a Kalman filter."""

import csv
import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from pythonfmu import FmuBuilder
from scipy.linalg import expm

import cosim
from cosim.cli import main
from cosim.objectives.rollout import RolloutObjective
from cosim.objectives.rollout_fmu import Shadow
from cosim.objectives.rollout_start import NoisyStartObjective
from cosim.offline.online import run_online
from cosim.offline.online_report import report, summary
from cosim.offline.request import EstimateError, Request, Sought
from cosim.ssv.document import read_ssv
from estimator import Sample, SampleSequence

pytestmark = pytest.mark.fmu
MASS, DAMPER, SPRING = Sought("m", 0.5, 4.0), Sought("c", 0.05, 5.0, "log"), Sought("k", 5.0, 60.0, "log")
KNOWN = {"m": 1.7, "c": 0.9, "k": 23.0}
STATES = {"x": "x", "v": "v"}


@pytest.fixture
def ask(plant, tmp_path, oracles):
    """ask(columns, n_samples, **changes): what happens over a log of these columns, states measured."""

    def asked(columns, n_samples=50, per_sample=1, **changes):
        path = oracles.write_log(tmp_path / f"{len(list(tmp_path.iterdir()))}.csv", columns)
        settings = {
            "fmu": plant, "logs": (path,), "parameters": (MASS, DAMPER), "measured": {"x": "x", "v": "v"},
            "inputs": {"F": "force"}, "start": KNOWN | STATES, "evaluations": 30,
        }  # fmt: skip
        return run_online(Request(**settings | changes), n_samples, n_per_sample=per_sample)

    return asked


def of(watched, kind):
    return [event for event in watched.events if event.kind == kind]


@pytest.mark.full
def test_the_function_of_the_library_is_the_command_with_keywords(ask, plant, oracles, tmp_path):
    columns = {name: values[:120] for name, values in oracles.measure(0).items()}
    expected = ask(columns, 20, per_sample=2, evaluations=10)
    found = cosim.estimate_online(
        plant, expected.request.logs, {"m": (0.5, 4.0), "c": (0.05, 5.0, "log")}, {"x": "x", "v": "v"}, {"F": "force"},
        samples=20, evaluations_per_sample=2, start=KNOWN | STATES, evaluations=10, out=tmp_path / "out",
    )  # fmt: skip
    assert found.watched[0].theta.tolist() == expected.watched[0].theta.tolist()
    assert [(e.t, e.kind) for e in found.watched[0].events] == [(e.t, e.kind) for e in expected.watched[0].events]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["estimates.ssv", "online.csv", "online.json"]
    with pytest.raises(EstimateError, match="must be 1 or more"):
        cosim.estimate_online(plant, expected.request.logs, {"m": (0.5, 4.0)}, {"x": "x"}, samples=0)


@pytest.mark.full
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_jump_is_seen_within_samples_and_the_new_values_are_written(ask, oracles, seed):
    (watched,) = ask(oracles.jump(seed), seed=seed).watched
    (trigger,) = of(watched, "trigger")
    assert 4.0 < trigger.t <= 4.1  # not before, ten samples at most after; and once
    last = of(watched, "write")[-1]
    z = (np.array(last.detail["theta"]) - [2.6, 1.4]) / last.detail["std"]
    assert np.abs(z).max() < 4.0  # the six numbers of all seeds: by chance once in 2500 suites
    assert max(last.detail["std"]) < 0.05
    assert watched.theta.tolist() == last.detail["theta"]
    full = trigger.t + 0.01 * int(trigger.detail["samples"].split()[-1])  # "... and the next 49"
    assert of(watched, "end")[0].t == pytest.approx(full)  # one evaluation: the comparison has found them


@pytest.mark.full
def test_an_episode_may_take_all_its_evaluations_at_one_sample(ask, oracles, command, capsys):
    """An event shorter than thirty samples is over before thirty evaluations at one each."""
    (watched,) = ask(oracles.jump(0, end=6.0), per_sample=30).watched
    (trigger,) = of(watched, "trigger")
    full = trigger.t + 0.01 * int(trigger.detail["samples"].split()[-1])  # "... and the next 49"
    assert of(watched, "end")[0].t == pytest.approx(full)
    assert watched.n_candidates == 30
    assert watched.theta == pytest.approx([2.6, 1.4], rel=0.05)
    assert command("--start", "x=x", "--start", "v=v", "--evaluations-per-sample", "30", "--json") == 0
    (window,) = json.loads(capsys.readouterr().out)["windows"]
    times = {kind: {e["time"] for e in window["events"] if e["event"] == kind} for kind in ("write", "end")}
    assert set() < times["write"] <= times["end"]


@pytest.mark.full
def test_without_a_jump_nothing_is_written(ask, oracles):
    for seed in (0, 1, 2):
        (watched,) = ask(oracles.measure(seed)).watched
        assert watched.events == ()
        assert watched.theta == pytest.approx([1.7, 0.9])
        assert watched.failure is None


@pytest.mark.full
def test_a_wrong_start_value_is_corrected_in_one_episode(ask, oracles):
    (watched,) = ask(oracles.measure(0), start={"k": 23.0} | STATES).watched  # m and c as the FMU starts: 1 and 0.5
    assert len(of(watched, "trigger")) == 1
    last = of(watched, "write")[-1]
    assert np.abs((watched.theta - [1.7, 0.9]) / last.detail["std"]).max() < 4.0


@pytest.mark.full
def test_a_fixed_parameter_is_estimated_where_states_are_measured(ask, oracles):
    (watched,) = ask(oracles.jump(0, m=1.7, c=0.9, k=30.0), parameters=(SPRING,)).watched
    (trigger,) = of(watched, "trigger")
    assert 4.0 < trigger.t <= 4.2
    last = of(watched, "write")[-1]
    assert abs(watched.theta[0] - 30.0) < 4.0 * last.detail["std"][0] < 2.0


def test_without_states_it_is_simulated_from_the_start(ask, oracles):
    columns = oracles.jump(0)
    columns["v [m/s]"][100:140] = np.nan  # not compared
    found = ask(columns, 100, start=KNOWN)
    (watched,) = found.watched
    assert "simulated again from the start" in watched.how
    assert 4.0 < of(watched, "trigger")[0].t <= 4.1
    assert watched.theta == pytest.approx([2.6, 1.4], rel=0.05)


@pytest.mark.parametrize("share", [0.4, 0.6])
def test_an_output_that_is_often_missing_has_not_failed(ask, oracles, share):
    columns = oracles.jump(0, end=5.0)
    columns["v [m/s]"][np.random.default_rng(1).random(501) < share] = np.nan
    (watched,) = ask(columns, start=KNOWN, noise={"x": 2e-3, "v": 2e-3}).watched
    assert watched.found["observations"] == {"kept_out": 0, "found": {}, "failed": []}
    assert 4.0 < of(watched, "trigger")[0].t <= 4.2


def at_rest_first(oracles, rest=1.0, seed=0):
    """A log of the plant that stands still until its force begins to move it."""
    rng, t = np.random.default_rng(seed), 0.01 * np.arange(301)
    force = np.where(t < rest, 0.0, oracles.pushes(t))
    x, v = (column + 2e-3 * rng.standard_normal(len(t)) for column in oracles.response(t, force, start=(0.0, 0.0)))
    return {"time [s]": t, "force [N]": force, "x [m]": x, "v [m/s]": v}


@pytest.mark.parametrize("rest", [1.0, pytest.param(0.0, marks=pytest.mark.full)])
def test_a_hidden_state_is_found_where_the_log_moves(ask, oracles, rest):
    """At rest a roll-out begun without the velocity continues alike: it passed, and triggered again and again."""
    (watched,) = ask(at_rest_first(oracles, rest), start=KNOWN | {"x": "x"}).watched
    assert "simulated again from the start" in watched.how
    assert "states are hidden" in watched.how
    assert watched.events == ()


@pytest.fixture(scope="session")
def heated(made_once):
    """A barrel whose melt's temperature is a slow state, 230 s: at first its start value is nearly right."""
    slave = Path(__file__).with_name("slow_state_slave.py")
    return made_once(lambda folder: FmuBuilder.build_FMU(slave, dest=folder), slave) / "SlowState.fmu"


def heating(seed=0, n=700):
    """A log of that barrel [s, W, degC, degC, J], every 2 s: Heun's method in place of Euler's."""
    rng, t = np.random.default_rng(seed), 2.0 * np.arange(n)
    power = 1150.0 + 350.0 * np.sign(np.sin(2.0 * np.pi * t / 900.0))
    rows = [np.array([180.0, 178.0, 0.0])]
    for p in power[:-1].tolist():
        x = rows[-1]
        for _ in range(8):
            rate = heating_rate(x, p)
            x = x + 0.125 * (rate + heating_rate(x + 0.25 * rate, p))
        rows.append(x)
    noisy = np.array(rows) + [0.1, 0.1, 0.1] * rng.standard_normal((n, 3))
    return dict(zip(["time [s]", "power", "T", "Tm", "energy"], [t, power, *noisy.T], strict=True))


def heating_rate(x, power):
    flow = 12.0 * (x[0] - x[1])
    return np.array([(power - 6.0 * (x[0] - 25.0) - flow) / 8000.0, (flow - (x[1] - 25.0)) / 3000.0, power])


BARREL = {"parameters": (Sought("G", 2.0, 20.0, "log"),), "measured": {"T": "T"}, "inputs": {"P": "power"}}


def test_a_slow_state_that_is_hidden_is_found_from_the_beginning(ask, heated):
    (watched,) = ask(heating(), fmu=heated, start={"T": "T"}, **BARREL).watched
    assert "simulated again from the start" in watched.how
    assert "begun without Tm, energy at the states of another" in watched.how
    assert watched.events == ()


@pytest.mark.full
def test_a_variable_that_no_output_depends_on_is_not_missed(ask, heated):
    (watched,) = ask(heating(), fmu=heated, start={"T": "T", "Tm": "Tm"}, **BARREL).watched
    assert "from measured states" in watched.how
    assert (watched.events, watched.failure) == ((), None)


@pytest.mark.full
def test_states_are_proved_measured_where_the_log_moves(ask, oracles):
    (watched,) = ask(at_rest_first(oracles)).watched
    assert "from measured states" in watched.how
    assert (watched.events, watched.failure) == ((), None)


def test_a_number_is_no_measurement_of_a_state(ask, oracles):
    (watched,) = ask(at_rest_first(oracles), start=KNOWN | {"x": "x", "v": 0.0}).watched
    assert "measured: --start gives v a number, which is no measurement" in watched.how


@pytest.mark.full
def test_where_nothing_moves_nothing_is_proved(ask, oracles):
    found = ask(at_rest_first(oracles, rest=9.0), noise={"x": 2e-3, "v": 2e-3})
    (watched,) = found.watched
    assert watched.not_begun.startswith("the FMU hardly moves beside the noise in these 301 rows")
    assert watched.not_begun in found.failure


@pytest.mark.full
def test_a_column_for_a_start_parameter_measures_its_state(ask, oracles, made_once):
    slave = Path(__file__).with_name("start_parameters_slave.py")
    fmu = made_once(lambda folder: FmuBuilder.build_FMU(slave, dest=folder), slave) / "StartParameters.fmu"
    (watched,) = ask(oracles.jump(0), fmu=fmu, parameters=(MASS,), start={"x_start": "x", "v_start": "v"}).watched
    assert "from measured states" in watched.how
    assert 4.0 < of(watched, "trigger")[0].t <= 4.1


def spikes(column, scale, rng):
    wild = rng.random(len(column)) < 0.01
    return np.where(wild, column + scale * rng.choice([-1.0, 1.0], len(column)), column)


FAULTS = {
    "spikes": spikes,
    "stuck": lambda column, scale, rng: np.where(np.arange(len(column)) > 200, column[200], column),
    "delayed": lambda column, scale, rng: np.concatenate([column[:30], column[:-30]]),
    "wrong sign": lambda column, scale, rng: np.where(np.arange(len(column)) > 200, -column, column),
}


@pytest.mark.full
@pytest.mark.parametrize("fault", FAULTS)
def test_a_bad_channel_is_never_written_as_parameters_and_is_told(ask, oracles, fault):
    columns = oracles.measure(1)
    columns["v [m/s]"] = FAULTS[fault](columns["v [m/s]"], 100.0 * np.ptp(columns["v [m/s]"]), np.random.default_rng(2))
    found = ask(columns)
    (watched,) = found.watched
    assert watched.theta == pytest.approx([1.7, 0.9])
    text = report(found)
    assert "kept out" in text or "no parameters explain" in text


@pytest.mark.full_but("5.0-given0")
@pytest.mark.parametrize(("weight", "given"), [(5.0, {"F": 5.0}), (0.0, {})])
def test_a_load_on_an_input_without_a_column_is_named_and_not_written(ask, oracles, weight, given):
    """A weight [N] hangs on the spring and is in no column; from 4 s on it is 3 N more."""
    columns = oracles.measure(0, force=lambda t: np.where(t < 4.0, weight, weight + 3.0))
    del columns["force [N]"]
    (watched,) = ask(columns, inputs={}, start=KNOWN | STATES | given, parameters=(MASS, SPRING)).watched
    assert watched.theta == pytest.approx([1.7, 23.0])
    (named,) = of(watched, "disturbance")
    assert 4.0 < named.t < 5.0
    assert named.detail["size"] == {"F": pytest.approx(3.0, rel=0.03)}


def test_what_cannot_be_is_refused(ask, oracles):
    columns = oracles.measure(0, end=1.0)
    with pytest.raises(EstimateError, match=r"no way to begin a roll-out: .*'k' of Plant.fmu is a fixed parameter"):
        ask(columns, start=KNOWN, parameters=(SPRING,))
    with pytest.raises(EstimateError, match="'x' is none"):
        ask(columns, start=KNOWN, parameters=(MASS, Sought("x", -1.0, 1.0)))
    with pytest.raises(EstimateError, match=r"the values in force, and the FMU's k = 10 is outside of 21 to 30: give"):
        ask(columns, start=STATES, parameters=(Sought("k", 21.0, 30.0),))
    with pytest.raises(EstimateError, match=r"in force, and --start m=1\.7 is outside of 0\.5 to 1\.5: give"):
        ask(columns, parameters=(Sought("m", 0.5, 1.5),))
    with pytest.raises(EstimateError, match="--parameter F is an --input, too"):
        ask(columns, parameters=(MASS, Sought("F", -1.0, 1.0)))
    with pytest.raises(EstimateError, match="leave out --holdout"):
        ask(columns, holdout=0.5)
    with pytest.raises(EstimateError, match=r"samples 0\.01 s apart: --step"):
        ask(columns, step=0.005)
    with pytest.raises(EstimateError, match="states are hidden"):
        ask(columns, start=KNOWN | {"x": "x"}, parameters=(SPRING,))


@pytest.mark.full
@pytest.mark.parametrize("seed", range(3))
def test_a_jump_is_found_though_states_are_missing_in_some_rows(ask, oracles, seed):
    columns = oracles.jump(seed)
    rng = np.random.default_rng(seed)
    for name in ("x [m]", "v [m/s]"):
        columns[name][rng.integers(1, 801, 40)] = np.nan
        columns[name][[401, 402, 403, 450]] = np.nan  # where the jump shows, and the next anchor
    (watched,) = ask(columns, seed=seed).watched
    assert "from measured states" in watched.how
    (trigger,) = of(watched, "trigger")
    assert 4.0 < trigger.t <= 4.15
    z = (watched.theta - [2.6, 1.4]) / of(watched, "write")[-1].detail["std"]
    assert np.abs(z).max() < 4.0


@pytest.mark.full
def test_after_a_gap_the_parameters_in_force_are_kept_and_what_is_too_short_is_passed_over(ask, oracles):
    columns = oracles.jump(0, end=7.0)
    columns["force [N]"][[*range(600, 620), 625]] = np.nan  # gaps after the jump, five rows apart
    found = ask(columns)
    first, short, last = found.watched
    assert [len(w.window.time) for w in found.watched] == [600, 5, 75]
    assert of(first, "write")
    assert first.theta == pytest.approx([2.6, 1.4], rel=0.05)
    assert short.not_begun == "5 rows are too few to begin"
    assert short.start.tolist() == last.start.tolist() == first.theta.tolist()
    assert of(last, "trigger") == []
    assert found.failure is None
    (told,) = [text for text in found.warnings if "passed over" in text]
    assert told.startswith("1 of 3 windows is passed over, ")
    assert told.endswith(".csv, part 2: 5 rows are too few to begin.")
    assert f"{first.theta[0]:.6g}" in next(line for line in report(found).splitlines() if line.startswith("6.26 "))


def test_a_parameter_that_is_written_at_its_bound_is_named(ask, oracles):
    columns = {name: values[:520] for name, values in oracles.jump(0).items()}
    found = ask(columns, parameters=(Sought("m", 0.5, 2.59), DAMPER))  # it becomes 2.6
    assert summary(found)["windows"][0]["at_bounds"] == {"m": "upper"}
    assert re.fullmatch(r"<Online of Plant.fmu: triggered once, written once, m = 2.59, c = [\d.]+>", repr(found))
    text = report(found)
    assert "parameters that explain the samples, m at its upper bound" in text
    assert "m is at its upper bound, 2.59 kg: widen it unless it is a physical limit, or doubt the model." in text


@pytest.mark.full
def test_each_window_that_is_asked_for_begins_anew(ask, oracles):
    found = ask(oracles.jump(0, end=12.0), windows=((0.0, 6.0), (6.2, 12.0)))
    for watched, begins in zip(found.watched, (4.0, 6.2), strict=True):
        (trigger,) = of(watched, "trigger")
        assert begins < trigger.t <= begins + 0.2  # the second with the old parameters in force, from the tenth sample
        assert watched.theta == pytest.approx([2.6, 1.4], rel=0.05)


@pytest.mark.full
def test_a_log_whose_time_begins_anywhere_is_watched_alike(ask, oracles):
    """Its first stamp is no reason to take samples for late; events are at the log's time."""
    columns = {name: values[:450] for name, values in oracles.jump(0).items()}
    found = []
    for begins in (0.0, 0.005, 1000.0):
        (watched,) = ask(columns | {"time [s]": columns["time [s]"] + begins}, evaluations=10).watched
        found.append([(round(e.t - begins, 9), e.kind) for e in watched.events])
        assert watched.found["observations"]["found"] == {}
    assert "trigger" in [kind for _, kind in found[0]]
    assert found[0] == found[1] == found[2]


@pytest.mark.full
def test_more_samples_than_there_are_communication_points_are_refused(ask, oracles):
    columns = oracles.jump(0)
    last = columns["time [s]"][-1]
    with pytest.raises(EstimateError, match=r"must be less than the \d+ communication points of the longest"):
        ask(columns, round(last / 0.1) + 2, step=0.1)


@pytest.mark.full
def test_samples_are_taken_at_the_communication_step(ask, oracles):
    columns = oracles.jump(0, force=lambda t: oracles.pushes(0.02 * np.floor(t / 0.02 + 1e-6)))  # changes there only
    (watched,) = ask(columns, 25, step=0.02).watched
    (trigger,) = of(watched, "trigger")
    assert 4.0 < trigger.t <= 4.2
    assert round(trigger.t / 0.02, 9).is_integer()


def test_residuals_begun_in_noisy_states_are_a_kalman_filter_s_innovations(plant, oracles):
    """For a linear plant without process noise the filter is exact. Its transition: a matrix exponential."""
    noise, start_noise, n = (2e-3, 5e-3), (4e-3, 1e-2), 30
    columns = oracles.measure(3, end=0.3)
    m, c, k = 1.5, 0.8, 20.0  # not the truth
    u, y = columns["force [N]"], np.column_stack([columns["x [m]"], columns["v [m/s]"]])
    exponential = expm(0.01 * np.array([[0.0, 1.0, 0.0], [-k / m, -c / m, 1.0 / m], [0.0, 0.0, 0.0]]))
    kalman = KalmanFilter(2, 2, 1)
    kalman.F, kalman.B, kalman.H, kalman.Q = exponential[:2, :2], exponential[:2, 2:], np.eye(2), np.zeros((2, 2))
    kalman.x, kalman.P, kalman.R = y[0][:, None], np.diag(np.square(start_noise)), np.diag(np.square(noise))
    squares = []
    for force, measured in zip(u[:n], y[1:], strict=True):
        kalman.predict(np.array([[force]]))
        kalman.update(measured[:, None])
        squares.append(float((kalman.y.T @ np.linalg.inv(kalman.S) @ kalman.y).item()))
    samples = [
        Sample(t, tuple(row), (force,), (), tuple(row))
        for t, row, force in zip(columns["time [s]"].tolist(), y.tolist(), [u[0], *u.tolist()], strict=False)
    ]
    shadow = Shadow(
        plant,
        ("F",),
        ("x", "v"),
        ("x", "v"),
        noise,
        ("m", "c"),
        {"k": k},
        0.0,
        samples[-1].t,
        True,
        {"state": "", "replay": ""},
    )
    with NoisyStartObjective(
        partial(RolloutObjective, shadow, np.array([m, c]), "measured", None, 1), start_noise
    ) as objective:
        objective.add_sample(samples[1])
        stretch = SampleSequence(tuple(samples), objective.snapshot(True))
        (evaluation,) = objective.evaluate([np.array([m, c])], stretch)
        assert evaluation.squares == pytest.approx(squares, rel=1e-6)
        followed = [
            objective.track(np.array([m, c]), SampleSequence(tuple(samples[: i + 1]), stretch.origin))
            for i in range(1, n + 1)
        ]
        assert [r @ r for r in followed] == pytest.approx(np.cumsum(squares), rel=1e-6)


@pytest.fixture
def command(plant, oracles, monkeypatch, tmp_path):
    """command(*options): the exit code of `retune estimate --online` on a log with a jump, in an empty folder."""
    log = oracles.write_log(tmp_path / "log.csv", oracles.jump(0))
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    common = ["--parameter", "m=0.5:4", "--parameter", "c=0.05:5:log", "--input", "F=force", "--measured", "x=x"]
    common += ["--measured", "v=v", "--start", "m=1.7", "--start", "c=0.9", "--start", "k=23"]
    return lambda *options: main(["estimate", str(plant), str(log), "--online", *common, *options])


def test_what_it_prints_and_writes(command, capsys, tmp_path):
    ssv = tmp_path / "mine.ssv"
    assert command("--start", "x=x", "--start", "v=v", "--ssv", str(ssv)) == 0
    printed = capsys.readouterr().out
    assert "801 rows as if online, triggered once" in printed
    assert "from measured states" in printed
    folder = tmp_path / "work" / "runs" / "Plant-online-1"
    assert {p.name for p in folder.iterdir()} == {"online.json", "online.csv", "estimates.ssv"}
    (window,) = json.loads((folder / "online.json").read_text())["windows"]
    with open(folder / "online.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["event"] for row in rows] == [event["event"] for event in window["events"]]
    last = [row for row in rows if row["event"] == "write"][-1]
    assert {p.name: p.value for p in read_ssv(ssv).values} == window["end"]
    assert float(last["m [kg]"]) == window["end"]["m"]
    assert f"{float(last['m [kg]']):.3f} ± {float(last['std m [kg]']):.3f}" in printed
    assert ssv.read_text() == (folder / "estimates.ssv").read_text()


def test_where_nothing_is_judged_nothing_is_said_to_have_never_triggered(command, capsys):
    assert command("--start", "x=x", "--start", "v=v", "--samples", "5", "--window", "0:0.08") == 1
    printed, error = capsys.readouterr()
    assert error.startswith("retune: log.csv, 0 to 0.08 s: 9 rows are too few to begin; what was recorded")
    assert "9 rows as if online, nothing judged\n" in printed
    assert "never" not in printed
    assert "next:" not in printed


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--samples", "0"], "--samples must be 1 or more"),
        (["--validate", "other.csv"], "leave out --holdout and --validate"),
        (["--parameter", "g=1:20"], "'g' of Plant.fmu takes no start value"),
        (["--evaluations", "0"], "must be 1 or more"),
        (["--evaluations-per-sample", "0"], "--evaluations-per-sample must be 1 or more"),
    ],
)
def test_a_bad_command_is_refused_in_one_line(command, capsys, tmp_path, options, told):
    assert command(*options) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert told in error
    assert not (tmp_path / "work" / "runs").exists()


@pytest.mark.full
def test_a_plant_that_never_runs_is_exit_code_1(command, capsys):
    assert command("--start", "c_limit=0.01") == 1
    error = capsys.readouterr().err
    assert error.startswith("retune: log.csv: shadow: do_step at t = 0.000 s returned error")
    assert error.count("\n") == 1
