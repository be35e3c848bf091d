"""The noise of the samples."""

import numpy as np
import pytest

from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario


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
