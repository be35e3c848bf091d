"""Parameters that `retune new` writes: which of plant and controller belong together, under which names and bounds."""

import re
import tomllib

import pytest

from cosim.authoring.check import check
from cosim.authoring.draft import draft

OUTPUT = (
    '<ScalarVariable name="y" valueReference="0" causality="output" initial="exact"><Real start="0"/></ScalarVariable>'
)


def tunable(parameters):
    """Variables by their names: attributes of their start and limits."""
    return "".join(
        f'<ScalarVariable name="{name}" valueReference="{i}" causality="parameter" variability="tunable">'
        f"<Real {attributes}/></ScalarVariable>"
        for i, (name, attributes) in enumerate(parameters.items(), 1)
    )


@pytest.fixture
def drafted(described, tmp_path):
    """drafted(parameters of the plant, of the controller, model): the text of a draft; `check` takes its parameters."""

    def write(its, own, model=None):
        fmus = {
            "plant": described(OUTPUT + tunable(its), name="P"),
            "controller": described(tunable(own), name="C"),
        }
        path = tmp_path / "my.toml"
        path.write_text(draft(fmus, tmp_path, model).text)
        assert not [str(f) for f in check(path) if f.is_error and f.where.startswith("estimation.parameters")]
        return path.read_text()

    return write


SEVERAL = {"ff.m": 'start="2"', "m": 'start="2" max="8"', "Kp": 'start="25"'}


def test_parameters_of_the_controller_that_stand_for_one_of_the_plant_are_written_together(drafted):
    text = drafted({"m": 'start="2" min="0.5" max="20"'}, SEVERAL)
    (parameter,) = tomllib.loads(text)["estimation"]["parameters"]
    assert parameter == {
        "name": "m", "lower": 0.5, "upper": 8.0, "unit": "1", "scale": "log", "start": 2.0,
        "writes": {"controller.m": "m", "controller.ff.m": "m"},
    }  # fmt: skip
    assert re.findall(r'^# "plant.m" = .*\]\]', text, flags=re.M) == ['# "plant.m" = [[0.0, 2.0], [3.33, 3]]']
    assert "not estimated: Kp" in text


def test_a_model_that_is_an_fmu_has_one_name_for_them_too(drafted, described):
    own = {"m": 'start="2"', "mass.m": 'start="2"'}
    text = drafted({"mass.m": 'start="2"'}, own, str(described("", name="M")))
    (parameter,) = tomllib.loads(text)["estimation"]["parameters"]
    assert (parameter["name"], parameter["start"]) == ("mass.m", 2.0)
    assert parameter["writes"] == {"controller.mass.m": "mass_m", "controller.m": "mass_m"}


def test_names_that_are_one_identifier_are_numbered(drafted):
    both = {"spring.c": 'start="8"', "spring_c": 'start="9"', "spring(c)": 'start="7"'}
    text = drafted(both, both)
    found = [(p["name"], p["writes"]) for p in tomllib.loads(text)["estimation"]["parameters"]]
    assert found == [
        ("spring_c", "controller.spring.c"),
        ("spring_c_2", "controller.spring_c"),
        ("spring_c_3", "controller.spring(c)"),
    ]
    assert "def derivative(x, u, spring_c, spring_c_2, spring_c_3):" in text


@pytest.mark.parametrize(
    ("its", "own", "bounds"),
    [
        ('min="0.5" max="20"', 'min="25" max="30" start="26"', (25.0, 30.0)),
        ('min="0.5" max="20"', 'min="25" start="26"', (25.0, 260.0)),
        ('min="25" max="30"', 'max="25" start="2"', (0.2, 25.0)),
    ],
)
def test_bounds_are_the_controller_s_where_the_plant_takes_none_of_its_values(drafted, its, own, bounds):
    text = drafted({"m": f'start="2" {its}'}, {"m": own})
    (parameter,) = tomllib.loads(text)["estimation"]["parameters"]
    assert (parameter["lower"], parameter["upper"]) == bounds
    assert text.count("GUESS: no value is within the limits of both FMUs") == 2


@pytest.mark.parametrize("model", [None, "fmu"])
@pytest.mark.parametrize(("name", "argument"), [("min", "p_min"), ("exp", "p_exp"), ("lambda", "p_lambda"), ("e", "e")])
def test_gains_follow_from_a_parameter_named_like_a_function(drafted, described, name, argument, model):
    text = drafted({name: 'start="2"'}, {"Kp": 'start="25"'}, model and str(described("", name="M")))
    (parameter,) = tomllib.loads(text)["estimation"]["parameters"]
    assert parameter["name"] == (name if model else argument)
    assert parameter["writes"] == {"controller.Kp": f"25.0 * {argument} / 2.0"}
