"""The noise of the samples."""

import numpy as np
import pytest

from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario


@pytest.mark.fmu
def test_the_noise_of_a_state_that_is_an_output_is_no_fault_of_its_derivative():
    quiet = {"changes": '{ "plant.m" = 1.75, "plant.l" = 0.75 }', "components.reference.start.phi_initial": "0.9"}
    outputs = {
        "sampling.outputs": '{ "plant.phi_dot" = { noise = 0.02 } }',
        "scenario.stop_time": "1.0",
        "scenario.isolation": "none",
    }
    made = run(Scenario.load("pendulum", quiet | outputs), "target")
    assert made.summary()["observations"] == {"kept_out": 0, "found": {}, "failed": []}


@pytest.mark.fmu
def test_noise_is_the_declared_one_times_its_ratio():
    settings = {"scenario.stop_time": "0.1", "scenario.isolation": "none", "sampling.noise_ratio": "{}"}
    errors = []
    for ratio in ("1.0", "0.1", "0.0"):
        made = run(Scenario.load("pendulum", {k: v.format(ratio) for k, v in settings.items()}), "none")
        errors.append(made["sampled.plant.der(phi_dot)"] - made["plant.der(phi_dot)"])
    assert np.any(errors[0] != 0.0)
    assert errors[1] == pytest.approx(0.1 * errors[0], abs=1e-12)
    assert not errors[2].any()
