"""Direct feedthrough from ModelStructure, and the loops that connections close by it."""

import pytest

from cosim.fmi.component import read_component
from cosim.fmi.feedthrough import algebraic_loops, declared, feedthrough

GAIN = """<ScalarVariable name="u" valueReference="0" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="w" valueReference="1" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="y" valueReference="2" causality="output"><Real/></ScalarVariable>"""


@pytest.fixture
def gain(described):
    """An FMU with inputs u, w and the output y, which depends on what is given."""

    def make(name, dependencies):
        attribute = "" if dependencies is None else f'dependencies="{dependencies}"'
        return read_component(described(GAIN, f'<Outputs><Unknown index="3" {attribute}/></Outputs>', name))

    return make


@pytest.mark.parametrize(
    ("dependencies", "said", "inputs"), [("", [], []), ("2", ["w"], ["w"]), (None, None, ["u", "w"])]
)
def test_an_output_depends_on_what_is_declared_and_else_on_every_input(gain, dependencies, said, inputs):
    component = gain("A", dependencies)
    assert declared(component) == {"y": said}
    assert feedthrough(component, ["u", "w"], ["y"]) == {"y": inputs}
    assert feedthrough(component, ["w"], ["y"]) == {"y": [name for name in inputs if name == "w"]}
    assert feedthrough(component, ["u", "w"], []) == {}


def test_a_loop_needs_feedthrough_in_every_component_on_it(gain):
    through, latched = gain("A", "1"), gain("B", "2")
    connections = {"a.u": "b.y", "b.u": "a.y"}
    assert algebraic_loops({"a": through, "b": latched}, connections) == []
    (loop,) = algebraic_loops({"a": through, "b": gain("C", "1")}, connections)
    assert set(loop.nodes) == {"a.u", "a.y", "b.u", "b.y"}
    assert loop.undeclared == ()
    following = dict(zip(loop.nodes, [*loop.nodes[1:], loop.nodes[0]], strict=True))
    assert following == {"a.y": "a.u", "a.u": "b.y", "b.y": "b.u", "b.u": "a.y"}


def test_one_loop_is_told_of_those_that_share_variables_and_who_left_it_open(gain):
    silent, own = gain("A", None), gain("B", "1 2")
    connections = {"a.u": "b.y", "b.u": "a.y", "a.w": "b.y", "b.w": "a.y", "c.u": "c.y"}
    first, second = algebraic_loops({"a": silent, "b": own, "c": own}, connections)
    assert (len(first.nodes), first.undeclared) == (4, ("a",))
    assert set(second.nodes) == {"c.u", "c.y"}
    assert algebraic_loops({"a": silent}, {}) == []
