"""Report, in words, of the parameters and directions that the data do not determine."""

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
import scipy  # its parts, 0.3 s, are loaded when they are used

from ..identifiability import IDENTIFIABLE_BELOW, Information
from ..space import Parameter, ParameterSpace, Vector

_PART: Final = 0.3
"""Component of a direction, as a share of its largest, above which a parameter counts as part of it."""
_SAME: Final = 1.1
"""Factor within which two exponents count as equal."""
_MOVE: Final = 0.01
"""Length of the reported move, of the scaled bounds, where neither product nor ratio describes the direction."""
_ALIKE: Final = 0.95
"""Correlation of two errors from which it is reported."""


def findings(
    information: Information, space: ParameterSpace, theta: Vector, identifiable_below: float = IDENTIFIABLE_BELOW
) -> list[str]:
    """Return a sentence for each parameter at a bound, and each direction of the unit cube not determined at theta.

    A direction is flat where its standard deviation exceeds identifiable_below, a share of the scaled bounds. On log
    scales its components are exponents: along it theta_j goes as lambda^(w_j V_ij), w_j the width of the log bounds,
    and what the data determine of two parameters is the product of powers that stays constant.
    """
    parameters = list(space)
    sentences = at_bounds(space, theta)
    groups = _together(_sparse(information.flat(identifiable_below)))
    sentences += [_flat(parameters, space, theta, group) for group in groups]
    named = {int(j) for group in groups for direction in group for j in _parts(direction)}
    for j, (p, std) in enumerate(zip(parameters, information.std(), strict=True)):
        if std > identifiable_below and j not in named:
            sentences.append(f"{p.name} is known to {_percent(std)} % of its scaled bounds only: excite it more.")
    return sentences if groups else [*sentences, *_alike(information, space)]


def _percent(share: float) -> str:
    """Return a share in percent with two digits, without an exponent where it is not small."""
    return f"{float(f'{100.0 * share:.2g}'):g}"


def bounds_met(space: ParameterSpace, theta: Vector) -> dict[str, str]:
    """Return "lower" or "upper" by the name of each parameter that is at that bound."""
    places = zip(space.names, space.to_unit(theta).tolist(), strict=True)
    return {name: "lower" if z < 0.5 else "upper" for name, z in places if not 1e-6 < z < 1.0 - 1e-6}


def at_bounds(space: ParameterSpace, theta: Vector) -> list[str]:
    """Return a sentence for each parameter at a bound."""
    met = bounds_met(space, theta)
    return [
        f"{p.name} is at its {met[p.name]} bound, {_with_unit(float(value), p.unit)}: widen it unless it is a physical "
        "limit, or doubt the model."
        for p, value in zip(space, theta, strict=True)
        if p.name in met
    ]


def _sparse(directions: Vector) -> list[Vector]:
    """Return another basis of the rows' span (m, d), each of few parameters: reduced row echelon, columns pivoted.

    Singular vectors of equal singular values are an arbitrary rotation of one another.
    """
    m = len(directions)
    if not m:
        return []
    factors: Any = scipy.linalg.qr(directions, pivoting=True, mode="economic")
    _, R, order = factors
    reduced = np.empty_like(directions)
    reduced[:, order] = np.hstack([np.eye(m), np.linalg.solve(R[:, :m], R[:, m:])])
    return list(reduced / np.linalg.norm(reduced, axis=1, keepdims=True))


def _parts(direction: Vector) -> list[int]:
    """Return the parameters that a direction is made of, at least one however many share it."""
    return np.flatnonzero(np.abs(direction) > _PART * np.abs(direction).max()).tolist()


def _together(directions: Sequence[Vector]) -> list[list[Vector]]:
    """Return the directions in groups that share no parameter."""
    groups: list[list[Vector]] = []
    for direction in directions:
        mine = set(_parts(direction))
        is_shared = [bool(mine & {j for other in g for j in _parts(other)}) for g in groups]
        merged = [other for g, shared in zip(groups, is_shared, strict=True) if shared for other in g]
        groups = [g for g, shared in zip(groups, is_shared, strict=True) if not shared] + [[*merged, direction]]
    return groups


def _flat(parameters: Sequence[Parameter], space: ParameterSpace, theta: Vector, group: Sequence[Vector]) -> str:
    """Return a sentence on a group of directions that the data do not determine."""
    members = sorted({j for direction in group for j in _parts(direction)})
    *most, last = (parameters[j].name for j in members)
    if not most:
        return f"The data hardly see {last}: hold it, or excite it more."
    names = f"{', '.join(most)} and {last} trade off"
    if len(group) > 1:
        return f"{names} in {len(group)} ways: hold {len(group)} of them, or excite them more."
    slope = space.slope(theta) * group[0]  # d theta along the direction
    if all(parameters[j].scale == "log" for j in members):
        exponents = slope[members] / theta[members]  # others may be zero
        if len(members) == 2:
            return f"{names}: {_of_two(parameters, members, exponents)}; hold one, or excite them more."
        if exponents.max() / exponents.min() < _SAME and exponents.min() / exponents.max() > 0.0:
            return f"{names}: their ratios are seen, their common factor is not; hold one, or excite them more."
    moves = " with ".join(_move(parameters[j], float(theta[j]), float(slope[j])) for j in members)
    return f"{names}: {moves} goes nearly unseen; hold one, or excite them more."


def _of_two(parameters: Sequence[Parameter], members: Sequence[int], exponents: Vector) -> str:
    """Return, in words, the product of powers of two log-scaled parameters that is constant along the direction."""
    a, b = exponents
    if 1.0 / _SAME < -a / b < _SAME:
        return "their product is seen, their ratio is not"
    if 1.0 / _SAME < a / b < _SAME:
        return "their ratio is seen, their product is not"
    first, second = (parameters[j].name for j in members)
    power = -a / b  # theta_1 theta_2^power
    return f"{first} {'*' if power > 0.0 else '/'} {second}^{abs(power):.2g} is seen, and neither alone"


def _move(parameter: Parameter, value: float, slope: float) -> str:
    """Return the text of a small move of one parameter: in percent on a log scale, else in its unit."""
    if parameter.scale == "log":
        return f"{parameter.name} {100.0 * _MOVE * slope / value:+.2g} %"
    return f"{parameter.name} {_with_unit(_MOVE * slope, parameter.unit, '+.2g')}"


def _with_unit(value: float, unit: str, form: str = "g") -> str:
    return f"{value:{form}}" if unit == "1" else f"{value:{form}} {unit}"


def _alike(information: Information, space: ParameterSpace) -> Iterator[str]:
    """Yield a sentence for each pair of parameters whose errors are strongly correlated."""
    s = np.maximum(information.singular_values, 1e-12)
    covariance = (information.directions.T / s**2) @ information.directions
    deviation = np.sqrt(np.maximum(covariance.diagonal(), 1e-300))
    correlation = covariance / np.outer(deviation, deviation)
    for i, j in zip(*np.tril_indices(len(space), -1), strict=True):
        if abs(correlation[i, j]) > _ALIKE:
            yield f"The errors of {space.names[i]} and {space.names[j]} are correlated ({correlation[i, j]:.2f})."
