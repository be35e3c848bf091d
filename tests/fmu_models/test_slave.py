"""The FMI slave by itself: small models, no FMU."""

import json
import math
import subprocess
import sys
from pathlib import Path
from xml.etree.ElementTree import Element

import pytest
from pythonfmu.enums import Fmi2Status

from fmu_models.kernel.blocks import Adaptive, ControllerSlave, PlantSlave, ReferenceSlave
from fmu_models.kernel.description import (
    VariableRow,
    base_unit,
    define_units,
    input_variable,
    output,
    parameter,
    per_second,
    state,
)


class Tank(PlantSlave):
    """Level that follows an inflow."""

    table = (
        parameter("area", "m2", 2.0, "Cross-section", min=0.1),
        input_variable("q", "m3/s", 1.0, "Inflow"),
        state("h", "m", 0.25, "Level", depends=("area", "q"), nominal=3.0),
    )
    n_calls = 0

    @staticmethod
    def derivative(x, u, area):
        """h_dot = q / area."""
        Tank.n_calls += 1
        return (u[0] / area,)


class Product(ControllerSlave):
    """A product that counts how often it is computed."""

    table = (
        parameter("k", "1", 3.0, "Factor"),
        input_variable("e", "1", 2.0, "Input"),
        output("y", "1", "k e", depends=("k", "e")),
        output("z", "1", "e", depends=("e",)),
    )
    n_calls = 0

    def outputs(self, inputs, parameters):
        """k e and e."""
        self.n_calls += 1
        if inputs[0] < 0.0:
            raise ValueError("must not be 100 % wrong: %s %n")
        return (parameters[0] * inputs[0], inputs[0])


class Clock(ReferenceSlave):
    """Time, or minus time."""

    table = (
        parameter("is_backward", None, False, "Count down", variability="fixed"),
        output("t", "s", "Time", depends=("is_backward",)),
    )

    def outputs(self, time, parameters):
        """Plus or minus the time."""
        return (-time if parameters[0] else time,)


class Lever(ControllerSlave):
    """A product and an offset."""

    table = (
        parameter("k", "1", 1.0, "Factor", min=0.5),
        parameter("offset", "1", 0.5, "Offset"),
        input_variable("e", "1", 2.0, "Input"),
        output("y", "1", "k e + offset", depends=("e", "k", "offset")),
    )

    def outputs(self, inputs, parameters):
        """k e + offset."""
        return (parameters[0] * inputs[0] + parameters[1],)


class LeverAdaptive(Adaptive, Lever):
    """A product whose factor is an input."""

    estimated = ("k",)


class Counter(ControllerSlave):
    """A number and its double."""

    table = (
        parameter("n", None, 3, "Number", type="Integer", min=0),
        output("twice", None, "2 n", depends=("n",), type="Integer"),
        output("y", None, "n", depends=("n",)),
    )

    def outputs(self, inputs, parameters):
        """2 n and n."""
        return (2 * parameters[0], float(parameters[0]))


def reference_of(model, name):
    return [v.name for v in model.variables].index(name)


def get(slave, *names):
    return slave.get_real([reference_of(slave, name) for name in names])


def put(slave, **values):
    slave.set_real([reference_of(slave, name) for name in values], list(values.values()))


def discarded(slave, *step):
    """What is logged of a step that is discarded."""
    assert slave.do_step(*step) is False
    message = slave._get_log_queue()[-1]
    assert message.status == Fmi2Status.error
    return message.msg


def initialized(model, start_time=0.0, **values):
    slave = model(instance_name="one")
    slave.setup_experiment(start_time)
    put(slave, **values)
    slave.exit_initialization_mode()
    return slave


@pytest.mark.parametrize(
    ("unit", "exponents"),
    [
        ("1", {}),
        ("rad/s2", {"rad": 1, "s": -2}),
        ("kg.m2", {"kg": 1, "m": 2}),
        ("N.m", {"kg": 1, "m": 2, "s": -2}),
        ("N.m.s/rad", {"kg": 1, "m": 2, "s": -1, "rad": -1}),
        ("N.s2/m", {"kg": 1}),
        ("1/s", {"s": -1}),
        ("N.m2/A2", {"kg": 1, "m": 3, "s": -2, "A": -2}),
        ("K/s", {"s": -1, "K": 1}),
        ("mol/m3", {"m": -3, "mol": 1}),
        ("V.A", {"kg": 1, "m": 2, "s": -3}),
        ("V/Ohm", {"A": 1}),
        ("W.s/J", {}),
        ("Pa.m2/N", {}),
        ("F.V/C", {}),
        ("H.A/Wb", {}),
        ("T.m2/Wb", {}),
        ("Wb/s", {"kg": 1, "m": 2, "s": -3, "A": -1}),
        ("cd/m2", {"m": -2, "cd": 1}),
    ],
)
def test_a_unit_is_the_product_of_its_base_units(unit, exponents):
    assert base_unit(unit) == exponents


@pytest.mark.parametrize("unit", ["furlong", "kg*m", "m^2", "", "m//s", "km", "degC"])
def test_an_unknown_unit_is_refused(unit):
    with pytest.raises(ValueError, match="must be made of"):
        base_unit(unit)


@pytest.mark.parametrize(("unit", "rate"), [("m", "m/s"), ("rad/s", "rad/s2"), ("m/s2", "m/s3"), ("1", "1/s")])
def test_a_time_derivative_has_one_more_second_below(unit, rate):
    assert per_second(unit) == rate


@pytest.mark.parametrize("bounds", [{"min": 2.0}, {"max": 0.5}, {"min": math.nan}], ids=str)
def test_a_start_outside_its_bounds_is_refused(bounds):
    with pytest.raises(ValueError, match="min <= start <= max"):
        parameter("a", "m", 1.0, "text", **bounds)


def test_without_units_there_is_no_table_of_them():
    """The schema demands one unit at least where there is a table."""
    root = Element("fmiModelDescription")
    define_units(root, ())
    assert len(root) == 0
    define_units(root, ("m",))
    assert [unit.get("name") for unit in root.iterfind("UnitDefinitions/Unit")] == ["m"]


def test_the_description_says_what_the_table_says():
    xml = Tank(instance_name="one").to_xml()
    variables = {v.get("name"): v for v in xml.iter("ScalarVariable")}
    assert list(variables) == ["area", "tau_u", "max_step", "q", "h", "der(h)", "q_held"]
    assert variables["area"][0].attrib == {"unit": "m2", "min": "0.1", "start": "2.0"}
    assert variables["h"][0].attrib == {"unit": "m", "nominal": "3.0", "start": "0.25"}
    assert variables["der(h)"][0].attrib == {"unit": "m/s", "derivative": "5"}
    assert variables["q_held"].attrib["initial"] == "calculated"
    assert xml.find("UnitDefinitions/Unit[@name='m3/s']/BaseUnit").attrib == {"m": "3", "s": "-1"}
    structure = {tag: [u.attrib for u in xml.find(f"ModelStructure/{tag}")] for tag in ("Outputs", "InitialUnknowns")}
    assert [(u["dependencies"], u["dependenciesKind"]) for u in structure["Outputs"]] == [
        ("5", "constant"),
        *[("", "")] * 2,
    ]
    assert [(u["index"], u["dependencies"]) for u in structure["InitialUnknowns"]] == [("6", "1 4"), ("7", "4")]


def test_start_values_keep_every_bit():
    class Third(ReferenceSlave):
        """A third."""

        table = (parameter("a", "1", 1.0 / 3.0, "A third"),)

    real, time = Third(instance_name="one").to_xml().iter("Real")
    assert time.attrib == {"unit": "s"}
    assert float(real.get("start")) == 1.0 / 3.0


def test_outputs_are_computed_once_after_a_set():
    slave = initialized(Product)
    slave.n_calls = 0
    put(slave, e=5.0)
    assert (get(slave, "y"), get(slave, "z"), get(slave, "y", "z")) == ([15.0], [5.0], [15.0, 5.0])
    assert slave.n_calls == 1
    assert slave.do_step(0.0, 0.1) is True
    assert slave.n_calls == 1


def test_a_memoryless_output_follows_its_inputs_with_and_without_a_step():
    slave = initialized(Product, e=1.0)
    assert get(slave, "y") == [3.0]
    put(slave, e=2.0)
    slave.do_step(0.0, 0.1)
    assert get(slave, "y") == [6.0]
    put(slave, k=10.0)
    assert get(slave, "y") == [20.0]


def test_a_plant_holds_its_input_over_the_step():
    slave = Tank(instance_name="one")
    put(slave, q=4.0, max_step=1.0)
    assert get(slave, "q_held", "der(h)") == [4.0, 2.0]
    slave.exit_initialization_mode()
    put(slave, q=6.0)
    assert get(slave, "h", "q_held", "der(h)") == [0.25, 4.0, 2.0]
    slave.do_step(0.0, 0.5)
    assert get(slave, "h", "q_held", "der(h)") == [1.75, 6.0, 3.0]
    put(slave, q=-8.0)
    assert get(slave, "h", "q_held", "der(h)") == [1.75, 6.0, 3.0]
    put(slave, area=1.0)
    assert get(slave, "q_held", "der(h)") == [6.0, 6.0]


@pytest.mark.parametrize(("max_step", "n_steps"), [(0.005, 2), (0.01, 1), (1.0, 1), (0.003, 4)])
def test_max_step_sets_the_number_of_integration_steps(max_step, n_steps):
    slave = initialized(Tank, max_step=max_step)
    Tank.n_calls = 0
    slave.do_step(0.0, 0.01)
    assert Tank.n_calls == 4 * n_steps


def test_a_reference_is_valid_from_the_start_time_on():
    slave = Clock(instance_name="one")
    slave.setup_experiment(7.0, None, None)
    assert get(slave, "t") == [7.0]
    slave.exit_initialization_mode()
    slave.do_step(7.0, 0.5)
    assert get(slave, "t") == [7.5]


def test_a_boolean_is_set_and_read_as_boolean_only():
    slave = Clock(instance_name="one")
    slave.setup_experiment(2.0)
    slave.set_boolean([0], [True])
    assert slave.get_boolean([0]) == [True]
    assert get(slave, "t") == [-2.0]
    with pytest.raises(ValueError, match="must not be read as Real"):
        slave.get_real([0])
    with pytest.raises(ValueError, match="must not be read as Boolean"):
        slave.get_boolean([1])
    with pytest.raises(ValueError, match="is_backward must not be set as Real"):
        slave.set_real([0], [1.0])
    slave.exit_initialization_mode()
    with pytest.raises(ValueError, match="after initialisation"):
        slave.set_boolean([0], [False])


@pytest.mark.parametrize("name", ["h", "max_step", "der(h)", "q_held"])
def test_what_is_not_an_input_or_tunable_is_refused_after_initialisation(name):
    slave = initialized(Tank)
    with pytest.raises(ValueError, match="must not be set as Real after initialisation"):
        put(slave, **{name: 0.1})


def test_a_calculated_output_is_never_set():
    with pytest.raises(ValueError, match="must not be set as Real before the end of initialisation"):
        put(Product(instance_name="one"), y=0.1)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf], ids=str)
@pytest.mark.parametrize("name", ["q", "area"])
def test_a_value_that_is_not_finite_is_named(name, value):
    slave = initialized(Tank)
    put(slave, **{name: value})
    assert discarded(slave, 0.0, 0.01).endswith(f"Tank: {name} must be finite, got {value}.\n")


def test_finite_values_whose_sum_overflows_are_accepted():
    slave = initialized(Product, e=1.7e308, k=1.7e308)
    slave.do_step(0.0, 0.1)
    assert get(slave, "z") == [1.7e308]


@pytest.mark.parametrize("step_size", [0.0, -0.01, math.nan], ids=str)
def test_a_step_must_be_positive(step_size):
    assert "step_size must be positive" in discarded(initialized(Tank), 0.0, step_size)


@pytest.mark.parametrize("time", [0.0, 0.02, -0.01, math.nan], ids=str)
def test_a_step_must_begin_where_the_last_one_ended(time):
    slave = initialized(Tank)
    assert slave.do_step(0.0, 0.01)
    before = get(slave, "h")
    assert f"must begin where the last ended, 0.01 s, not {time} s" in discarded(slave, time, 0.01)
    assert get(slave, "h") == before
    assert slave.do_step(0.01 + 1e-9, 0.01)  # a sum of steps is never exact


def test_a_first_step_begins_anywhere_without_a_start_time():
    slave = Tank(instance_name="one")  # as pythonfmu3 makes it
    slave.exit_initialization_mode()
    assert slave.do_step(7.0, 0.01)
    assert slave.do_step(7.01, 0.01)


@pytest.mark.parametrize(("name", "value"), [("area", 0.05), ("tau_u", -1.0)])
def test_a_step_with_a_value_outside_its_bounds_is_discarded(name, value):
    slave = initialized(Tank)
    before = get(slave, "h", "q_held")
    put(slave, **{name: value})
    assert f"Tank: {name} must be in [" in discarded(slave, 0.0, 0.01)
    put(slave, area=2.0, tau_u=0.0)
    assert get(slave, "h", "q_held") == before
    assert slave.do_step(0.0, 0.01)


@pytest.mark.parametrize("reference", [-1, 99])
def test_a_reference_that_no_variable_has_is_refused(reference):
    slave = initialized(Tank)
    for kind in ("real", "integer", "boolean", "string"):
        with pytest.raises(ValueError, match=f"Tank: value reference {reference}, which no variable has, must not be"):
            getattr(slave, f"get_{kind}")([0, reference] if kind == "real" else [reference])
        with pytest.raises(ValueError, match=f"Tank: value reference {reference} must not be set as"):
            getattr(slave, f"set_{kind}")([reference], [1])


def test_a_string_is_refused():
    slave = Tank(instance_name="one")
    with pytest.raises(ValueError, match="area, of type Real, must not be read as String"):
        slave.get_string([0])
    with pytest.raises(ValueError, match="area must not be set as String"):
        slave.set_string([0], ["wide"])


def test_an_error_is_logged_with_its_traceback_and_escaped_per_cent_signs():
    slave = initialized(Product)
    put(slave, e=-1.0)
    assert slave.do_step(0.0, 0.1) is False
    (message,) = slave._get_log_queue()
    assert message.status == Fmi2Status.error
    assert message.category == "logStatusError"
    assert "Traceback" in message.msg
    assert "in outputs" in message.msg
    assert "100 %% wrong: %%s %%n" in message.msg


def test_a_state_restores_the_values_and_the_mode():
    slave = initialized(Tank, q=4.0)
    slave.do_step(0.0, 0.01)
    saved = slave._get_fmu_state()
    outputs = get(slave, "h", "q_held", "der(h)")
    put(slave, q=5.0, area=3.0)
    slave.do_step(0.01, 0.01)
    other = Tank(instance_name="other")
    for restored in (slave, other):
        restored._set_fmu_state(Tank._fmu_state_from_bytes(Tank._fmu_state_to_bytes(saved)))
        assert get(restored, "h", "q_held", "der(h)", "q", "area") == [*outputs, 4.0, 2.0]
        with pytest.raises(ValueError, match="after initialisation"):
            put(restored, h=1.0)


def test_a_state_of_another_model_is_refused():
    with pytest.raises(ValueError, match="must be one of its own, got one of Product"):
        Tank(instance_name="one")._set_fmu_state(Product(instance_name="two")._get_fmu_state())


def adaptive():
    slave = LeverAdaptive(instance_name="one")
    slave.setup_experiment(0.0)
    put(slave, e=2.0, k=3.0)
    slave.exit_initialization_mode()
    return slave


def set_ready(slave, is_ready):
    slave.set_boolean([reference_of(slave, "update_ready")], [is_ready])


def test_an_adaptive_controller_s_parameters_are_inputs_that_no_output_depends_on_directly():
    xml = LeverAdaptive(instance_name="one").to_xml()
    variables = {v.get("name"): v for v in xml.iter("ScalarVariable")}
    assert [n for n, v in variables.items() if v.get("causality") == "input"] == ["e", "k", "update_ready"]
    assert [n for n, v in variables.items() if v.get("causality") == "parameter"] == ["offset"]
    assert variables["k"][0].attrib == {"unit": "1", "min": "0.5", "start": "1.0"}
    assert (variables["update_ready"].get("variability"), variables["update_ready"][0].tag) == ("discrete", "Boolean")
    index = {n: str(i) for i, n in enumerate(variables, 1)}
    depends = {
        tag: {u.get("index"): u.get("dependencies") for u in xml.find(f"ModelStructure/{tag}")}
        for tag in ("Outputs", "InitialUnknowns")
    }
    assert depends["Outputs"] == {index["y"]: index["e"], index["k_held"]: ""}
    every = " ".join(sorted(index[n] for n in ("e", "k", "offset")))
    assert depends["InitialUnknowns"] == {index["y"]: every, index["k_held"]: index["k"]}


def test_an_adaptive_controller_starts_with_its_initial_inputs_and_keeps_them_until_an_update():
    slave = adaptive()
    assert get(slave, "y", "k_held") == [6.5, 3.0]
    put(slave, k=4.0)
    slave.do_step(0.0, 0.1)
    assert get(slave, "y", "k_held") == [6.5, 3.0]
    set_ready(slave, True)
    assert get(slave, "y", "k_held") == [6.5, 3.0]  # a set alone is no step
    slave.do_step(0.1, 0.1)
    assert get(slave, "y", "k_held") == [8.5, 4.0]
    set_ready(slave, False)
    put(slave, k=5.0, e=1.0)
    slave.do_step(0.2, 0.1)
    assert get(slave, "y", "k_held") == [4.5, 4.0]


def test_an_adaptive_controller_s_inputs_must_be_within_bounds_where_they_are_used():
    slave = adaptive()
    put(slave, k=0.0)  # less than its min
    assert slave.do_step(0.0, 0.1)
    assert get(slave, "k_held") == [3.0]
    set_ready(slave, True)
    assert "LeverAdaptive: k must be in [0.5, inf], got 0." in discarded(slave, 0.1, 0.1)
    assert get(slave, "k_held") == [3.0]
    put(slave, k=4.0)
    assert slave.do_step(0.1, 0.1)
    assert get(slave, "k_held") == [4.0]


def test_the_state_of_an_adaptive_controller_has_what_it_keeps():
    slave = adaptive()
    set_ready(slave, True)
    put(slave, k=4.0)
    slave.do_step(0.0, 0.1)
    saved = slave._get_fmu_state()
    set_ready(slave, False)
    put(slave, k=9.0)
    other = adaptive()
    for restored in (slave, other):
        restored._set_fmu_state(saved)
        assert get(restored, "y", "k_held") == [8.5, 4.0]
        assert restored.get_boolean([reference_of(restored, "update_ready")]) == [True]


def test_integers_are_set_and_read_as_integers_only():
    slave = Counter(instance_name="one")
    assert slave.get_integer([0]) == [3]
    slave.set_integer([0], [2**31 - 1])
    assert slave.get_integer([0, 1]) == [2**31 - 1, 2**32 - 2]
    with pytest.raises(ValueError, match="twice, of type Integer, must not be read as Real"):
        slave.get_real([1])
    with pytest.raises(ValueError, match="y, of type Real, must not be read as Integer"):
        slave.get_integer([2])
    with pytest.raises(ValueError, match="n must not be set as Real"):
        slave.set_real([0], [1.0])
    with pytest.raises(ValueError, match="n must not be set as Boolean"):
        slave.set_boolean([0], [True])
    xml = slave.to_xml()
    n, twice, y = xml.iter("ScalarVariable")
    assert (n[0].tag, n[0].attrib) == ("Integer", {"min": "0", "start": "3"})
    assert (twice[0].tag, twice[0].attrib, twice.get("variability")) == ("Integer", {}, "discrete")
    assert (y[0].tag, y[0].attrib) == ("Real", {})  # its unit is unknown


def test_a_start_must_be_of_its_type():
    with pytest.raises(ValueError, match=r"'a' must start as its type, Boolean, got 1\.0"):
        VariableRow(
            name="a", unit=None, description="", causality="parameter", variability="fixed", initial="exact",
            type="Boolean", start=1.0,
        )  # fmt: skip


def test_only_the_standard_library_and_pythonfmu_are_imported():
    root = Path(__file__).parents[2]
    code = """
import json, sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
import pythonfmu, pythonfmu3
before = set(sys.modules)
for path in sorted(Path(sys.argv[1], "fmu_models").rglob("*.py")):
    __import__(".".join(path.relative_to(sys.argv[1]).with_suffix("").parts))
print(json.dumps(sorted({name.split(".")[0] for name in set(sys.modules) - before} - sys.stdlib_module_names)))
"""
    done = subprocess.run([sys.executable, "-P", "-c", code, str(root)], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == ["fmu_models"]
