"""VariableName: COMPONENT.VARIABLE and its two parts."""

import pickle

import pytest

from cosim.variable_name import VariableName


@pytest.mark.parametrize(
    ("text", "component", "variable"),
    [("plant.m", "plant", "m"), ("plant.der(phi_dot)", "plant", "der(phi_dot)"), ("a.body.R[1,2]", "a", "body.R[1,2]")],
)
def test_the_first_dot_ends_the_component(text, component, variable):
    name = VariableName(text)
    assert (name.component, name.variable) == name.parts == (component, variable)
    assert name == text
    assert {text: 1.0}[name] == 1.0
    assert pickle.loads(pickle.dumps(name)).component == component


@pytest.mark.parametrize("text", ["", "m", ".m", "plant."])
def test_a_name_without_component_or_variable_is_refused(text):
    with pytest.raises(ValueError, match=r"must be COMPONENT\.VARIABLE"):
        VariableName(text)
