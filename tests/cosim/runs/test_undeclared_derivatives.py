"""A plant that declares neither states nor derivatives, as pythonfmu's do not: the scenario names both."""

import re
import zipfile

import pytest
from pythonfmu import FmuBuilder

from cosim import CosimError, Scenario, run
from cosim.authoring.check import check

SAMPLED = '"plant.der(mass.v)" = { noise = 1e-3 }'
OF = '"plant.der(mass.v)" = { noise = 1e-3, of = "plant.mass.v" }'
STATES = '[sampling.states]\n"plant.mass.v" = {}\n"plant.mass.s" = {}\n'  # the order of the model's x
LIMITS = {"scenario.stop_time": "0.6", "estimation.budget": "20"}


@pytest.fixture
def undeclared(foreign, axis):
    """undeclared(sampled, states): the scenario, with a plant that says of no output that it is a derivative."""
    with zipfile.ZipFile(foreign / "Axis.fmu") as whole:
        files = {name: whole.read(name) for name in whole.namelist()}
    xml, n = re.subn(rb' derivative="\d+"', b"", files["modelDescription.xml"])
    assert n == 2
    files["modelDescription.xml"] = re.sub(b"<Derivatives>.*</Derivatives>", b"", xml, flags=re.S)

    def write(sampled=OF, states=STATES):
        path = axis(
            ('plant = { fmu = "Axis.fmu" }', 'plant = { fmu = "Plain.fmu" }'), (SAMPLED, f"{sampled}\n{states}")
        )
        with zipfile.ZipFile(path.with_name("Plain.fmu"), "w") as fmu:
            for name, content in files.items():
                fmu.writestr(name, content)
        return path

    return write


@pytest.mark.full
def test_it_runs_bit_for_bit_as_the_one_that_declares_them(undeclared, axis):
    path = undeclared()
    assert [f for f in check(path) if f.is_error] == []
    plain, declared = (run(Scenario.load(p, LIMITS)) for p in (path, axis()))
    assert plain.error is None
    assert list(plain.series) == list(declared.series)
    for name, values in declared.series.items():
        assert plain.series[name].tobytes() == values.tobytes(), name
    assert plain.n_evaluations == declared.n_evaluations > 0


MASS = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class Mass(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.f, self.m, self.v, self.s, self.a = 0.0, 2.0, 0.0, 0.0, 0.0
        self.register_variable(Real("f", causality=Fmi2Causality.input))
        self.register_variable(Real("m", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        for name in ("s", "v", "a"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))
    def do_step(self, t, h):
        for _ in range(20):
            self.a = (self.f - 8.0 * self.s - self.v) / self.m
            self.v += self.a * h / 20
            self.s += self.v * h / 20
        self.a = (self.f - 8.0 * self.s - self.v) / self.m
        return True
"""


@pytest.mark.full
@pytest.mark.fmu
def test_a_plant_by_pythonfmu_whose_acceleration_is_measured(axis):
    path = axis(
        ('plant = { fmu = "Axis.fmu" }', 'plant = { fmu = "Mass.fmu" }'),
        (SAMPLED, '"plant.a" = { noise = 1e-3, of = "plant.v" }\n[sampling.states]\n"plant.v" = {}\n"plant.s" = {}\n'),
    )
    text = path.read_text().replace("plant.mass.", "plant.")
    path.write_text(text)
    (path.parent / "mass.py").write_text(MASS)
    FmuBuilder.build_FMU(path.parent / "mass.py", dest=path.parent)
    result = run(Scenario.load(path))
    assert result.error is None
    assert result.series["controller.m"][-1] == pytest.approx(3.0, abs=0.05)  # the mass that it has from 0.3 s on


@pytest.mark.parametrize(
    ("sampled", "states", "message"),
    [
        (SAMPLED, STATES, "is not declared as a state's derivative; say of which"),
        (OF, "", "name the states in sampling.states"),
        (OF.replace('of = "plant.mass.v"', 'of = "plant.mass.w"'), STATES, "did you mean 'mass.v'"),
        (OF.replace("der(mass.v)", "mass.a"), STATES, "mass.a"),
        (OF.replace("noise = 1e-3, ", ""), STATES, "must have noise > 0, or sampling.filter"),
        (OF.replace('of = "plant', 'of = "controller'), STATES, "must be of one component"),
    ],
    ids=["not said of which", "no states", "no such state", "no output", "no noise", "of another FMU"],
)  # fmt: skip
def test_what_does_not_fit_is_told_by_check_and_run(undeclared, sampled, states, message):
    path = undeclared(sampled, states)
    assert any(message in str(f) for f in check(path) if f.is_error), check(path)
    with pytest.raises(CosimError, match=re.escape(message)):
        run(Scenario.load(path, LIMITS), "none")


def test_what_the_fmu_declares_otherwise_is_refused(axis):
    path = axis((SAMPLED, OF.replace('mass.v" }', 'mass.s" }')))
    with pytest.raises(CosimError, match=r"is declared as the derivative of 'mass\.v', not of 'mass\.s'"):
        run(Scenario.load(path, LIMITS), "none")
