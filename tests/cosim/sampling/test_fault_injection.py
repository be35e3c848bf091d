"""Injected noise against the moments of the process that it is said to be."""

import numpy as np
import pytest
from pydantic import ValidationError

from cosim.sampling.fault_injection import FaultInjection
from cosim.scenarios.schema.sampling import SensorFault
from estimator import Sample

SENSORS = ("plant.a", "plant.v", "plant.y")


def values(n, seed=0, **settings):
    """What a sensor tells (n,) whose true value is 5."""
    fault = SensorFault.model_validate({"kind": "noise", "sensor": "plant.v", **settings})
    inject = FaultInjection([fault], SENSORS, np.random.default_rng(seed))
    samples = [inject(Sample(0.01 * k, x=(5.0,), u=(), xdot=(1.0,), y=(2.0,))) for k in range(n)]
    assert all((sample.xdot, sample.y) == ((1.0,), (2.0,)) for sample in samples)  # of other sensors
    return np.array([sample.x[0] for sample in samples])


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.95])
def test_noise_has_the_moments_of_a_first_order_process(correlation):
    """Variance size^2, and correlation^k over k samples: Box and Jenkins (1970); from the first sample on."""
    errors = values(40_000, size=0.3, correlation=correlation) - 5.0
    n_independent = len(errors) * (1.0 - correlation) / (1.0 + correlation)
    assert errors.var() == pytest.approx(0.09, rel=4.0 * np.sqrt(2.0 / n_independent))
    for k in (1, 5):
        found = np.corrcoef(errors[:-k], errors[k:])[0, 1]
        assert found == pytest.approx(correlation**k, abs=4.0 / np.sqrt(n_independent))
    first = np.array([values(1, seed, size=0.3, correlation=correlation)[0] for seed in range(800)])
    assert first.std() == pytest.approx(0.3, rel=4.0 / np.sqrt(2.0 * 800))


def test_noise_that_has_ended_begins_anew():
    told = values(20, size=1.0, correlation=0.99, stop=0.1)
    assert np.all(told[:10] != 5.0)
    assert np.all(told[10:] == 5.0)


def test_only_noise_has_a_correlation():
    with pytest.raises(ValidationError, match="bias has no 'correlation'"):
        SensorFault.model_validate({"kind": "bias", "size": 1.0, "correlation": 0.5})
