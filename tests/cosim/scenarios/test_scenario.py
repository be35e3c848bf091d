"""Scenario files: the named ones against the paper, and every slip told with file, key and rule."""

import json
import math
import os
import sys
import tomllib
from importlib.resources import files
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from cosim.errors import ScenarioError
from cosim.former_names import tell_new_name
from cosim.scenarios.named import named_scenarios
from cosim.scenarios.scenario import Scenario

PENDULUM = (files("cosim") / "scenarios" / "pendulum.toml").read_text(encoding="utf-8")


def refusal(overrides=None, source="pendulum"):
    with pytest.raises(ScenarioError) as caught:
        Scenario.load(source, overrides)
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


# The named scenarios.


def test_the_named_scenarios_load():
    assert named_scenarios() == ("magnetic-levitation", "pendulum", "quadrotor", "rigid-body", "stiction")
    assert [Scenario.load(name).scenario.name for name in named_scenarios()] == list(named_scenarios())


def test_a_scenario_survives_its_own_json():
    for name in named_scenarios():
        scenario = Scenario.load(name)
        again = Scenario.model_validate(json.loads(json.dumps(scenario.model_dump(mode="json"))))
        assert again == scenario.model_copy(update={"folder": again.folder})


def test_the_pendulum_changes_at_three_seconds_as_in_the_paper():
    scenario = Scenario.load("pendulum")
    truth = scenario.change_functions()
    assert [(truth["plant.m"](t), truth["plant.l"](t)) for t in (2.99, 3.0)] == [(1.75, 0.75), (4.271, 0.981)]
    assert [(p.name, p.lower, p.upper) for p in scenario.estimation.parameters] == [("m", 0.1, 5.0), ("l", 0.1, 3.0)]
    assert scenario.estimation.loop("target").budget == 30


def m_hat(t):
    """The paper's equation of the time-varying mass, m = 1.25 kg."""
    if t <= 3:
        return 0.2 * math.exp(-0.2 * t) * math.sin(1.5 * t) + 1.25
    if t <= 6:
        return 1.85
    if t <= 9:
        return 0.7 * math.exp(-0.2 * t) * math.sin(1.5 * t) + 1.25
    return 2.10 if t <= 12 else 1.25


def test_the_quadrotor_has_the_papers_mass_at_every_communication_point():
    scenario = Scenario.load("quadrotor")
    mass = scenario.change_functions()["plant.m"]
    times = [scenario.scenario.time(k) for k in range(scenario.scenario.n_steps + 1)]
    assert len(times) == 1601
    assert [mass(t) for t in times] == pytest.approx([m_hat(t) for t in times], rel=1e-15)


TABLE = [
    (1.5, 1.365, 3.47, 6.77),
    (5.0, 1.85, 6.02, 9.32),
    (8.0, 1.18, 3.44, 6.74),
    (11.0, 2.10, 6.39, 9.69),
    (14.0, 1.25, 3.30, 6.60),
]


@pytest.mark.parametrize(("t", "m", "J_x", "J_z"), TABLE, ids=[f"t={row[0]}" for row in TABLE])
def test_the_quadrotors_parameters_are_those_of_the_papers_table(t, m, J_x, J_z):
    truth = Scenario.load("quadrotor").change_functions()
    # The table rounds to 0.01; its mass at 8 s is 1.1739 and at 1.5 s by the equation 1.3653.
    assert truth["plant.m"](t) == pytest.approx(m, abs=0.007)
    assert [truth[f"plant.J_{axis}"](t) for axis in "xyz"] == pytest.approx([J_x, J_x, J_z], abs=0.008)


def test_the_printed_constant_offset_can_be_had_instead():
    truth = Scenario.load("quadrotor", {"definitions.r_squared": "0.04"}).change_functions()
    assert truth["plant.J_x"](5.0) == pytest.approx(3.0 * (1.1 + 1.85 * 0.04), rel=1e-15)


def test_the_quadrotor_starts_on_its_reference():
    start = Scenario.load("quadrotor").components["plant"].start
    # r_d = (4 sin 0.8t, 5 sin 0.4t, 2 sin 0.4t) and its derivative at t = 0
    assert [start[f"r_{a}"] for a in "xyz"] == [0.0, 0.0, 0.0]
    assert [start[f"v_{a}"] for a in "xyz"] == pytest.approx([4 * 0.8, 5 * 0.4, 2 * 0.4], rel=1e-15)


# Times.


@settings(max_examples=200, deadline=None)
@given(st.integers(1, 5000), st.sampled_from([0.01, 0.001, 0.02, 0.1, 0.003]), st.floats(-10.0, 10.0))
def test_communication_points_run_from_start_to_stop_without_drift(n, macro_step, start):
    overrides = {"scenario.start_time": repr(start), "scenario.macro_step": repr(macro_step)}
    stop = start + n * macro_step
    if stop <= 0.0:
        return  # stop_time must be positive
    times = Scenario.load("pendulum", overrides | {"scenario.stop_time": repr(stop)}).scenario
    assert times.n_steps == n
    assert times.time(0) == start
    assert times.time(n) == pytest.approx(stop, abs=1e-12)


# Overrides.


def test_an_override_replaces_one_value_and_leaves_its_neighbours():
    plain, changed = Scenario.load("pendulum"), Scenario.load("pendulum", {"estimation.budget": "60"})
    assert changed.estimation.budget == 60
    assert changed.estimation.model_copy(update={"budget": 30}) == plain.estimation


def test_an_override_may_have_a_quoted_key_with_a_dot():
    assert Scenario.load("pendulum", {'changes."plant.m"': "2.0"}).change_functions()["plant.m"](5.0) == 2.0


def test_a_bare_text_is_a_string():
    scenario = Scenario.load("pendulum", {'changes."plant.m"': "1 + t/10", "scenario.coupling": "parallel"})
    assert scenario.change_functions()["plant.m"](5.0) == 1.5
    assert scenario.scenario.coupling == "parallel"


def test_an_override_may_be_a_table_or_rows():
    scenario = Scenario.load("pendulum", {'changes."plant.m"': "[[0.0, 2.0], [1.0, '3*t']]"})
    assert [scenario.change_functions()["plant.m"](t) for t in (0.5, 2.0)] == [2.0, 6.0]


def test_an_override_may_choose_another_kind_of_trigger():
    scenario = Scenario.load("pendulum", {"estimation.trigger": '{ kind = "innovation", false_alarm = 1e-3 }'})
    assert scenario.estimation.trigger.kind == "innovation"


@pytest.mark.parametrize("key", ["a b", "", "a..b", "a.", "[a]", "a = 1\nb"], ids=repr)
def test_an_override_needs_a_toml_key(key):
    assert "not a TOML key" in refusal({key: "1"})


def test_an_override_sets_one_key_only():
    told = refusal({"scenario.stop_time": "5.0\nestimation.budget = 7"})
    assert "scenario.stop_time: must be a number" in told
    assert r"got '5.0\nestimation.budget = 7'" in told


def test_the_estimator_paper_takes_every_candidate_and_the_newest_sample_unless_told_otherwise():
    estimation = Scenario.load("pendulum").estimation
    loop = estimation.loop("paper")
    assert (loop.commit, loop.evaluations_per_step, loop.window) == ("candidate", 1, 1)
    assert estimation.loop("target").commit == "incumbent"
    told = Scenario.load("pendulum", {"estimation.paper.window": "4", "estimation.target.budget": "9"}).estimation
    assert (told.loop("paper").window, told.loop("target").budget, told.loop("paper").budget) == (4, 9, 30)


# Slips: key of the override, its value, what the message must hold.

MISSPELT = [
    ("limit.divergence", "limit", "limits"),
    ("scenario.stop_tim", "scenario.stop_tim", "stop_time"),
    ("limits.divergance", "limits.divergance", "divergence"),
    ("sampling.derivative", "sampling.derivative", "derivatives"),
    ("estimation.budgt", "estimation.budgt", "budget"),
    ("components.plant.strat", "components.plant.strat", "start"),
    ("estimation.trigger.false_alrm", "estimation.trigger.false_alrm", "false_alarm"),
    ('sampling.derivatives."plant.der(phi_dot)".nois', "nois", "noise"),
    ("estimation.target.n_outptus", "estimation", "n_outputs"),
    ("estimation.paper.nois", "estimation", "noise"),
    ("diagnosi.rest", "diagnosi", "diagnosis"),
    ("diagnosis.longestrest", "diagnosis.longestrest", "longest_rest"),
]


@pytest.mark.parametrize(("key", "place", "hint"), MISSPELT, ids=[m[0] for m in MISSPELT])
def test_an_unknown_key_is_named_with_its_place_and_the_likely_one(key, place, hint):
    message = refusal({key: "1"})
    assert "pendulum.toml: " in message
    assert place in message
    assert message.endswith(f"did you mean '{hint}'?")


def test_an_unknown_key_of_a_parameter_is_named(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(PENDULUM.replace('name = "m"\n', 'name = "m"\nscal = "log"\n'))
    assert refusal(source=path) == f"{path}: estimation.parameters.0.scal: unknown key; did you mean 'scale'?"


BAD_VALUES = [
    ("scenario.macro_step", "0", "scenario.macro_step", "greater than 0"),
    ("scenario.macro_step", "-0.01", "scenario.macro_step", "greater than 0"),
    ("scenario.macro_step", "nan", "scenario.macro_step", "finite"),
    ("scenario.macro_step", "0.003", "scenario", "whole multiple of macro_step, got 10 s and 0.003 s"),
    ("scenario.macro_step", "20.0", "scenario", "whole multiple"),
    ("scenario.stop_time", "inf", "scenario.stop_time", "finite"),
    ("scenario.stop_time", "soon", "scenario.stop_time", "must be a number, got 'soon'"),
    ("scenario.start_time", "20.0", "scenario", "stop_time, 10 s, must be after start_time, 20 s"),
    ("scenario.macro_step", "1e-9", "scenario", "it spans 1e+10 steps of macro_step"),
    ("scenario.name", "a/b", "scenario.name", "pattern"),
    ("scenario.coupling", "paralel", "scenario.coupling", "'sequential' or 'parallel', got 'paralel'"),
    ("scenario.timeout", "1e-9", "scenario.timeout", "greater than or equal to 0.001"),
    ("scenario.name", "a" * 101, "scenario.name", "at most 100 characters"),
    ("estimation.budget", "0", "estimation.budget", "greater than or equal to 1, got 0"),
    ("estimation.window", "1.5", "estimation.window", "integer"),
    ("estimation.commit", "best", "estimation.commit", "'incumbent' or 'candidate'"),
    ("estimation.model", "fmu_models.pendulum", "estimation.model", "pattern"),
    ("estimation.trigger.kind", "innovaton", "estimation.trigger", "innovation"),
    ("estimation.trigger.false_alarm", "0", "estimation.trigger.false_alarm", "greater than 0"),
    ("estimation.target.budget", "0", "estimation.target", "greater than or equal to 1"),
    ("estimation.target.n_outputs", "-5", "estimation.target", "n_outputs"),
    ("estimation.target.n_outputs", "text", "estimation.target", "n_outputs"),
    ("estimation.target.n_outputs", "9.5", "estimation.target", "n_outputs"),
    ("estimation.paper.noise", "-1", "estimation.paper", "noise"),
    ("estimation.paper.noise", "text", "pendulum.toml: estimation.paper.noise: ", "'text'"),
    ('sampling.derivatives."plant.der(phi_dot)".noise', "0", "sampling.derivatives", "noise > 0"),
    ('sampling.outputs."plant.phi".noise', "0", "sampling.outputs", "noise > 0"),
    ('sampling.outputs."controller.u".noise', "1", "sampling", "must be of one component"),
    ('sampling.outputs."plant.der(phi_dot)".noise', "1", "sampling", "noise once"),
    ("sampling.derivatives", "{}", "sampling", "derivatives or outputs"),
    ('connections."plant.u"', "controlr.u", "connections", "no component 'controlr'; did you mean 'controller'?"),
    ('connections."plant.u"', "u", "connections.plant.u", "COMPONENT.VARIABLE"),
    ('changes."plnt.m"', "1", "changes", "no component 'plnt'; did you mean 'plant'?"),
    ('changes."plant.m"', "sinn(t)", "changes.plant.m", "calls sinn"),
    ('changes."plant.m"', "[[1.0, 1], [0.0, 2]]", "plant.m", "times of a change must rise"),
    ('changes."plant.m"', "nan", "changes.plant.m", "finite"),
    ('changes."plant.m"', "true", "changes.plant.m", "number"),
    ("definitions.a", "bcd", "definitions.a", "'bcd'"),
    ("components.plant.fmu", "3", "components.plant.fmu", "string"),
    ("limits.divergence", "-1", "limits.divergence", "greater than 0"),
    ("diagnosis.rest", "0", "diagnosis.rest", "greater than or equal to 1, got 0"),
    ("diagnosis.rest", "1.5", "diagnosis.rest", "integer"),
    ("diagnosis.rest", "20000", "diagnosis", "rest must be from 1 to longest_rest, got 20000 and 16000"),
    ("diagnosis.longest_rest", "999", "diagnosis", "rest must be from 1 to longest_rest, got 1000 and 999"),
    ("diagnosis.false_alarm", "0", "diagnosis.false_alarm", "greater than 0, got 0"),
    ("diagnosis.false_alarm", "1", "diagnosis.false_alarm", "less than 1, got 1"),
    ("diagnosis.false_alarm", "nan", "diagnosis.false_alarm", "finite"),
    ("diagnosis.enabled", "perhaps", "diagnosis.enabled", "must be true or false"),
    ("diagnosis.never", "1", "diagnosis.never", "unknown key"),
    ("diagnosis", "3", "diagnosis", "got 3"),
    ("diagnosis", "false", "diagnosis", "must be a table, got False"),
    ("folder", "elsewhere", "folder", "unknown key"),
    ("tracking", "{}", "tracking", "must have 1 at least, got 0"),
    ('tracking."plant.phi"', "plant.phi", "tracking", "'plant.phi' is tracked against itself"),
    ("estimation.parameters", "[]", "estimation.parameters", "must have 1 at least, got 0"),
    ("estimation.parameters", "3", "estimation.parameters", "must be a list, got 3"),
    (
        "estimation.trigger.kind",
        "inovation",
        "estimation.trigger",
        "kind must be one of 'tracking', 'innovation', 'always'",
    ),
    ("estimation.trigger", "{}", "estimation.trigger", "kind is missing"),
    ('changes."plant.m"', "[[0.0]]", "changes.plant.m.0.1", "is missing"),
    ('changes."plant.m"', "[]", "changes.plant.m", "has no rows"),
    ("guard.tolerance", "1e300", "guard.tolerance", "at most 1e+100 in size"),
    ('sampling.derivatives."plant.der(phi_dot)".noise', "1e-300", "noise", "0 or at least 1e-100"),
    ('changes."plant.m"', "2 * y", "changes.plant.m", "the formula '2 * y' has an unknown name, 'y'; it may have "),
]


@pytest.mark.parametrize(("key", "value", "place", "rule"), BAD_VALUES, ids=[f"{b[0]}={b[1]}" for b in BAD_VALUES])
def test_a_bad_value_is_told_with_file_key_and_rule(key, value, place, rule):
    message = refusal({key: value})
    assert "pendulum.toml: " in message
    assert place in message
    assert rule in message


def edited(tmp_path, old, new):
    assert old in PENDULUM
    path = tmp_path / "mine.toml"
    path.write_text(PENDULUM.replace(old, new))
    return path


BAD_FILES = [
    ("reversed bounds", "lower = 0.1\nupper = 5.0", "lower = 5.0\nupper = 0.1",
     r"estimation.parameters.0: parameter 'm' must have finite lower < upper, got \[5.0, 0.1\] kg\."),
    ("zero on a log scale", "lower = 0.1\nupper = 5.0", "lower = 0.0\nupper = 5.0",
     r"estimation.parameters.0: parameter 'm' must have lower > 0 on a log scale, got 0.0 kg\."),
    ("a name twice", 'name = "l"', 'name = "m"', r"estimation: parameter names must differ, got 'm' twice\."),
    ("no stop time", "stop_time = 10.0", "", r"scenario\.stop_time: is missing\."),
    ("no tracking", '"plant.phi" = "reference.phi_ref"', "", "tracking: must have 1 at least, got 0"),
    ("broken TOML", "[changes]", "[[changes", "not a readable TOML file"),
    ("a key twice", "[scenario]", "[scenario]\nname = 'x'", "not a readable TOML file"),
]  # fmt: skip


def test_a_byte_order_mark_is_no_part_of_a_file(tmp_path):
    """As some Windows editors write it."""
    path = edited(tmp_path, "[scenario]", "[scenario]")
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert Scenario.load(path).scenario.name == "pendulum"
    path.write_text("[scenario]", encoding="utf-16")
    with pytest.raises(ScenarioError, match="not a readable TOML file: it is not UTF-8"):
        Scenario.load(path)


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are bytes on Linux only")
def test_a_folder_whose_name_is_not_utf_8_is_refused_before_anything_runs(tmp_path):
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/lat\xe9"))
    folder.mkdir()
    (folder / "pendulum.toml").write_text(PENDULUM, encoding="utf-8")
    with pytest.raises(ScenarioError, match="the name of its folder is not UTF-8 here, which FMUs need"):
        Scenario.load(folder / "pendulum.toml")


@pytest.mark.parametrize(("old", "new", "rule"), [b[1:] for b in BAD_FILES], ids=[b[0] for b in BAD_FILES])
def test_a_bad_file_is_told_with_its_path_key_and_rule(tmp_path, old, new, rule):
    path = edited(tmp_path, old, new)
    with pytest.raises(ScenarioError, match=rf"^{path}: {rule}"):
        Scenario.load(path)


def test_a_file_that_is_not_text_is_told(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_bytes(b"\xff\xfe\x00")
    assert refusal(source=path).startswith(f"{path}: not a readable TOML file")


NO_FILES = [
    ("a misspelt name", "pendulm"),
    ("nothing", ""),
    ("a null byte", "a\0b"),
    ("a page", "a" * 5000),
    ("lines", "a\nb"),
]


@pytest.mark.parametrize("source", [s for _, s in NO_FILES], ids=[name for name, _ in NO_FILES])
def test_a_scenario_that_is_not_there_is_told_in_one_line(source):
    assert "no scenario" in refusal(source=source)


def test_a_misspelt_scenario_brings_a_suggestion():
    assert refusal(source="quadroter").endswith("did you mean 'quadrotor'?")


def test_a_start_value_that_no_double_holds_is_refused():
    text = "components.plant.start.phi: must be a number that a double can hold, got a larger one."
    assert refusal({"components.plant.start.phi": f"-1{'0' * 400}"}).endswith(text)


def test_a_span_of_infinitely_many_steps_is_refused():
    assert "macro_step" in refusal({"scenario.stop_time": "1e99", "scenario.macro_step": "1e-300"})


# Whatever a file holds.

SCALARS = st.one_of(
    st.booleans(),
    st.integers(-(10**30), 10**30),
    st.sampled_from([0, 1, -1, 10**400]),
    st.floats(),
    st.sampled_from(["", "t", "sin", "sin(t", "plant.m", "plant.u", "controller.m", "target", "innovation", "x" * 300]),
    st.text(st.characters(min_codepoint=32, max_codepoint=0x2FF, exclude_characters="\x7f"), max_size=8),
)
KEYS = st.one_of(
    st.sampled_from([
        *Scenario.model_fields, "kind", "threshold", "noise", "fmu", "start", "name", "lower", "upper", "writes",
        "target", "paper", "plant", "plant.m", "plant.u", "stop_time", "macro_step", "model", "parameters", "trigger",
    ]),
    st.text("abc._-\"' é", max_size=4),
)  # fmt: skip
TREES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=4),
    max_leaves=15,
)


def toml(value):
    """The value as TOML text on one line; JSON's strings are TOML's."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k, ensure_ascii=False)} = {toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return json.dumps(value, ensure_ascii=False)


def load_tree(folder: Path, tree):
    path = folder / "any.toml"
    path.write_text("\n".join(f"{json.dumps(k, ensure_ascii=False)} = {toml(v)}" for k, v in tree.items()), "utf-8")
    try:
        return Scenario.load(path)
    except ScenarioError as refused:
        assert len(str(refused).splitlines()) == 1
        return None


def test_a_tree_written_by_the_fuzz_is_the_same_scenario(tmp_path):
    assert load_tree(tmp_path, tomllib.loads(PENDULUM)).estimation == Scenario.load("pendulum").estimation


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(tree=st.dictionaries(KEYS, TREES, max_size=5))
def test_random_files_are_refused_as_scenario_errors(tmp_path, tree):
    assert load_tree(tmp_path, tree) is None


def paths_of(tree, here=()):
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ():
        yield (*here, key)
        yield from paths_of(value, (*here, key))


PLACES = list(paths_of(tomllib.loads(PENDULUM)))


@pytest.mark.full
@settings(max_examples=400, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.sampled_from(PLACES), value=TREES)
@example(place=("connections", "controller.phi"), value="\x85")  # a line break to str.splitlines
def test_a_good_file_with_anything_in_one_place_loads_or_is_refused_as_a_scenario_error(tmp_path, place, value):
    tree = tomllib.loads(PENDULUM)
    below = tree
    for key in place[:-1]:
        below = below[key]
    below[place[-1]] = value
    load_tree(tmp_path, tree)


@pytest.mark.parametrize(
    "key",
    ["observations.patience", "estimation.window", "guard.horizon", "scenario.timeout", "diagnosis.longest_rest"],
)
def test_a_count_or_a_time_that_no_machine_can_hold_is_refused(key):
    with pytest.raises(ScenarioError, match=rf"{key}: input should be less than or equal to 1000000000"):
        Scenario.load("pendulum", {key: "1" + 20 * "0"})


@pytest.mark.parametrize("text", ["a = " + 20_000 * "[", "a = " + 100_000 * "1"], ids=["nested", "long"])
def test_toml_that_is_too_much_for_its_reader_is_refused_in_one_line(text, tmp_path):
    path = tmp_path / "much.toml"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=r"much\.toml: not a readable TOML file: .*$"):
        Scenario.load(path)


# Former names.


@pytest.fixture
def told(caplog):
    """The lines on former names; each is told once a process."""
    tell_new_name.cache_clear()
    return lambda: [record.getMessage() for record in caplog.records]


def test_a_key_by_its_former_name_is_taken_and_the_new_one_told_once(told):
    for _ in range(2):
        scenario = Scenario.load("pendulum", {"guard.foresight": "false"})
        assert not scenario.guard.lookahead
    assert told() == ["guard.foresight is now guard.lookahead"]
    assert "foresight" not in scenario.model_dump()["guard"]


def test_a_key_by_both_names_is_refused():
    message = refusal({"guard.foresight": "false", "guard.lookahead": "true"})
    assert "guard: 'foresight' is now 'lookahead': leave out 'foresight'" in message


@pytest.mark.parametrize("name", ["ipm", "ipm-scipy", "sqp"])
def test_an_estimator_by_its_former_name_is_another_with_a_setting(told, name):
    former = f"{name}-wide-step"
    scenario = Scenario.load(
        "pendulum", {f"estimation.{name}.noise": "0.5", f"estimation.{former}.max_iterations": "3"}
    )
    assert told() == [f"estimator '{former}' is now '{name}' with estimation.{name}.difference_step = 0.05"]
    now = Scenario.load(
        "pendulum",
        {
            f"estimation.{name}.{key}": value
            for key, value in {"noise": "0.5", "max_iterations": "3", "difference_step": "0.05"}.items()
        },
    )
    assert scenario.estimation.settings(former) == now.estimation.settings(name)
    assert scenario.estimation.loop(former) == now.estimation.loop(name)
    assert scenario.estimation.settings(name).difference_step == 0.0


@pytest.mark.parametrize("fault", ['{kind = "stuck"}', '{kind = "dropout"}', '{kind = "bias", size = 0.0}'])
def test_a_scenario_with_a_sensor_fault_is_read_back_from_its_manifest(fault):
    scenario = Scenario.load("pendulum", {"sampling.faults": f"[{fault}]"})
    assert Scenario.model_validate(scenario.model_dump(mode="json")).sampling == scenario.sampling
