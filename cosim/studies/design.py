"""Points of a study: the values of its factors, crossed or paired, and the settings that they stand for."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import norm, qmc

from ..errors import ScenarioError
from .definition import StudyDefinition, StudySettings
from .factor import Factor, toml_text

Values = dict[str, Any]
"""Value of each factor, by name."""


class StudyPoint(NamedTuple):
    """A place in the space of the factors."""

    values: Values
    """Value of each factor."""
    settings: dict[str, str]
    """Settings of its runs, as for `--set`."""


def points(definition: StudyDefinition) -> Iterator[StudyPoint]:
    """Yield the points of a study in the order of its table. Raises ScenarioError where factors cannot be paired."""
    factors, study = definition.factors, definition.study
    drawn = {name: f for name, f in factors.items() if f.distribution}
    columns = {name: given_values(f) for name, f in factors.items() if not f.distribution}
    samples = drawn_points(drawn, study)
    combined = _paired(columns, samples) if study.combine == "paired" else _crossed(columns, samples)
    fixed = {key: toml_text(value) for key, value in study.settings.items()}
    for values in combined:
        settings = dict(fixed)
        for name, factor in factors.items():
            settings |= factor.settings_of(values[name])
        yield StudyPoint({name: values[name] for name in factors}, settings)


def given_values(factor: Factor) -> list[Any]:
    """Return the values of a factor that has no distribution."""
    if factor.values is not None:
        return list(factor.values)
    if factor.choices is not None:
        return list(factor.choices)
    if factor.grid is not None:
        return np.linspace(*factor.grid).tolist()
    assert factor.span is not None
    first, _, step = factor.span
    return [first + k * step for k in range(int(factor.n_given))]


def drawn_points(factors: Mapping[str, Factor], study: StudySettings) -> list[Values]:
    """Return the points of the factors that have a distribution, by quasi-random numbers or a Latin hypercube."""
    if not factors:
        return [{}]
    d, n = len(factors), study.samples
    match study.sampling:
        case "sobol":
            unit = qmc.Sobol(d, rng=study.sampling_seed).random(n)
        case "latin-hypercube":
            unit = qmc.LatinHypercube(d, rng=study.sampling_seed).random(n)
        case _:
            unit = np.random.default_rng(study.sampling_seed).random((n, d))
    columns = [_quantiles_of(f, u).tolist() for f, u in zip(factors.values(), unit.T, strict=True)]
    return [dict(zip(factors, row, strict=True)) for row in zip(*columns, strict=True)]


def _quantiles_of(factor: Factor, u: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the quantiles of a factor's distribution at u (n,) in [0, 1)."""
    if factor.uniform is not None:
        low, high = factor.uniform
        return low + u * (high - low)
    if factor.log_uniform is not None:
        low, high = np.log(factor.log_uniform)
        return np.exp(low + u * (high - low))
    mean, std = factor.normal or (0.0, 1.0)
    return mean + std * norm.ppf(np.clip(u, 1e-12, 1.0 - 1e-12))


def _crossed(columns: Mapping[str, Sequence[Any]], samples: Sequence[Values]) -> Iterator[Values]:
    for row in product(*columns.values()):
        for sample in samples:
            yield dict(zip(columns, row, strict=True)) | sample


def _paired(columns: Mapping[str, Sequence[Any]], samples: Sequence[Values]) -> Iterator[Values]:
    lengths = {name: len(values) for name, values in columns.items()}
    lengths |= dict.fromkeys(samples[0], len(samples))
    if len(set(lengths.values())) > 1:
        counts = ", ".join(f"{name} {n}" for name, n in lengths.items())
        raise ScenarioError(f"factors that are paired must have equally many values, got {counts}.")
    for k in range(next(iter(lengths.values()), 1)):
        yield {name: values[k] for name, values in columns.items()} | (samples[k] if samples[0] else {})
