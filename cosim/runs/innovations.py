"""Evidence against the parameters held: how far each recorded sample is from what they explain."""

from contextlib import suppress
from typing import Final

import numpy as np

from estimator import DerivativeResidual, chi2_limit
from estimator.significance import SAMPLE_FALSE_ALARM

from ..errors import CosimError
from ..objectives.choice import chosen
from ..objectives.model import opened_model
from ..sampling.derivative_filter import derivative_noise
from ..sampling.sampler import recorded_samples
from .result import Run, Series

_OURS: Final = "fmu_models."
"""Package of the models that may be called of anybody's run: they are not the run's."""
_MOST: Final = 20_000
"""Number of rows up to which the model is called for each."""


def innovations(run: Run) -> Series | None:
    """Return the normalised innovation squared (n,) of what the controller held before each sample.

    NaN where there is no sample. None without a model of derivatives, for a model of the user's own, which only a run
    may call, and for long records.
    """
    scenario = run.scenario
    is_ours = (scenario.estimation.model or "").startswith(_OURS)
    if not is_ours or chosen(scenario).kind != "derivative" or not 0 < len(run.time) <= _MOST:
        return None
    with suppress(CosimError, KeyError):  # a column that an older version did not record
        samples = recorded_samples(scenario, run.plant, run.series, range(len(run.time)))
        held = np.array([*run.estimates.values()]).T
        noise = derivative_noise(scenario.sampling, scenario.scenario.macro_step)
        found = np.full(len(run.time), np.nan)
        with opened_model(scenario, run.plant) as model, np.errstate(all="ignore"):
            residual = DerivativeResidual(model, scenario.estimation.space, run.plant.channels, noise)
            for k, sample in enumerate(samples):
                if k and sample is not None:
                    r = residual(held[k - 1], sample)
                    found[k] = float(r @ r)
        return found
    return None


def innovation_limit(run: Run) -> float:
    """Return the limit that noise alone exceeds in a millionth of the samples."""
    return chi2_limit(SAMPLE_FALSE_ALARM, len(run.plant.channels))
