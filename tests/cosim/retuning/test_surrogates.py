"""Whole runs track the same whether the Gaussian processes are computed in LAPACK or by GPy."""

import numpy as np
import pytest

from cosim import Scenario, run

pytestmark = pytest.mark.fmu

SHORT = {
    "pendulum": {
        "scenario.stop_time": "1.5",
        'changes."plant.m"': "[[0.0, 1.75], [0.1, 4.271]]",
        'changes."plant.l"': "[[0.0, 0.75], [0.1, 0.981]]",
    },
    "quadrotor": {"scenario.stop_time": "0.8", 'changes."plant.m"': "[[0.0, 1.5], [0.1, 2.2]]"},
}


@pytest.mark.full
@pytest.mark.parametrize("estimator", ["target", "bo-scalar"])
@pytest.mark.parametrize("name", SHORT)
def test_the_tracking_error_is_the_same_with_gpys_surrogate(name, estimator):
    errors = []
    for surrogate in ("auto", "gpy"):
        settings = SHORT[name] | {"scenario.isolation": "none", f"estimation.{estimator}.surrogate": f'"{surrogate}"'}
        done = run(Scenario.load(name, settings), estimator, 3)
        assert done.n_evaluations > 0
        errors.append(np.sqrt(done.mse))
    assert np.all(np.abs(errors[1] / errors[0] - 1.0) < 0.05)
