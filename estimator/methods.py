"""The estimators by name."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from .contract import Estimator
from .paper import PaperBO, PaperSettings
from .space import ParameterSpace, Vector
from .target import TargetSettings, TargetVector


@dataclass(frozen=True)
class Method:
    """An estimator and its settings."""

    estimator: type[Any]
    """Class, called with (space, start, rng, settings)."""
    settings: type[Any]
    """Frozen dataclass of its settings."""

    @property
    def setting_names(self) -> tuple[str, ...]:
        """What a scenario may set."""
        return tuple(f.name for f in fields(self.settings))


METHODS: dict[str, Method] = {
    "target": Method(TargetVector, TargetSettings),
    "paper": Method(PaperBO, PaperSettings),
}


def make_estimator(
    name: str, space: ParameterSpace, start: Vector, rng: np.random.Generator, settings: Mapping[str, Any]
) -> Estimator:
    """The estimator of that name. Raises KeyError for an unknown name, TypeError for an unknown setting."""
    method = METHODS[name]
    return method.estimator(space, start, rng, method.settings(**settings))
