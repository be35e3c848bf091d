"""Friction that the plant's model lacks: viscous, dry or quadratic in the speed.

It acts on a sampled derivative, as drag does on a mass, or at an input, as friction in a drive does: the model's slopes
by its inputs then say which derivatives feel it. Which terms act is found by sparse regression of what the model leaves
unexplained on a library of such terms: Brunton, Proctor and Kutz (2016), "Discovering governing equations from data by
sparse identification of nonlinear dynamical systems"; Kaheman et al. (2019), "Learning discrepancy models from
experimental data".
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import copysign, log, nan
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..hypotheses import MARGIN, NEVER, Fit, plain_fit
from ..samples import Sample
from ..space import Vector

Law = Literal["viscous", "dry", "quadratic"]
"""Friction's dependence on the speed v: v, sign v, or v |v|."""
_SLOW: Final = 0.05
"""Speed, as a share of the largest one, below which dry friction may have any size up to that of sliding."""
_VARIED: Final = 0.5
"""Least range of the speeds, as a share of the largest one."""
_TO_AND_FRO: Final = 3
"""Least number of samples in each direction that tell dry friction from a constant."""
_ASIDE: Final = 0.01
"""Step of differences in an input, as a share of its size."""
_SEEN: Final = 1e-4
"""Share of a term's squares that must be left beside the terms that were chosen before."""
_LIKE: Final = 0.02
"""Share by which coefficients that are nearly the same may differ."""
_LITTLE: Final = 0.25
"""Share of the squares that friction may leave."""
_MOST_TERMS: Final = 3
"""Largest number of terms, by the number of channels."""


def speed_law(law: Law, v: float) -> float:
    """Return v, sign v or v |v|."""
    if law == "viscous":
        return v
    if law == "quadratic":
        return v * abs(v)
    return copysign(1.0, v) if v else 0.0


@dataclass(frozen=True)
class FrictionTerm:
    """One friction: -coefficient law(v), on a derivative or at an input."""

    law: Law
    velocity: int
    """Place of v in the state."""
    channels: tuple[int, ...]
    """Channels that feel it: one on whose derivative it acts, or those that the input reaches."""
    at_input: int | None = None
    """Place of the input at which it acts; None on the derivative."""
    coefficient: float = 1.0
    """In units of the derivative or of the input, by those of law(v); at least 0."""
    slow: float = 0.0
    """Speed below which dry friction is not known."""

    def force(self, x: Sequence[float]) -> float:
        """Return the friction against the motion at state x (n,); NaN where it is not known."""
        v = x[self.velocity]
        return nan if self.law == "dry" and abs(v) < self.slow else self.coefficient * speed_law(self.law, v)


@dataclass(frozen=True)
class Friction:
    """Friction that is known; none by default."""

    terms: tuple[FrictionTerm, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.terms)

    def without(self, sample: Sample) -> Sample:
        """Return the sample less its friction; NaN in place of the derivatives whose friction is not known."""
        u, xdot = [*sample.u], [*sample.xdot]
        for term in self.terms:
            force = term.force(sample.x)
            if force != force:
                for c in term.channels:
                    xdot[c] = nan
            elif term.at_input is None:
                xdot[term.channels[0]] += force
            else:
                u[term.at_input] -= force
        return replace(sample, u=tuple(u), xdot=tuple(xdot))

    def is_like(self, other: "Friction") -> bool:
        """Return whether the other one has the same terms, of nearly the same sizes."""
        kinds, others = ([(t.law, t.velocity, t.at_input) for t in f.terms] for f in (self, other))
        pairs = zip(self.terms, other.terms)
        return kinds == others and all(abs(a.coefficient - b.coefficient) <= _LIKE * b.coefficient for a, b in pairs)

    def laws_at(self, samples: Sequence[Sample]) -> Vector:
        """Return the terms' laws (n, k) of the speeds at n samples."""
        return np.array([[speed_law(t.law, s.x[t.velocity]) for t in self.terms] for s in samples])

    def summary(self, names: Sequence[str], places: Sequence[int], inputs: Sequence[str]) -> list[dict[str, Any]]:
        """Return the terms as JSON values.

        names, places (c,): of the channels, and of what each is the derivative of in the state; inputs: their names.
        """
        return [
            {
                "law": term.law,
                "coefficient": term.coefficient,
                "acts_on": names[term.channels[0]] if term.at_input is None else inputs[term.at_input],
                "speed_of": names[[*places].index(term.velocity)],
            }
            for term in self.terms
        ]


@dataclass(frozen=True)
class FoundFriction:
    """Friction that explains samples, beside a constant disturbance."""

    friction: Friction
    constant: Vector | float
    """Constant disturbance (c,), in standard deviations."""
    fit: Fit


NO_FRICTION: Final = FoundFriction(Friction(), 0.0, NEVER)


def find_friction(
    rows_of: Callable[[Sequence[Sample]], Vector], samples: Sequence[Sample], places: Sequence[int]
) -> FoundFriction:
    """Return the friction, and the constant disturbance, that explain samples best; `NO_FRICTION` where none do.

    rows_of: residuals (n, c) of samples, in standard deviations. places (c,): in the state, of what each channel is the
    derivative of. Terms are chosen one after the other, each the one that explains most of what is left (orthogonal
    matching pursuit: Pati, Rezaiifar and Krishnaprasad 1993), until nothing is.
    """
    rows = rows_of(samples)
    library = [_Column(_constant(rows, c), None) for c in range(rows.shape[1])]
    library += _friction_columns(rows_of, samples, rows, places)
    table = np.array([column.values.reshape(-1) for column in library])
    if not (np.all(np.isfinite(table)) and np.all(np.isfinite(rows))):
        return NO_FRICTION
    may_fall = np.array([column.term is None for column in library])
    chosen, is_known = _chosen(table, rows.reshape(-1), may_fall, [_known(c, samples, rows) for c in library])
    left, sizes = _explained(table[chosen], rows.reshape(-1), is_known)
    fit = _fit(left, len(chosen))
    terms = [(library[i].term, size) for i, size in zip(chosen, sizes.tolist())]
    found = tuple(replace(term, coefficient=size) for term, size in terms if term is not None)
    if not found or not fit.is_explained or any(term.coefficient <= 0.0 for term in found):
        return NO_FRICTION
    if not _is_most(rows, left.reshape(rows.shape), is_known.reshape(rows.shape), found):
        return NO_FRICTION
    constant = np.zeros(rows.shape[1])
    for i, size in zip(chosen, sizes.tolist()):
        constant[i : i + 1] += size if library[i].term is None else 0.0
    return FoundFriction(Friction(found), constant, fit)


def _is_most(rows: Vector, left: Vector, is_known: NDArray[np.bool_], terms: Sequence[FrictionTerm]) -> bool:
    """Return whether terms explain most of the residuals (n, c) of the channels that feel them, constants aside.

    Coloured noise that is known to be large leaves much that anything explains.
    """
    felt = sorted({channel for term in terms for channel in term.channels})
    before = sum(float(np.sum((r - r.mean()) ** 2)) for c in felt if len(r := rows[is_known[:, c], c]))
    return float(np.sum(left[:, felt] ** 2)) <= _LITTLE * before


@dataclass(frozen=True)
class _Column:
    """Column of the library: residuals (n, c) by a term's coefficient, or by a constant where term is None."""

    values: Vector
    term: FrictionTerm | None


def _constant(rows: Vector, channel: int) -> Vector:
    values = np.zeros(rows.shape)
    values[:, channel] = rows[:, channel] != 0.0
    return values


def _friction_columns(
    rows_of: Callable[[Sequence[Sample]], Vector], samples: Sequence[Sample], rows: Vector, places: Sequence[int]
) -> list[_Column]:
    """Return the columns of friction by each velocity, at the inputs that reach its derivative and on that itself.

    An input that is always zero is not connected to anything that moves, and the model may not know it.
    The simplest come first: viscous friction, and what reaches the fewest channels.
    """
    x, u = np.array([s.x for s in samples]), np.array([s.u for s in samples])
    by_input = {j: _slope(rows_of, samples, rows, j) for j in np.flatnonzero(u.any(axis=0)).tolist()}
    by_derivative = rows - rows_of([replace(s, xdot=tuple([y + 1.0 for y in s.xdot])) for s in samples])
    columns: list[_Column] = []
    for (channel, place), law in product(enumerate(places), get_args(Law)):
        if place >= x.shape[1] or not _is_told_apart(law, x[:, place]):
            continue
        slow = _SLOW * float(np.abs(x[:, place]).max())
        against = np.array([speed_law(law, v) for v in x[:, place].tolist()])[:, None]
        for j, slope in by_input.items():
            reached = tuple(np.flatnonzero(slope.any(axis=0)).tolist())
            if channel in reached:
                columns.append(_Column(against * slope, FrictionTerm(law, place, reached, j, slow=slow)))
        alone = against * by_derivative * (np.arange(rows.shape[1]) == channel)
        columns.append(_Column(alone, FrictionTerm(law, place, (channel,), slow=slow)))
    return sorted(columns, key=_simplicity)


def _is_told_apart(law: Law, v: Vector) -> bool:
    """Return whether speeds (n,) differ by so much that friction is not the same as a constant."""
    if law == "dry":
        return bool(min(np.count_nonzero(v > 0.0), np.count_nonzero(v < 0.0)) >= _TO_AND_FRO)
    return bool(np.ptp(v) > _VARIED * np.abs(v).max())


def _simplicity(column: _Column) -> tuple[int, int, bool]:
    term = column.term
    assert term is not None
    return get_args(Law).index(term.law), len(term.channels), term.at_input is None


def _slope(rows_of: Callable[[Sequence[Sample]], Vector], samples: Sequence[Sample], rows: Vector, j: int) -> Vector:
    """Return the slope (n, c) of the residuals by input j."""
    step = _ASIDE * max(abs(s.u[j]) for s in samples)
    moved = [replace(s, u=(*s.u[:j], s.u[j] + step, *s.u[j + 1 :])) for s in samples]
    return (rows_of(moved) - rows) / step


def _known(column: _Column, samples: Sequence[Sample], rows: Vector) -> NDArray[np.bool_]:
    """Return for which residuals (n c,) a term's friction is known: dry friction is not, near rest."""
    is_known = rows != 0.0
    if column.term is not None and column.term.law == "dry":
        forces = [column.term.force(s.x) for s in samples]
        is_known[np.ix_(np.isnan(forces), np.array(column.term.channels))] = False
    return is_known.reshape(-1)


def _chosen(
    table: Vector, rows: Vector, may_fall: NDArray[np.bool_], known: Sequence[NDArray[np.bool_]]
) -> tuple[list[int], NDArray[np.bool_]]:
    """Return which columns of the table (q, m) explain the residuals (m,), and those that are known with them."""
    chosen: list[int] = []
    is_known = known[0]  # of a constant: wherever something was sampled
    squares = np.sum(table**2, axis=1)
    while len(chosen) < _MOST_TERMS * int(np.count_nonzero(may_fall)):
        left, _ = _explained(table[chosen], rows, is_known)
        if _fit(left, len(chosen)).is_explained:
            break
        base = np.linalg.qr((table[chosen] * is_known).T)[0]
        beside = table * is_known
        beside = beside - (beside @ base) @ base.T
        along, norms = beside @ left, np.sum(beside**2, axis=1)
        is_open = (norms > _SEEN * squares) & (may_fall | (along > 0.0))
        gains = np.where(is_open, along**2, 0.0) / np.where(is_open, norms, 1.0)
        if gains.max() <= 2.0 * log(len(rows)):
            break
        best = int(np.argmax(gains + MARGIN >= gains.max()))  # the simplest of those that are nearly as good
        chosen.append(best)
        is_known = is_known & known[best]
    return chosen, is_known


def _explained(columns: Vector, rows: Vector, is_known: NDArray[np.bool_]) -> tuple[Vector, Vector]:
    """Return what columns (k, m) leave of the residuals (m,), 0 where these are not known, and their sizes (k,)."""
    a, r = (columns * is_known).T, rows * is_known
    sizes = np.asarray(np.linalg.lstsq(a, r, rcond=None)[0], dtype=np.float64)
    return r - a @ sizes, sizes


def _fit(left: Vector, n_free: int) -> Fit:
    return plain_fit(left[:, None], n_free, int(np.count_nonzero(left)))
