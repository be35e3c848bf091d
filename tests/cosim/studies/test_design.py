"""Studies as they are written: factors, how they are combined, and what is refused in one line."""

import math
import warnings

import numpy as np
import pytest
from scipy.stats import kstest, qmc

from cosim.commands.study import restricted
from cosim.errors import ScenarioError
from cosim.scenarios.overrides import sweep
from cosim.studies.definition import checked_definition, read_definition
from cosim.studies.design import points


def study(factors, **settings):
    table = {"name": "s", "scenarios": ["pendulum"]} | settings
    return checked_definition({"study": table, "factors": factors}, "s.toml")


def values(factors, **settings):
    return [point.values for point in points(study(factors, **settings))]


M = {"set": 'changes."plant.m"'}
B = {"set": "estimation.budget"}


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ({"list": [3, 1, 2]}, [3, 1, 2]),
        ({"grid": [1.0, 2.0, 5]}, [1.0, 1.25, 1.5, 1.75, 2.0]),
        ({"range": [10, 30, 10]}, [10, 20, 30]),
        ({"range": [0.1, 0.35, 0.1]}, [0.1, 0.2, pytest.approx(0.3)]),
        ({"range": [3, 1, -1]}, [3, 2, 1]),
    ],
    ids=["list", "grid", "range", "range that ends before its end", "range downwards"],
)
def test_given_values_are_these(kind, expected):
    assert [v["m"] for v in values({"m": M | kind})] == expected


def test_crossed_factors_have_every_pair_and_paired_ones_one_each():
    factors = {"m": M | {"list": [1, 2, 3]}, "b": B | {"list": [10, 20, 30]}}
    assert len(values(factors)) == 9
    assert values(factors)[:2] == [{"m": 1, "b": 10}, {"m": 1, "b": 20}]
    assert values(factors, combine="paired") == [{"m": 1, "b": 10}, {"m": 2, "b": 20}, {"m": 3, "b": 30}]


def test_factors_of_different_lengths_are_not_paired():
    with pytest.raises(ScenarioError, match=r"equally many values, got m 2, b 3\.$"):
        values({"m": M | {"list": [1, 2]}, "b": B | {"list": [1, 2, 3]}}, combine="paired")


@pytest.mark.parametrize("sampling", ["sobol", "latin-hypercube", "random"])
def test_drawn_values_have_their_distribution(sampling):
    factors = {
        "u": M | {"uniform": [2.0, 5.0]}, "l": B | {"log-uniform": [0.01, 100.0]},
        "n": {"set": "estimation.window", "normal": [3.0, 0.5]},
    }  # fmt: skip
    drawn = values(factors, sampling=sampling, samples=256)
    u, log, n = (np.array([v[name] for v in drawn]) for name in "uln")
    assert kstest(u, "uniform", (2.0, 3.0)).pvalue > 0.01
    assert kstest(np.log(log), "uniform", (math.log(0.01), math.log(1e4))).pvalue > 0.01
    assert kstest(n, "norm", (3.0, 0.5)).pvalue > 0.01
    assert drawn == values(factors, sampling=sampling, samples=256)  # the same study has the same points


def test_sobol_fills_the_square_more_evenly_than_chance():
    factors = {"a": M | {"uniform": [0.0, 1.0]}, "b": B | {"uniform": [0.0, 1.0]}}
    discrepancy = {
        name: qmc.discrepancy([[v["a"], v["b"]] for v in values(factors, sampling=name, samples=128)])
        for name in ("sobol", "random")
    }
    assert discrepancy["sobol"] < 0.2 * discrepancy["random"]


def test_a_point_is_settings_as_set_takes_them():
    factors = {
        "payload": {"set": 'changes."plant.m"', "to": "[[0.0, 1.75], [0.5, {}]]", "list": [4.0]},
        "both": {"set": {"a.b": "{}", "a.c": "[{}, 1]"}, "list": ["x"]},
    }
    (point,) = points(study(factors, settings={"scenario.stop_time": 2.0, "a.on": True}))
    assert point.settings == {
        "scenario.stop_time": "2.0", "a.on": "true", 'changes."plant.m"': "[[0.0, 1.75], [0.5, 4.0]]",
        "a.b": '"x"', "a.c": '["x", 1]',
    }  # fmt: skip


def test_choices_are_settings_by_name():
    gust = {'changes."plant.F_d"': [[0.0, 0.0], [0.5, 4.0]]}
    made = list(points(study({"case": {"choices": {"quiet": {}, "gust": gust}}, "b": B | {"list": [5]}})))
    assert [point.values for point in made] == [{"case": "quiet", "b": 5}, {"case": "gust", "b": 5}]
    assert made[0].settings == {"estimation.budget": "5"}
    assert made[1].settings == {'changes."plant.F_d"': "[[0.0, 0.0], [0.5, 4.0]]", "estimation.budget": "5"}


PARTS = {
    "study": {"name": "s", "scenarios": ["pendulum", "stiction"], "settings": {"scenario.stop_time": 2.0}},
    "factors": {"case": {"choices": {"quiet": {}, "late": {"a.b": 1}}}},
    "scenarios": {
        "stiction": {
            "estimators": ["none", "ukf"], "settings": {"scenario.stop_time": 3.0},
            "factors": {"case": {"choices": {"gust": {"a.c": 2}}}, "b": B | {"list": [5]}},
        },
    },
}  # fmt: skip


def test_a_scenario_has_settings_estimators_and_factors_of_its_own():
    definition = checked_definition(PARTS, "s.toml")
    assert definition.factor_names == ("case", "b")
    assert definition.estimators == ("none", "true", "target", "ukf")
    pendulum, stiction = (list(points(definition.at(name))) for name in ("pendulum", "stiction"))
    assert [p.values for p in pendulum] == [{"case": "quiet"}, {"case": "late"}]
    assert pendulum[1].settings == {"scenario.stop_time": "2.0", "a.b": "1"}
    assert [p.values for p in stiction] == [{"case": name, "b": 5} for name in ("quiet", "late", "gust")]
    assert stiction[2].settings == {"scenario.stop_time": "3.0", "a.c": "2", "estimation.budget": "5"}
    assert definition.at("pendulum").study.estimators == ("none", "true", "target")
    assert definition.at("stiction").study.estimators == ("none", "ukf")


def test_seeds_are_by_estimator_and_by_scenario():
    table = {"name": "s", "scenarios": ["pendulum", "stiction"], "estimators": ["none", "target"],
             "seeds": {"none": 1, "target": 3}}  # fmt: skip
    definition = checked_definition({"study": table, "scenarios": {"stiction": {"seeds": [7]}}}, "s")
    pendulum, stiction = (definition.at(name).study for name in ("pendulum", "stiction"))
    assert [pendulum.estimators_at(seed) for seed in range(4)] == [("none", "target"), ("target",), ("target",), ()]
    assert (stiction.seed_numbers, stiction.estimators_at(7)) == ((7,), ("none", "target"))
    assert definition.seed_numbers == (0, 1, 2, 7)


def test_fewer_estimators_and_seeds_are_a_part_of_the_study():
    made = restricted(checked_definition(PARTS, "s"), ["none", "target"], 1, "s")
    assert (made.at("pendulum").study.estimators, made.at("stiction").study.estimators) == (
        ("none", "target"), ("none",),
    )  # fmt: skip
    for seeds, fewer in ((20, 2), ([4, 5, 6], (4, 5)), ({"none": 1, "target": 9, "true": 2}, None)):
        made = restricted(study({}, seeds=seeds), None, 2, "s")
        assert made.study.seeds == (fewer or {"none": 1, "target": 2, "true": 2})
    with pytest.raises(ScenarioError, match=r"^s: its estimators are none, true, target, not ukf\.$"):
        restricted(study({}), ["ukf"], None, "s")


def test_a_study_of_some_estimators_has_the_scenarios_that_have_any():
    made = restricted(checked_definition(PARTS, "s"), ["target"], None, "s")
    assert made.study.scenarios == tuple(name for name in PARTS["study"]["scenarios"] if name != "stiction")


def test_a_study_of_estimators_that_one_scenario_has_with_its_seeds_has_these():
    table = {"name": "s", "scenarios": ["pendulum"], "estimators": ["none"], "seeds": {"none": 1}}
    own = {"pendulum": {"estimators": ["target"], "seeds": {"target": 2}}}
    made = restricted(checked_definition({"study": table, "scenarios": own}, "s"), ["target"], None, "s")
    assert made.at("pendulum").study.seeds == {"target": 2}


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ({"factors": {"m": M}}, "factors.m: must have one of list, choices, grid"),
        ({"factors": {"m": M | {"list": [1], "grid": [1, 2, 3]}}}, "got list and grid"),
        ({"factors": {"m": M | {"uniform": [2.0, 1.0]}}}, "uniform must have lower < upper"),
        ({"factors": {"m": M | {"log-uniform": [0.0, 1.0]}}}, "log-uniform must have 0 < lower < upper"),
        ({"factors": {"m": M | {"normal": [0.0, 0.0]}}}, "standard deviation above 0"),
        ({"factors": {"m": M | {"list": [1.0, math.inf]}}}, r"factors\.m\.list: must have finite numbers, got inf"),
        ({"factors": {"m": {"choices": {"a": {"b": [{"c": math.nan}]}}}}}, "must have finite numbers, got nan"),
        ({"study": {"settings": {"guard.rate": math.inf}}}, r"study\.settings: must have finite numbers, got inf"),
        ({"study": {"seeds": [2**63]}}, "study.seeds"),
        ({"factors": {"m": M | {"range": [1, 2, 0]}}}, "range has no values"),
        ({"factors": {"m": M | {"range": [1.0, 0.5, 1.0]}}}, "range has no values"),
        ({"factors": {"m": M | {"range": [0, 1e300, 1e-300]}}}, "range has inf values"),
        ({"factors": {"m": M | {"range": [2.0, 3.0, 1e-12]}}}, r"range has 1e\+12 values, at most 1e\+06 are made"),
        ({"factors": {"m": M | {"grid": [2.0, 3.0, 10**9]}}}, r"grid has 1e\+09 values, at most 1e\+06 are made"),
        (
            {"factors": {"m": M | {"list": [1]}, "n": M | {"list": [2]}}},
            "'m' and 'n' both set changes.\"plant.m\": make",
        ),
        (
            {"factors": {"m": M | {"list": [1]}, "n": {"choices": {"a": {'changes."plant.m"': 2}}}}},
            "'m' and 'n' both set",
        ),
        ({"factors": {"m": M | {"list": [1]}, "n": {"set": "changes.'plant.m'", "list": [2]}}}, "'m' and 'n' both set"),
        (
            {"factors": {"m": M | {"list": [1]}, "n": {"choices": {"a": {}, "b": {"changes": {"plant.F_d": 1}}}}}},
            "'m' sets changes.\"plant.m\" and 'n' sets changes, one in the other: set the table's entries one by one",
        ),
        ({"factors": {"n": {"choices": {"a": {"changes": {}}}}, "m": M | {"list": [1]}}}, "one in the other"),
        ({"factors": {"m": {"list": [1]}}}, "must have 'set'"),
        ({"factors": {"m": M | {"choices": {"a": {}}}}}, "and choices, which have their keys, none"),
        ({"factors": {"m": M | {"to": "2", "list": [1]}}}, "factors.m.to"),
        ({"factors": {"seed": M | {"list": [1]}}}, "'seed' is a column of the table already"),
        ({"factors": {"writes": M | {"list": [1]}}}, "'writes' is a column of the table already"),
        ({"factors": {"m": M | {"liste": [1]}}}, r"factors\.m\.liste: unknown key; did you mean 'list'"),
        ({"factors": {"m": M | {"uniform": [1, 2]}}, "study": {"samples": 100}}, "power of two for sobol, such as 128"),
        ({"study": {"seeds": [1, 1]}}, "seeds must be different ones"),
        ({"study": {"seeds": 0}}, r"study\.seeds: input should be greater than or equal to 1, got 0\.$"),
        ({"study": {"seeds": {"none": 1}}}, "seeds of pendulum must be those of none, true, target, got those of none"),
        ({"study": {"seeds": {"none": 1, "true": 1, "target": 1, "ukf": 1}}}, "got those of none, true, target, ukf"),
        ({"scenarios": {"pendulun": {}}}, "scenarios: 'pendulun' is none of the study's scenarios, which are pendulum"),
        ({"scenarios": {"pendulum": {"estimator": ["ukf"]}}}, "did you mean 'estimators'"),
        ({"scenarios": {"pendulum": {"factors": {"mse": M | {"list": [1]}}}}}, "'mse' is a column of the table"),
        ({"study": {"estimator": ["target"]}}, "did you mean 'estimators'"),
        ({"study": {"name": "a/b"}}, "name without slashes"),
    ],
)
def test_a_study_that_makes_no_sense_is_refused_in_one_line(table, told):
    tables = {"study": {"name": "s", "scenarios": ["pendulum"]} | table.get("study", {})}
    with pytest.raises(ScenarioError, match=told) as caught:
        checked_definition(table | tables, "s.toml")
    assert str(caught.value).startswith("s.toml: ")
    assert len(str(caught.value).splitlines()) == 1


def test_a_study_of_a_scenarios_file_is_refused_in_one_line(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text("[scenario]\nname = 'x'")
    with pytest.raises(ScenarioError, match=r"scenario: unknown key"):
        read_definition(path)


def test_sobol_warns_of_nothing():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(values({"u": M | {"uniform": [0.0, 1.0]}}, samples=8)) == 8


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("10,20, 30", ["10", "20", "30"]),
        ("[[0.0, 1.75], [3.0, 4.2]]", ["[[0.0, 1.75], [3.0, 4.2]]"]),
        ("min(t, 1)", ["min(t, 1)"]),
        ('"a,b",c', ['"a,b"', "c"]),
        ("{a = 1, b = 2}", ["{a = 1, b = 2}"]),
        ("a,", ["a,"]),
    ],
)
def test_only_commas_outside_brackets_and_quotes_make_a_sweep(text, parts):
    assert sweep(text) == parts
