"""A plant y = x . theta measured with SIGMA, whose information has a closed form, and a controller behind a guard."""

import numpy as np

from cosim.retuning.data_support import DataSupport
from cosim.retuning.decision import Point
from estimator import Parameter, ParameterSpace, Sample

SPACE = ParameterSpace((Parameter("a", 0.0, 10.0), Parameter("b", 0.0, 10.0)))
START, GOOD, BETTER = (np.array([v, v]) for v in (2.0, 4.0, 6.0))
SIGMA = 0.1


def linear_rows(theta, samples):
    """The whitened residuals (..., n, 1) of candidates (..., d) at n samples."""
    return np.stack([(sample.xdot[0] - np.dot(theta, sample.x))[..., None] / SIGMA for sample in samples], axis=-2)


def seen(*rows, truth=GOOD):
    """The support of samples with these regressors."""
    support = DataSupport(linear_rows, SPACE, 1, 30)
    for k, row in enumerate(rows):
        support.append(Sample(float(k), tuple(row), (), (float(np.dot(row, truth)),)))
    return support


class Watched:
    """A guard, and a controller that takes what it lets through."""

    def __init__(self, guard, held):
        self.guard, self.held = guard, held

    def step(self, k, t, error, proposal, peak, reference=()):
        ruling = self.guard.step(Point(k, t, None, error, reference=reference), proposal, self.held, peak)
        self.held = self.held if ruling.write is None else ruling.write
        return ruling

    def __getattr__(self, name):
        return getattr(self.guard, name)
