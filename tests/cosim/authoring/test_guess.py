"""What is guessed of names and units."""

import pytest

from cosim.authoring.guess import LAST_WORDS, LIKE, SAME, SAME_WORDS, alike, guess_connections, is_desired
from cosim.authoring.guess_tracking import guess_tracking
from cosim.fmi.component import read_component


@pytest.mark.parametrize(
    ("name", "other", "how"),
    [
        ("phi", "phi", SAME),
        ("phiRef", "phi_ref", SAME_WORDS),
        ("phi_ref", "phi", SAME_WORDS),
        ("r_d_x", "r_x", SAME_WORDS),
        ("f_cmd", "f", SAME_WORDS),
        ("s_meas", "mass.s", LAST_WORDS),
        ("der_v", "mass.v", None),
        ("v", "der(v)", None),
        ("force1", "force", LIKE),
        ("torque", "speed", None),
        ("d", "d_ref", SAME_WORDS),
        ("ref", "set", None),
        ("pos", "position", LIKE),
        ("cart.vel", "cart.velocity", LIKE),
        ("po", "position", None),
    ],
)
def test_names_are_alike_by_their_words(name, other, how):
    assert alike(name, other) == alike(other, name) == how


@pytest.mark.parametrize(("name", "yes"), [("phi_ref", True), ("r_d_x", True), ("d", False), ("phi", False)])
def test_a_set_point_is_known_by_its_name(name, yes):
    assert is_desired(name) is yes


def variables(**units):
    parts = []
    for i, (name, (causality, unit)) in enumerate(units.items()):
        attribute = f'unit="{unit}"' if unit else ""
        start = 'start="0"' if causality == "input" else ""
        parts.append(
            f'<ScalarVariable name="{name}" valueReference="{i}" causality="{causality}"><Real {attribute} {start}/>'
            "</ScalarVariable>"
        )
    return "".join(parts)


@pytest.fixture
def joined(described):
    """What is guessed for FMUs with these variables: source and likelihood by target."""

    def guess(plant, controller, reference=None):
        components = {
            "plant": read_component(described(variables(**plant), name="P")),
            "controller": read_component(described(variables(**controller), name="C")),
        }
        if reference:
            components["reference"] = read_component(described(variables(**reference), name="R"))
        return {g.target: (g.source, g.is_likely) for g in guess_connections(components)}

    return guess


def test_same_name_and_unit_is_likely_and_anything_less_is_to_be_looked_at(joined):
    found = joined(
        {"y": ("output", "m"), "speed": ("output", ""), "u": ("input", "N")},
        {"y": ("input", "m"), "speed": ("input", ""), "u": ("output", "N")},
    )
    assert found == {
        "controller.y": ("plant.y", True),
        "controller.speed": ("plant.speed", False),
        "plant.u": ("controller.u", True),
    }


def test_two_outputs_that_fit_alike_are_no_likely_guess(joined):
    found = joined({"a.x": ("output", "m"), "b.x": ("output", "m")}, {"x": ("input", "m")})
    assert found["controller.x"][0] in ("plant.a.x", "plant.b.x")
    assert not found["controller.x"][1]


def test_an_input_without_a_name_like_it_takes_the_only_output_left_in_its_unit(joined):
    found = joined({"u": ("input", "N"), "w": ("input", "K")}, {"thrust": ("output", "N"), "heat": ("output", "W")})
    assert found == {"plant.u": ("controller.thrust", False), "plant.w": (None, False)}


def test_a_plant_takes_what_the_reference_has_by_its_exact_name_to_be_looked_at(joined):
    found = joined(
        {"u": ("input", ""), "To": ("input", "K"), "vh": ("input", ""), "T": ("output", "K")},
        {"T": ("input", "K"), "To": ("input", "K"), "u": ("output", "")},
        {"To": ("output", "K"), "vh_ref": ("output", "")},
    )
    assert found["plant.To"] == ("reference.To", False)
    assert found["controller.To"] == ("reference.To", True)
    assert found["plant.vh"] == (None, False)  # the same words are not enough: it would be a set point


def test_what_the_plant_takes_of_the_reference_is_no_set_point(described):
    """A heat exchanger's temperature at the inlet is not what its outlet shall have."""
    components = {
        "plant": read_component(
            described(
                variables(T_in=("input", "K"), steam=("input", ""), T_out=("output", "K"), T_meas=("output", "K")),
                name="P",
            )
        ),
        "controller": read_component(
            described(variables(T_set=("input", "K"), T_meas=("input", "K"), steam=("output", "")), name="C")
        ),
        "reference": read_component(described(variables(T_set=("output", "K"), T_in=("output", "K")), name="R")),
    }
    assert [(g.target, g.source) for g in guess_tracking(components)] == [("plant.T_meas", "reference.T_set")]


def test_a_plant_takes_the_controllers_output_of_the_same_words_before_the_references_of_its_name(joined):
    plant, reference = {"s": ("input", "m")}, {"s": ("output", "m")}
    assert joined(plant, {"s_cmd": ("output", "m")}, reference)["plant.s"] == ("controller.s_cmd", True)
    assert joined(plant, {"ds": ("output", "m")}, reference)["plant.s"] == ("reference.s", False)
    converted = joined(plant, {"v": ("output", "K")}, {"s": ("output", "mm")})
    assert converted["plant.s"] == ("reference.s", False)


def test_what_an_input_takes_by_its_exact_name_is_not_given_to_another_by_a_likeness(joined):
    found = joined(
        {"U": ("input", "m"), "dU": ("input", "m"), "U_d": ("input", ""), "U_in": ("input", "mm")},
        {"U": ("output", "m"), "monitor": ("output", "m")},
    )
    assert found["plant.U"] == ("controller.U", True)
    assert {found[f"plant.{name}"] for name in ("dU", "U_d")} == {(None, False)}
    assert found["plant.U_in"][0] != "controller.U"  # nor is it converted


def test_of_two_inputs_with_a_like_name_that_are_no_exact_one_both_take_the_output(joined):
    found = joined({"a.f": ("input", "N"), "b.f": ("input", "N")}, {"f": ("output", "N")})
    assert {source for source, _ in found.values()} == {"controller.f"}


def test_a_set_point_is_shared_with_an_input_of_its_exact_name(joined):
    found = joined({"y": ("output", "")}, {"T": ("input", ""), "T_set": ("input", "")}, {"T": ("output", "")})
    assert found["controller.T_set"][0] == "reference.T"
