"""The tuning rule of a scenario: what its controllers hold, as a function of the estimated parameters.

It imports no more than an estimator FMU ships.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .formula import compile_expression, identifier


@dataclass(frozen=True)
class _Law:
    """Values of some of the controllers' parameters."""

    names: tuple[str, ...]
    """The parameters."""
    text: str
    """Formula, or `module:function`."""
    function: Callable[..., Any]
    """Called with the estimated parameters, by name, for a number or as many as there are names."""

    def values(self, estimated: Mapping[str, float]) -> list[float]:
        """Return the values. Raises ValueError where there are none."""
        try:
            values: list[float] = np.ravel(np.asarray(self.function(**estimated), dtype=float)).tolist()
        except (Exception, SystemExit) as e:
            raise ValueError(f"'{self.text}' has no value at {_at(estimated)}: {type(e).__name__}: {e}") from e
        if len(values) != len(self.names):
            raise ValueError(f"'{self.text}' gives {len(values)} values for {', '.join(self.names)}")
        for name, value in zip(self.names, values):
            if not isfinite(value):
                raise ValueError(f"{name} = {self.text} is {value} at {_at(estimated)}")
        return values


class TuningRule:
    """The controllers' parameters as functions of the estimated ones: called with theta (d,), it returns their values.

    It raises ValueError where there are none.
    """

    def __init__(
        self, estimated: Sequence[str], formulas: Mapping[str, str], load: Callable[[str], Callable[..., Any]]
    ) -> None:
        """estimated: names of the estimated parameters, which formulas and functions have as identifiers; formulas: by
        parameter of a controller, an estimate's name, a formula, or `module:function`, which load returns.

        Raises ValueError for what is no formula.
        """
        self.names = tuple(formulas)
        """The controllers' parameters, `component.variable`."""
        self._estimated = tuple(map(identifier, estimated))
        place = {name: i for i, name in enumerate(estimated)}
        self._places = [place.get(text) for text in formulas.values()]
        """Places in theta of those that are written as they are."""
        functions: dict[str, list[str]] = {}
        for name, text in formulas.items():
            if text not in place:
                functions.setdefault(text if ":" in text else f"{text}\n{name}", []).append(name)
        self._laws = [_law(key.partition("\n")[0], names, self._estimated, load) for key, names in functions.items()]

    @property
    def is_plain(self) -> bool:
        """True where every parameter is written as it is."""
        return not self._laws

    def __call__(self, theta: ArrayLike) -> list[float]:
        values: list[float] = np.asarray(theta, dtype=float).tolist()
        if not self._laws:
            return [values[i] for i in self._places if i is not None]
        estimated = dict(zip(self._estimated, values, strict=True))
        found = {name: v for law in self._laws for name, v in zip(law.names, law.values(estimated))}
        return [found[n] if i is None else values[i] for n, i in zip(self.names, self._places, strict=True)]


def _law(text: str, names: Sequence[str], estimated: Sequence[str], load: Callable[[str], Callable[..., Any]]) -> _Law:
    if ":" in text:
        return _Law(tuple(names), text, load(text))
    formula = compile_expression(text, estimated)
    return _Law(tuple(names), text, lambda **values: formula(values))


def _at(estimated: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:.6g}" for name, value in estimated.items())
