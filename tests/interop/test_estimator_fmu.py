"""The estimator FMU between plant and controller, in importers that know nothing of us: FMPy, libcosim."""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import fmpy
import numpy as np
import pytest

from cosim import Scenario, run
from cosim.estimator_fmu import build_estimator
from fmu_models.build import build

HERE = Path(__file__).parent
pytestmark = pytest.mark.fmu


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FMU_RETUNE_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


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
    ours = run(scenario, seed=3)
    n = scenario.scenario.n_steps
    for p in scenario.estimation.parameters:
        assert seen[f"controller.{p.name}_held"].tolist() == ours.series[p.writes][:n].tolist()
    for tracked in scenario.tracking:
        assert seen[tracked].tolist() == ours.series[tracked][:n].tolist()
    assert len(np.unique(seen[f"controller.{scenario.estimation.parameters[0].name}_held"])) > 10


def test_without_noise_the_estimates_are_nearer_to_the_truth_than_the_noise_would_allow(plan):
    """A noise of 1e-3 rad/s2 leaves an error of 6e-5 kg in our own run; and 5 ms of RK4 is exact to 1e-9."""
    scenario, wired = plan("pendulum", 5.0)
    seen = rows_of("fmpy_master.py", wired)
    assert seen["controller.m_held"][-1] == pytest.approx(4.271, abs=2e-3)
    assert seen["controller.l_held"][-1] == pytest.approx(0.981, abs=5e-4)
    tracked, nominal = mean_square(scenario, seen), mean_square(scenario, run(scenario, "none").series)
    assert tracked < 2.0 * mean_square(scenario, run(scenario).series)
    assert tracked < nominal / 100.0


def as_components(scenario: Scenario, wired: dict) -> Scenario:
    """The four FMUs as a scenario of ours, where all step at once and nothing of ours estimates.

    libcosim passes on initial outputs before the first step; here the controller's inputs start as they are then.
    """
    tree, phi = scenario.model_dump(), scenario.components["plant"].start["phi"]
    tree["scenario"] |= {"coupling": "parallel"}
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
    ours = run(as_components(scenario, wired), "none").series
    n = scenario.scenario.n_steps
    for name in ("plant.phi", "controller.m_held", "controller.l_held"):
        np.testing.assert_allclose(seen[name], ours[name][1 : n + 1], rtol=0.0, atol=1e-9, err_msg=name)
    assert seen["controller.m_held"][-1] == pytest.approx(4.271, abs=2e-3)
    assert seen["controller.l_held"][-1] == pytest.approx(0.981, abs=5e-4)


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("libcosimpy") is None, reason="libcosimpy is not installed")
def test_libcosim_re_tunes_the_quadrotor(plan, tmp_path):
    """The whole flight; the nominal controller's mean square is 11 / 2.5 / 5.2 m2."""
    scenario, wired = plan("quadrotor", 16.0)
    seen = rows_of("libcosim_master.py", wired, str(tmp_path))
    assert np.all(mean_square(scenario, seen) < [0.02, 0.01, 0.01])
