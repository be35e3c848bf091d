"""The estimator FMU between plant and controller, in importers that know nothing of us, and in SSP."""

import importlib.util
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest

from cosim import Scenario, run
from cosim.estimator_fmu.build import build_estimator
from fmu_models.build import build

HERE = Path(__file__).parent
pytestmark = [pytest.mark.full, pytest.mark.fmu]


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    """The scenario as FMUs and connections: what a user of another importer would draw."""

    def made(name: str, stop_time: float, seed: int = 0, **components) -> tuple[Scenario, dict]:
        scenario = Scenario.load(name, {"scenario.stop_time": repr(stop_time)})
        folder = tmp_path_factory.mktemp("fmus")
        model = scenario.components["plant"].fmu
        fmus = {
            "reference": build(scenario.components["reference"].fmu, folder),
            "plant": build(model, folder),
            "estimator": build_estimator(scenario, folder),
            "controller": build(f"{model}ControllerAdaptive", folder),
        }
        parameters = [p.name for p in scenario.estimation.parameters]
        outputs = {n: {v.name for v in variables(fmus[n]) if v.causality == "output"} for n in ("plant", "reference")}
        told = [v.name for v in variables(fmus["estimator"]) if v.causality == "input" and v.name != "tracking_error"]
        n_steps = scenario.scenario.n_steps
        return scenario, {
            "fmus": {n: str(path) for n, path in fmus.items()},
            "connections": {
                **scenario.connections,
                **{f"estimator.{n}": f"{'plant' if n in outputs['plant'] else 'reference'}.{n}" for n in told},
                **{f"controller.{n}": f"estimator.{n}" for n in (*parameters, "update_ready")},
            },
            "start": {n: dict(c.start) for n, c in scenario.components.items()} | {"estimator": {"seed": seed}},
            "set": {
                n: [f(scenario.scenario.time(k)) for k in range(n_steps)]
                for n, f in scenario.change_functions().items()
            },
            "n_steps": n_steps, "start_time": 0.0, "macro_step": scenario.scenario.macro_step,
            "recorded": [
                *scenario.tracking, *scenario.tracking.values(), *(f"controller.{n}_held" for n in parameters),
                "estimator.n_evaluations",
            ],
            "order": ["estimator", "controller", "plant", "reference"], "last": "plant", "added": {},
        }  # fmt: skip

    return made


def variables(path):
    return fmpy.read_model_description(str(path)).modelVariables


def rows_of(script: str, plan: dict, *arguments: str) -> dict[str, np.ndarray]:
    """What an importer's script recorded of the plan, by name. It finds nothing of ours but the FMUs."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | {"OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-P", str(HERE / script), *arguments], input=json.dumps(plan), capture_output=True, text=True,
        env=environment, cwd=Path(plan["fmus"]["plant"]).parent, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    rows = json.loads(done.stdout[done.stdout.index('{"rows"') :])["rows"]
    return dict(zip(plan["recorded"], np.array(rows, dtype=float).T, strict=True))


def noise_of(scenario: Scenario, n_states: int, seed: int) -> dict[str, list[float]]:
    """What `run` adds to the derivatives that it samples: the first of the two streams of its seed."""
    rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[0])
    derivatives = scenario.sampling.derivatives
    drawn = np.array([rng.standard_normal(len(derivatives) + n_states) for _ in range(scenario.scenario.n_steps)])
    return {name: (n.noise * drawn[:, i]).tolist() for i, (name, n) in enumerate(derivatives.items())}


def mean_square(scenario: Scenario, series) -> np.ndarray:
    n = scenario.scenario.n_steps
    return np.array([np.mean((series[a][:n] - series[b][:n]) ** 2) for a, b in scenario.tracking.items()])


@pytest.mark.parametrize(
    ("name", "stop_time", "n_states"), [("pendulum", 5.0, 2), ("quadrotor", 1.5, 18)], ids=["pendulum", "quadrotor"]
)
def test_a_plain_fmpy_script_re_tunes_bit_for_bit_as_our_master_does(plan, name, stop_time, n_states):
    """With the same exchange order, seed and noise; all four FMUs are in one process there, each in its own here."""
    scenario, wired = plan(name, stop_time, seed=3)
    seen = rows_of("fmpy_master.py", wired | {"added": noise_of(scenario, n_states, seed=3)})
    alone = {"guard": {"enabled": False}, "observations": {"enabled": False}}  # the FMU has neither
    ours = run(Scenario.model_validate(scenario.model_dump() | alone), seed=3)
    n = scenario.scenario.n_steps
    for p in scenario.estimation.parameters:
        assert seen[f"controller.{p.name}_held"].tolist() == ours.series[p.writes][:n].tolist()
    for tracked in scenario.tracking:
        assert seen[tracked].tolist() == ours.series[tracked][:n].tolist()
    assert len(np.unique(seen[f"controller.{scenario.estimation.parameters[0].name}_held"])) > 3


def test_without_noise_it_finds_the_true_parameters(plan):
    """And the pendulum is held as well as in our own run that predicts as little, and far better than nominal."""
    scenario, wired = plan("pendulum", 5.0)
    seen = rows_of("fmpy_master.py", wired)
    assert seen["controller.m_held"][-1] == pytest.approx(4.271, abs=2e-3)
    assert seen["controller.l_held"][-1] == pytest.approx(0.981, abs=5e-4)
    tracked, nominal = mean_square(scenario, seen), mean_square(scenario, run(scenario, "none").series)
    alone = Scenario.load("pendulum", {"scenario.stop_time": "5.0", "guard.enabled": "false"})
    assert tracked < 2.0 * mean_square(scenario, run(alone).series)
    assert tracked < nominal / 100.0


def as_components(scenario: Scenario, wired: dict) -> Scenario:
    """The four FMUs as a scenario of ours, where all step at once and nothing of ours estimates.

    libcosim passes on initial outputs before the first step; here the controller's inputs start as they are then.
    """
    tree, phi = scenario.model_dump(), scenario.components["plant"].start["phi"]
    tree["scenario"] |= {"coupling": "parallel", "timeout": 60.0}  # the estimator loads GPy
    tree["components"] = {
        n: {"fmu": path, "start": dict(wired["start"].get(n, {}))} for n, path in wired["fmus"].items()
    }
    tree["components"]["controller"]["start"] = {"phi": phi, "phi_ref": phi}
    tree["connections"] = wired["connections"]
    other = {"name": "b", "lower": 0.0, "upper": 1.0, "unit": "kg/s", "writes": "controller.b"}
    tree["estimation"] |= {"parameters": [other], "linear": None}
    return Scenario.model_validate(tree)


def test_libcosim_joins_the_four_fmus_by_connections_alone_and_re_tunes(plan, tmp_path):
    """An OspSystemStructure; libcosim's order is our master's `parallel`, and it gives the same trajectory."""
    pytest.importorskip("libcosimpy")
    scenario, wired = plan("pendulum", 5.0)
    seen = rows_of("libcosim_master.py", wired, str(tmp_path))
    ours = run(as_components(scenario, wired), "none")
    assert ours.status == "done", ours.error
    n = scenario.scenario.n_steps
    np.testing.assert_allclose(seen["plant.phi"], ours["plant.phi"][1 : n + 1], rtol=0.0, atol=1e-9)
    for name in ("controller.m_held", "controller.l_held"):  # a search ends elsewhere for a rounding of what it is told
        np.testing.assert_allclose(seen[name], ours[name][1 : n + 1], rtol=0.0, atol=1e-6, err_msg=name)
    assert seen["controller.m_held"][-1] == pytest.approx(4.271, abs=2e-3)
    assert seen["controller.l_held"][-1] == pytest.approx(0.981, abs=5e-4)


SSD = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription name="pendulum" version="1.0"
    xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
    xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
    xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues">
  <ssd:System name="system">
    <ssd:Elements>{components}</ssd:Elements>
    <ssd:Connections>{connections}</ssd:Connections>
  </ssd:System>
</ssd:SystemStructureDescription>"""
STARTS = """<ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues>
<ssv:ParameterSet version="1.0" name="starts"><ssv:Parameters>{values}</ssv:Parameters></ssv:ParameterSet>
</ssd:ParameterValues></ssd:ParameterBinding></ssd:ParameterBindings>"""


def write_ssp(file: Path, wired: dict, starts: dict[str, float]) -> None:
    """A System Structure and Parameterization 1.0 of the four FMUs and their connections."""

    def connector(reference: str, kind: str) -> str:
        name, _, variable = reference.partition(".")
        (its_type,) = (v.type for v in variables(wired["fmus"][name]) if v.name == variable)
        return f'<ssd:Connector name="{variable}" kind="{kind}"><ssc:{its_type}/></ssd:Connector>'

    def ends(start: str, end: str) -> str:
        both = {"start": start.partition("."), "end": end.partition(".")}
        return " ".join(f'{end}Element="{n}" {end}Connector="{v}"' for end, (n, _, v) in both.items())

    def bound(name: str) -> str:
        own = {n.partition(".")[2]: value for n, value in starts.items() if n.startswith(f"{name}.")}
        values = (f'<ssv:Parameter name="{n}"><ssv:Real value="{v!r}"/></ssv:Parameter>' for n, v in own.items())
        return STARTS.format(values="".join(values)) if own else ""

    held = ["controller.m_held", "controller.l_held"]
    used = [*((target, "input") for target in wired["connections"]), *((r, "output") for r in held)]
    used += [(source, "output") for source in dict.fromkeys(wired["connections"].values())]
    components = "".join(
        f'<ssd:Component name="{n}" type="application/x-fmu-sharedlibrary" source="resources/{Path(path).name}">'
        f"<ssd:Connectors>{''.join(connector(r, k) for r, k in used if r.startswith(f'{n}.'))}</ssd:Connectors>"
        f"{bound(n)}</ssd:Component>"
        for n, path in wired["fmus"].items()
    )
    connections = (f"<ssd:Connection {ends(source, target)}/>" for target, source in wired["connections"].items())
    with zipfile.ZipFile(file, "w") as package:
        text = SSD.format(components=components, connections="".join(connections))
        package.writestr("SystemStructure.ssd", text)
        for path in wired["fmus"].values():
            package.write(path, f"resources/{Path(path).name}")


@pytest.mark.parametrize("importer", ["fmpy", "libcosim"])
def test_in_an_ssp_package_it_tells_the_controller_what_the_plant_is(plan, tmp_path, importer):
    """The plant is another than the controller believes from the start."""
    if importer == "libcosim":
        pytest.importorskip("libcosimpy")
    _, wired = plan("pendulum", 5.0)
    starts = {"plant.m": 4.271, "plant.l": 0.981, "plant.phi": 0.8, "reference.step_time": 0.5}
    write_ssp(tmp_path / "pendulum.ssp", wired, starts)
    command = [sys.executable, "-P", str(HERE / "estimator_in_ssp.py"), importer, str(tmp_path / "pendulum.ssp")]
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [*command, json.dumps(starts)], capture_output=True, text=True, cwd=tmp_path, env=environment, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]
    m, l = json.loads(done.stdout.splitlines()[-1])
    assert (m, l) == (pytest.approx(4.271, abs=2e-3), pytest.approx(0.981, abs=5e-4))


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("libcosimpy") is None, reason="libcosimpy is not installed")
def test_libcosim_re_tunes_the_quadrotor(plan, tmp_path):
    """The whole flight; the nominal controller's mean square is 11 / 2.5 / 5.2 m2."""
    scenario, wired = plan("quadrotor", 16.0)
    seen = rows_of("libcosim_master.py", wired, str(tmp_path))
    assert np.all(mean_square(scenario, seen) < [0.02, 0.01, 0.01])
