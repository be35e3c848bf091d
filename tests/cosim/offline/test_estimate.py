"""Parameters estimated from logs, against closed forms and DOP853."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pythonfmu import FmuBuilder
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag

import cosim
from cosim.errors import SlaveError, WiringError
from cosim.offline.counted_twice import counted_twice
from cosim.offline.estimate import FailedError, estimate
from cosim.offline.fit_report import report, words, write_files
from cosim.offline.logs import LogError
from cosim.offline.misfit_over_log import misfit_over_log
from cosim.offline.request import EstimateError, Request, Sought
from cosim.offline.rollout import Rollouts
from cosim.ssv.document import read_ssv
from cosim.system.fmu_cache import find_fmu

pytestmark = pytest.mark.fmu
MASS, DAMPER, SPRING = Sought("m", 0.5, 4.0), Sought("c", 0.05, 5.0, "log"), Sought("k", 5.0, 60.0, "log")


@pytest.fixture
def ask(plant, tmp_path, oracles):
    """ask(columns, **changes): the request for m, c and k from a log of these columns."""

    def asked(columns, **changes):
        path = oracles.write_log(tmp_path / f"{len(list(tmp_path.iterdir()))}.csv", columns)
        settings = {
            "fmu": plant,
            "logs": (path,),
            "parameters": (MASS, DAMPER, SPRING),
            "measured": {"x": "x", "v": "v"},
            "inputs": {"F": "force"},
            "evaluations": 40,
        }
        return Request(**settings | changes)

    return asked


def errors(found, oracles):
    """Estimate minus truth (d,), in the standard deviations claimed."""
    truth = [getattr(oracles.TRUTH, name) for name in found.space.names]
    return (found.fit.theta - truth) / found.fit.std


def test_the_fmu_follows_the_closed_form(plant, oracles):
    from cosim.slaves.slave import open_slave

    t = np.arange(0.0, 3.0, 0.01)
    x, v = oracles.response(t, oracles.pushes(t))
    with open_slave(plant, "plant") as slave:
        slave.bind(["F"], [], ["x", "v"])
        slave.initialize(vars(oracles.TRUTH))
        rows = [slave.get(), *(slave.step([f], t_k, 0.01) for t_k, f in zip(t[:-1], oracles.pushes(t), strict=False))]
    assert np.abs(np.array(rows) - np.column_stack([x, v])).max() < 1e-10  # RK4 at 1 ms


def test_the_function_of_the_library_is_the_command_with_keywords(ask, oracles, tmp_path):
    request = ask(oracles.measure(0), seed=3)
    keywords = {"measured": {"x": "x", "v": "v"}, "inputs": {"F": "force"}, "evaluations": 40, "seed": 3}
    bounds = {"m": (0.5, 4.0), "c": (0.05, 5.0, "log"), "k": (5.0, 60.0, "log")}
    found = cosim.estimate(str(request.fmu), request.logs[0], bounds, **keywords, out=tmp_path / "new" / "folder")
    expected = estimate(request)
    assert found.estimates == expected.space.named(expected.fit.theta)
    assert found.std == expected.space.named(expected.fit.std)
    assert repr(found).startswith(f"<Estimation from Plant.fmu: m = {found.estimates['m']:.5g} ± ")
    written = json.loads((tmp_path / "new" / "folder" / "estimate.json").read_text())
    assert {name: p["value"] for name, p in written["parameters"].items()} == found.estimates


@pytest.mark.parametrize("function", [cosim.estimate, cosim.estimate_online])
@pytest.mark.parametrize(
    ("keywords", "reason"),
    [
        ({"evaluations": 0}, "must be 1 or more"),
        ({"jobs": 0}, "must be from 1 to 256"),
        ({"seed": -1}, "--seed must be 0 or more, got -1"),
        ({"windows": ["0:5"]}, r"windows must be pairs of numbers, .* got \['0:5'\]"),
        ({"windows": (0, 5)}, r"windows must be pairs of numbers, .* got \(0, 5\)"),
    ],
)
def test_the_functions_of_the_library_refuse_in_one_line(plant, tmp_path, function, keywords, reason):
    with pytest.raises(cosim.CosimError, match=reason):
        function(plant, tmp_path / "no.csv", {"m": (0.5, 4.0)}, {"x": "x"}, out=tmp_path / "out", **keywords)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("function", [cosim.estimate, cosim.estimate_online])
@pytest.mark.parametrize("bounds", [(1,), (), 1.0, ("a", 2.0), (1.0, 2.0, "log", 3.0)])
def test_bounds_that_are_none_are_refused_in_one_line(plant, tmp_path, function, bounds):
    with pytest.raises(cosim.CosimError, match=r"bounds of m must be \(lower, upper\) or .*, got [^\n]*\.$"):
        function(plant, tmp_path / "no.csv", {"m": bounds}, {"x": "x"})


@pytest.mark.full
def test_intervals_cover_the_truth(ask, oracles):
    found = [estimate(ask(oracles.measure(seed), seed=seed)) for seed in range(12)]
    z = np.array([errors(f, oracles) for f in found])
    assert np.abs(z).max() < 4.0  # of 36 normal numbers: by chance once in 400 suites
    assert np.count_nonzero(np.abs(z) < 1.96) >= 30  # 34 expected; fewer than 30: once in 300
    assert 0.7 < np.sqrt(np.mean(z * z)) < 1.35  # the deviations are neither too small nor too large
    assert all(all(f.fit.is_identifiable) for f in found)
    assert all(f.fit.misfit == pytest.approx(1.0, abs=0.15) for f in found)  # the noise is told from the log


@pytest.fixture
def from_noisy_rows(ask, oracles):
    """from_noisy_rows(columns): m and c of a plant that starts from what is measured, in row 0 and again in row 200."""
    start = {"x": "x", "v": "v", "k": oracles.TRUTH.k}
    changes = {"start": start, "windows": ((0.0, 1.995), (2.0, 4.0)), "holdout": 0.0, "evaluations": 12}
    return lambda columns: estimate(ask(columns, parameters=(MASS, DAMPER), **changes))


def test_the_noise_of_start_columns_is_in_the_deviations(from_noisy_rows, oracles):
    """J and G by differences of the closed form."""
    columns = oracles.measure(0, end=4.0)
    found = from_noisy_rows(columns)
    t, force = columns["time [s]"], columns["force [N]"]
    exact = np.column_stack(oracles.response(t, force))

    def residual(rows, m=oracles.TRUTH.m, c=oracles.TRUTH.c, aside=(0.0, 0.0)):
        simulated = oracles.response(t[rows], force[rows], m, c, start=exact[rows][0] + aside)
        return np.concatenate(simulated) / 2e-3

    windows = (slice(0, 200), slice(200, 401))
    J = np.vstack([
        np.column_stack([residual(w, m=1.7001) - residual(w, m=1.6999), residual(w, c=0.9001) - residual(w, c=0.8999)])
        for w in windows
    ]) / 2e-4  # fmt: skip
    G = block_diag(*(
        np.column_stack([residual(w, aside=aside) - residual(w) for aside in ((2e-3, 0.0), (0.0, 2e-3))])
        for w in windows
    ))  # fmt: skip
    inverse = np.linalg.inv(J.T @ J)
    expected = np.sqrt(np.diag(inverse + inverse @ J.T @ G @ G.T @ J @ inverse))
    assert found.fit.std == pytest.approx(expected, rel=0.15)  # the noise is told from 400 rows
    assert np.all(expected > 2.0 * np.sqrt(np.diag(inverse)))


@pytest.mark.full
def test_intervals_cover_the_truth_where_the_start_is_noisy(from_noisy_rows, oracles):
    z = [errors(from_noisy_rows(oracles.measure(seed, end=4.0)), oracles) for seed in range(12)]
    assert np.abs(z).max() < 4.0
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.6


@pytest.mark.full
@pytest.mark.parametrize("method", ["least-squares", "multi-start"])
def test_other_methods_end_at_the_same_place(ask, oracles, method):
    columns = oracles.measure(1)
    ours, theirs = estimate(ask(columns)), estimate(ask(columns, method=method, evaluations=80))
    assert theirs.fit.theta == pytest.approx(ours.fit.theta, abs=0.02 * ours.fit.std.min())
    assert theirs.fit.std == pytest.approx(ours.fit.std, rel=0.01)


def test_another_spring_than_the_closed_form_s_is_told(compile_plant, ask, oracles):
    found = estimate(ask(oracles.measure(0), fmu=compile_plant("-DSTIFFER")))
    k = found.space.names.index("k")
    assert found.fit.theta[k] == pytest.approx(oracles.TRUTH.k / 1.01, rel=1e-3)
    assert abs(errors(found, oracles)[k]) > 5.0


def test_an_fmu_that_fails_in_held_out_rows_is_told_with_the_reason(ask, oracles, monkeypatch):
    rolled = Rollouts._rollout

    def failing(self, number, is_whole, *others):
        if is_whole:
            raise SlaveError("plant", "doStep", 7.0, "the spring is broken")
        return rolled(self, number, is_whole, *others)

    monkeypatch.setattr(Rollouts, "_rollout", failing)
    (warning,) = estimate(ask(oracles.measure(2), evaluations=8)).warnings
    assert "with the estimates the FMU fails in held-out rows: " in warning
    assert "the spring is broken" in warning


@pytest.mark.full
def test_held_out_rows_are_predicted_and_not_fitted_to(ask, oracles):
    columns = oracles.measure(2)
    found = estimate(ask(columns))
    (window,) = found.windows
    assert (window.n_fit, len(window.time)) == (601, 801)
    assert found.rms(found.after, True) == pytest.approx([2e-3, 2e-3], rel=0.15)
    assert np.all(found.rms(found.before, True) > 0.05)
    for name in ("x [m]", "v [m/s]"):
        columns[name][601:] = 9.0
    assert estimate(ask(columns)).fit.theta == pytest.approx(found.fit.theta, rel=1e-12)


@pytest.mark.full
def test_one_seed_gives_one_result_whatever_the_jobs(ask, oracles):
    columns = oracles.measure(3)
    first, second = (estimate(ask(columns, jobs=jobs)) for jobs in (1, 2))
    assert first.fit.theta.tolist() == second.fit.theta.tolist()
    assert [e[1] for e in first.evaluations] == [e[1] for e in second.evaluations]


@pytest.mark.full
def test_units_of_the_log_become_those_of_the_fmu(ask, oracles):
    columns = oracles.measure(4)
    scaled = {
        "time [ms]": 1e3 * columns["time [s]"],
        "force [kN]": 1e-3 * columns["force [N]"],
        "x [mm]": 1e3 * columns["x [m]"],
        "v [km/h]": 3.6 * columns["v [m/s]"],
    }
    assert estimate(ask(scaled)).fit.theta == pytest.approx(estimate(ask(columns)).fit.theta, rel=1e-9)


@pytest.mark.full
def test_several_logs_count_together(ask, oracles, tmp_path):
    one = estimate(ask(oracles.measure(0), holdout=0.0))
    more = tuple(oracles.write_log(tmp_path / f"log{i}.csv", oracles.measure(i)) for i in range(4))
    four = estimate(ask(oracles.measure(0), logs=more, holdout=0.0))
    assert four.fit.std == pytest.approx(one.fit.std / 2.0, rel=0.1)
    assert np.abs(errors(four, oracles)).max() < 4.0


@pytest.fixture
def fleet(ask, oracles, tmp_path):
    """fleet(**changes): an estimation from two logs of plants that differ in mass: 1.7 and 2.9 kg."""
    columns = [oracles.measure(i, m=m, end=4.0) for i, m in enumerate((1.7, 2.9))]
    logs = tuple(oracles.write_log(tmp_path / f"axis-{i}.csv", one) for i, one in enumerate(columns, start=1))

    def estimated(**changes):
        return estimate(ask(columns[0], **{"logs": logs, "holdout": 0.0, "own": ("m",), "seed": 1} | changes))

    return estimated


@pytest.mark.full
def test_a_parameter_has_a_value_of_its_own_in_each_log(fleet, tmp_path):
    """The others have one for both."""
    found = fleet()
    assert found.space.names == ("m in axis-1.csv", "m in axis-2.csv", "c", "k")
    assert np.abs((found.fit.theta - [1.7, 2.9, 0.9, 23.0]) / found.fit.std).max() < 4.0
    assert found.fit.misfit == pytest.approx(1.0, rel=0.1)
    write_files(found, tmp_path)
    for i in (0, 1):
        values = {v.name: v.value for v in read_ssv(tmp_path / f"estimates-{i + 1}.ssv").values}
        assert values == {"m": found.fit.theta[i], "c": found.fit.theta[2], "k": found.fit.theta[3]}
    assert not (tmp_path / "estimates.ssv").exists()


@pytest.mark.full
def test_one_value_for_both_does_not_fit(fleet):
    assert fleet(own=()).fit.misfit > 3.0


@pytest.mark.parametrize(
    ("changes", "told"), [({"own": ("x0",)}, "--own x0 must be"), ({"validation": ("a.csv",)}, "--own has no value")]
)
def test_own_parameters_that_cannot_be_are_told(fleet, changes, told):
    with pytest.raises(EstimateError, match=told):
        fleet(**changes)


def test_a_validation_log_is_held_out_as_a_whole(ask, oracles, tmp_path):
    other = oracles.write_log(tmp_path / "other.csv", oracles.measure(8, force=lambda t: 4.0 * np.sin(3.0 * t)))
    found = estimate(ask(oracles.measure(7), validation=(other,)))
    assert [w.n_fit for w in found.windows] == [801, 0]
    assert found.rms(found.after, True) == pytest.approx([2e-3, 2e-3], rel=0.15)


def test_a_log_that_is_fitted_to_does_not_validate():
    log, other = Path("log.csv"), Path("other.csv")
    assert counted_twice([log], (), [other]) == []
    assert counted_twice([log], (), [other, Path("./log.csv")]) == [
        "log.csv is fitted to as well: what --validate shows of it is no check."
    ]


@pytest.mark.full
def test_gaps_split_windows_that_start_from_the_log(ask, oracles):
    columns = oracles.measure(5, noise=1e-5)
    columns["force [N]"][300:340] = np.nan  # as lost in transmission
    columns["x [m]"][100:120] = np.nan  # not compared there, but simulated across
    found = estimate(ask(columns, start={"x": "x", "v": "v"}, holdout=0.0))
    assert [len(w.time) for w in found.windows] == [300, 461]
    assert found.fit.theta == pytest.approx(list(vars(oracles.TRUTH).values()), rel=1e-3)
    assert any("gaps split it into 2 windows" in warning for warning in found.warnings)


def test_without_start_columns_only_the_window_before_the_gap_is_used(ask, oracles):
    columns = oracles.measure(5)
    keep = np.abs(columns["time [s]"] - 4.0) > 0.5  # rows that were never written
    found = estimate(ask({name: values[keep] for name, values in columns.items()}))
    assert [len(w.time) for w in found.windows] == [350]
    assert any("only the first is used" in warning for warning in found.warnings)
    assert np.abs(errors(found, oracles)).max() < 4.0


@pytest.mark.full
def test_repeated_time_stamps_are_told_and_the_last_row_counts(ask, oracles):
    columns = oracles.measure(6)
    twice = {name: np.insert(values, 200, 99.0) for name, values in columns.items()}
    twice["time [s]"][200] = twice["time [s]"][201]
    found = estimate(ask(twice))
    assert any("1 repeated time stamps" in warning for warning in found.warnings)
    assert found.fit.theta.tolist() == estimate(ask(columns)).fit.theta.tolist()


@pytest.mark.full
def test_a_log_is_not_touched(ask, oracles):
    columns = oracles.measure(6)
    columns["force [N]"][50] = np.nan
    request = ask(columns)
    before = request.logs[0].read_bytes(), request.logs[0].stat().st_mtime_ns
    estimate(request)
    assert (request.logs[0].read_bytes(), request.logs[0].stat().st_mtime_ns) == before


@pytest.mark.full
def test_a_log_that_is_given_twice_is_told_and_windows_that_touch_are_not(ask, oracles):
    windows = ((0.5, 1.0), (0.0, 0.5))
    request = ask(oracles.measure(0, end=2.0), evaluations=4, windows=windows, start={"x": "x", "v": "v"})
    assert estimate(request).warnings == ()
    (told,) = estimate(replace(request, logs=2 * request.logs)).warnings
    assert told.startswith(f"{request.logs[0].name} is given 2 times: its rows count as if")


def test_a_window_is_simulated_from_its_own_start(ask, oracles):
    columns = oracles.measure(5, noise=1e-5)
    found = estimate(ask(columns, windows=((2.0, 4.0),), start={"x": "x", "v": "v"}))
    assert found.fit.theta == pytest.approx(list(vars(oracles.TRUTH).values()), rel=1e-3)
    assert found.windows[0].time[[0, -1]] == pytest.approx([2.0, 4.0])


@pytest.mark.full
def test_a_start_value_can_be_estimated_too(ask, oracles):
    columns = oracles.measure(9, start=(-0.2, 0.4))
    found = estimate(ask(columns, parameters=(MASS, DAMPER, SPRING, Sought("x", -1, 1), Sought("v", -1, 1))))
    truth = [*vars(oracles.TRUTH).values(), -0.2, 0.4]
    assert np.abs((found.fit.theta - truth) / found.fit.std).max() < 4.0
    assert found.fit.misfit == pytest.approx(1.0, abs=0.1)


@pytest.mark.full
def test_what_only_ratios_are_seen_of_is_said_to_trade_off(ask, oracles):
    """Swinging freely, the plant shows k/m and c/m only."""
    columns = oracles.measure(0, force=lambda t: 0.0 * t)
    found = estimate(ask(columns, start={"m": 1.5}))
    assert not any(found.fit.is_identifiable)
    assert any("trade off" in word and "m" in word and "k" in word for word in words(found))
    m, _, k = found.fit.theta
    assert k / m == pytest.approx(oracles.TRUTH.k / oracles.TRUTH.m, rel=1e-2)


@pytest.mark.full
def test_an_fmu_with_an_adaptive_solver_is_not_believed_what_it_cannot_show(made_once, oracles, tmp_path):
    """Only c/m and k/m are seen; before, each of m, c and k was called identifiable."""
    slave = Path(__file__).with_name("rk45_slave.py")
    fmu = made_once(lambda folder: FmuBuilder.build_FMU(slave, dest=folder), slave) / "AdaptivePlant.fmu"
    t = np.arange(401) / 50.0
    x, _ = oracles.response(t, oracles.TRUTH.k * np.where(t % 1.3 < 0.6 - 1e-9, 0.3, -0.2))
    columns = {"t": t, "x": x + 2e-3 * np.random.default_rng(0).standard_normal(len(t))}
    log = oracles.write_log(tmp_path / "log.csv", columns)
    for seed in range(3):
        request = Request(
            fmu, (log,), (MASS, DAMPER, SPRING), {"x": "x"}, evaluations=30, seed=seed, holdout=0.0, jobs=2
        )
        found = estimate(request)
        assert not any(found.fit.is_identifiable)
        assert any(word.startswith("m, c and k trade off") for word in words(found))
        m, _, k = found.fit.theta
        assert k / m == pytest.approx(oracles.TRUTH.k / oracles.TRUTH.m, rel=1e-2)


def test_a_parameter_that_nothing_depends_on_stays_and_is_named(ask, oracles):
    found = estimate(ask(oracles.measure(0), parameters=(MASS, DAMPER, SPRING, Sought("c_limit", 10.0, 20.0))))
    assert found.fit.theta[3] == pytest.approx(20.0)  # the FMU's own 1e9, within the bounds
    assert found.fit.is_identifiable == (True, True, True, False)
    assert any("hardly see c_limit" in word for word in words(found))


@pytest.mark.parametrize(("start", "what"), [({}, "the FMU's k = "), ({"k": 20.0}, "--start k=20 ")])
def test_a_value_before_out_of_the_bounds_is_told(ask, oracles, start, what):
    columns = oracles.measure(0, end=1.0)
    found = estimate(ask(columns, parameters=(MASS, Sought("k", 21.0, 30.0)), start=start, evaluations=4))
    (warning,) = found.warnings
    assert warning.startswith(what)
    assert warning.endswith("is outside of 21 to 30: 21 is used.")
    assert found.nominal[1] == 21.0


@pytest.mark.full
def test_roll_outs_that_fail_are_bad_candidates_with_a_reason(ask, oracles):
    found = estimate(ask(oracles.measure(0), start={"c_limit": 1.0}))
    assert np.abs(errors(found, oracles)).max() < 4.0
    (reason,) = found.failures
    assert "do_step at t = 0.000 s returned error" in reason
    assert f"{found.failures[reason]} of {len(found.evaluations)} roll-outs failed" in report(found)


@pytest.mark.full
def test_where_all_roll_outs_fail_the_first_reason_is_told(ask, oracles):
    with pytest.raises(FailedError, match=r"every roll-out failed, the first so: plant: do_step .* returned error"):
        estimate(ask(oracles.measure(0), start={"c_limit": 0.01}))


@pytest.mark.full
def test_a_wrong_start_value_shows_in_the_words(ask, oracles):
    found = estimate(ask(oracles.measure(0), start={"x": 0.3}))
    told = " ".join(words(found))
    assert "times the noise: something is missing from the model" in told
    assert "correlated from row to row" in told


def test_the_bias_of_an_fmu_s_coarse_solver_is_told(made_once, ask, oracles):
    """Explicit Euler steps h take k h from the damping of a weakly damped swing; c makes up for it."""
    slave = Path(__file__).with_name("euler_slave.py")
    fmu = made_once(lambda folder: FmuBuilder.build_FMU(slave, dest=folder), slave) / "EulerPlant.fmu"
    found = estimate(ask(oracles.measure(0, end=4.0), fmu=fmu, parameters=(DAMPER, SPRING), evaluations=20))
    bias = oracles.TRUTH.k * 0.01
    assert found.estimates["c"] - oracles.TRUTH.c == pytest.approx(bias, rel=0.2)
    assert found.finer.step == pytest.approx(0.005)
    assert found.finer.change["c"] == pytest.approx(-bias / 2.0, rel=0.2)
    assert any("too coarse; try a finer step, --step 0.005" in word for word in words(found))


def test_of_a_fine_solver_no_bias_is_told(ask, oracles):
    found = estimate(ask(oracles.measure(0), evaluations=20))
    assert all(abs(change) < 0.1 * found.std[name] for name, change in found.finer.change.items())
    assert not any("finer step" in word for word in words(found))


def test_the_part_of_the_log_that_the_model_fails_in_is_told(ask, oracles):
    """A blow that nobody recorded, at 4 s: its end is known in closed form, that of a free swing."""
    columns = oracles.measure(0)
    late = columns["time [s]"] >= 4.0
    x, v = oracles.response(columns["time [s]"][late], np.zeros(np.count_nonzero(late)), start=(0.0, 0.2))
    columns["x [m]"][late] += x
    columns["v [m/s]"][late] += v
    truth = vars(oracles.TRUTH)
    close = tuple(Sought(name, 0.9995 * truth[name], 1.0005 * truth[name]) for name in ("m", "c", "k"))
    found = estimate(ask(columns, parameters=close, holdout=0.0, evaluations=12))
    parts = [part for part in misfit_over_log(found) if part.output == "v"]
    assert len(parts) == 10
    assert all(part.misfit < 3.0 for part in parts[:5])
    worst = max(parts, key=lambda part: part.misfit)
    assert worst.begin == pytest.approx(4.0)
    assert any(word.startswith("The model fails most from 4 to 4.8 s: the residuals of v") for word in words(found))


def test_a_bound_that_is_met_is_named(ask, oracles):
    found = estimate(ask(oracles.measure(0), parameters=(MASS, DAMPER, Sought("k", 25.0, 60.0))))
    assert found.fit.theta[2] == 25.0
    assert any(word.startswith("k is at its lower bound, 25 N/m") for word in words(found))


@pytest.mark.full
def test_an_fmu_that_a_process_can_have_only_once(compile_plant, ask, oracles):
    request = ask(oracles.measure(0, end=2.0), evaluations=12)
    once = compile_plant("-DONCE", canBeInstantiatedOnlyOncePerProcess="true")
    assert estimate(replace(request, fmu=once)).fit.theta.tolist() == estimate(request).fit.theta.tolist()


@pytest.mark.full
def test_uneven_rows(compile_plant, ask, oracles):
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.008, 0.012, 800))
    t -= t[0]
    x, v = oracles.response(t, oracles.pushes(t))
    columns = {"time": t, "force [N]": oracles.pushes(t), "x": x, "v": v}
    exact = list(vars(oracles.TRUTH).values())
    assert estimate(ask(columns)).fit.theta == pytest.approx(exact, rel=1e-6)
    rigid = compile_plant(canHandleVariableCommunicationStepSize="false")
    with pytest.raises(LogError, match=r"cannot vary its step; give --step 0\.01"):
        estimate(ask(columns, fmu=rigid))
    assert estimate(ask(columns, fmu=rigid, step=0.001)).fit.theta == pytest.approx(exact, rel=0.01)


@pytest.mark.full
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_pendulum_of_ours_against_dop853(tmp_path, oracles, fmi):
    m, l, b, g = 1.3, 0.6, 0.1, 9.81
    t = np.arange(801) / 100.0
    u = 4.0 * np.sign(np.sin(1.3 * t)) + 2.0 * np.sin(5.0 * t)
    rows = [np.array([0.5, 0.0])]
    for force in u[:-1]:
        solved = solve_ivp(
            lambda _, x, force=force: [x[1], -g / l * np.sin(x[0]) - b / m * x[1] + force / (m * l)],
            (0.0, 0.01), rows[-1], method="DOP853", rtol=1e-10, atol=1e-12,
        )  # fmt: skip
        rows.append(solved.y[:, -1])
    phi = np.array(rows)[:, 0] + 2e-3 * np.random.default_rng(3).standard_normal(len(t))
    log = oracles.write_log(tmp_path / "log.csv", {"t": t, "u": u, "angle [deg]": np.degrees(phi)})
    fmu = find_fmu("Pendulum", tmp_path, fmi)
    parameters = (Sought("m", 0.5, 4.0), Sought("l", 0.1, 3.0, "log"))
    found = estimate(Request(fmu, (log,), parameters, {"phi": "angle"}, {"u": "u"}))
    assert np.abs((found.fit.theta - [m, l]) / found.fit.std).max() < 4.0
    assert np.all(found.fit.std < [2e-4, 1e-4])
    assert found.noise == pytest.approx([2e-3], rel=0.1)


@pytest.mark.parametrize(
    ("changes", "error", "match"),
    [
        ({"parameters": (Sought("mass", 1, 2),)}, WiringError, "no variable 'mass' in Plant.fmu"),
        ({"parameters": (Sought("g", 1, 2),)}, WiringError, "'g' of Plant.fmu takes no start value: it is a constant"),
        ({"parameters": (Sought("m", -1, 2),)}, EstimateError, r"'m' must be within \[0, inf\] kg, got -1"),
        ({"parameters": (Sought("m", 2, 1),)}, EstimateError, "must have finite lower < upper"),
        ({"parameters": (Sought("m", 0, 1, "log"),)}, EstimateError, "lower > 0 on a log scale"),
        ({"parameters": (MASS, MASS)}, EstimateError, "got 'm' twice"),
        ({"inputs": {"m": "force"}}, WiringError, "'m' of Plant.fmu is a tunable parameter, not an input"),
        ({"inputs": {"F": "farce"}}, LogError, "no column 'farce'; did you mean 'force'"),
        ({"measured": {"y": "x"}}, WiringError, "no variable 'y' in Plant.fmu"),
        ({"measured": {"x": "force"}}, LogError, "'N' cannot be converted to 'm': the dimensions differ"),
        ({"start": {"x": "v"}}, LogError, "'m/s' cannot be converted to 'm'"),
        ({"start": {"m": -3.0}}, EstimateError, "'m' must be within"),
        ({"start": {"m": "x"}}, EstimateError, "'m' is to be estimated"),
        ({"time": "x"}, LogError, "'m' cannot be converted to 's'"),
        ({"windows": ((90.0, 99.0),)}, LogError, "has 0 rows in the window 90 to 99 s; it has 0 to 8 s"),
        ({"windows": ((3.0, 2.0),)}, EstimateError, "FROM < TO"),
        ({"windows": ((4.0, 8.0), (0.0, 4.5))}, LogError, "--window 0:4.5 and 4:8 overlap: their rows would"),
        ({"noise": {"x": 0.0}}, EstimateError, "--noise x must be positive"),
        ({"noise": {"x": 1e-11}}, EstimateError, r"--noise x must be \d\.\de-07 or more, a millionth of the"),
        ({"noise": {"F": 1.0}}, EstimateError, "of a measured output"),
        ({"method": "rls"}, EstimateError, "no method 'rls' for a log"),
        ({"holdout": 0.9999}, LogError, "no rows are left to fit to"),
        ({"step": 0.0}, EstimateError, "--step must be positive"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(ask, oracles, changes, error, match):
    with pytest.raises(error, match=match):
        estimate(ask(oracles.measure(0), **changes))
