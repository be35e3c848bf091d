"""Comparison of a model's derivatives with the plant's, over a dry run: what the model lacks, and what is a mistake.

A term that a model lacks, such as friction, adds to the derivative: from step to step both still change alike. With a
wrong sign, unit or order of states they do not. So mistakes are told from the changes, and sizes from the whole run.
"""

from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from estimator import Vector

from ..errors import seconds

Array = NDArray[np.float64]
Model = Callable[[Sequence[float], Sequence[float], Vector], Sequence[float]]
"""Derivatives (n,) at states (n,), inputs (p,) and parameters (d,)."""

_ROUNDING, _SLOPE = 1e-3, 0.1
"""Shares by which a model may differ from a declared derivative, and from a state's mean slope over a step."""
_SIGMA: Final = 3.0
"""Standard deviations of the declared noise below which no difference counts."""
_GROSS: Final = 0.5
"""Share of its size by which a derivative differs that is wrong, unless it changes as the model's does."""
_ALIKE: Final = 2.0
"""Largest factor between changes that are alike."""
_CORRELATED: Final = 0.7
"""Least correlation of changes that are alike."""
_APART: Final = (1, 3, 10, 30)
"""Steps over which changes are taken: an input that arrives late shows in the longer ones only."""
_FEWEST: Final = 3
"""Least number of changes that tell anything."""
_LATE: Final = (1, 2, 3, 5, 8, 12)
"""Steps by which inputs are tried to be late."""
_BETTER: Final = 0.4
"""Share of the differences that states exchanged, or inputs late, leave at most where they explain them."""


@dataclass(frozen=True)
class Step:
    """One macro step of the plant."""

    t: float
    """Its end [s]."""
    x: tuple[tuple[float, ...], tuple[float, ...]]
    """States (n,) at its start and end."""
    u: tuple[float, ...]
    """Inputs (p,) held over it."""
    theta: Vector
    """The plant's parameters (d,) in it."""
    xdot: Mapping[str, float]
    """Declared derivatives at its end, by state."""


@dataclass(frozen=True)
class Difference:
    """A derivative that the model gives otherwise than the FMU."""

    state: str
    """The state that it is of."""
    is_mean: bool
    """Whether the FMU declares no derivative, so that slopes over macro steps are compared."""
    model: float
    """The model's, in the step where they differ most."""
    fmu: float
    """The FMU's there."""
    step: Step
    """That step."""
    is_mistake: bool
    """True where the model is wrong; otherwise it lacks something."""
    why: str
    """What tells so, and what to do."""


def differences(
    model: Model, states: Sequence[str], steps: Sequence[Step], macro_step: float, noise: Mapping[str, float]
) -> Iterator[Difference]:
    """Yield the derivatives that differ over the steps by more than noise (standard deviations by state) and rounding.

    Raises ValueError, with the time, where the model does.
    """
    fmu = _measured(states, steps, macro_step)
    found = _modelled(model, states, steps)
    away, size = _rms(fmu - found), _size(fmu, found)
    share = away / size
    allowed = [_ROUNDING if state in steps[0].xdot else _SLOPE for state in states]
    differ = [i for i, state in enumerate(states) if share[i] > allowed[i] and away[i] > _SIGMA * noise.get(state, 0.0)]
    if not differ:
        return
    exchanged = _exchanged(model, states, steps, fmu, share)
    late, delayed = ("", found) if exchanged else _late(model, states, steps, fmu, found)
    rest = _shares(fmu, delayed)
    for i in differ:
        k = int(np.argmax(np.abs(fmu[:, i] - found[:, i])))
        unlike = "" if exchanged or rest[i] <= _GROSS else _unlike(fmu[:, i], delayed[:, i])
        yield Difference(
            states[i],
            states[i] not in steps[0].xdot,
            float(found[k, i]),
            float(fmu[k, i]),
            steps[k],
            bool(exchanged or unlike),
            exchanged or unlike or late or _LACKS.format(100.0 * share[i]),
        )


_LACKS: Final = (
    "they differ by {:.0f} % in the dry run: what the model leaves out on purpose, friction for instance, may stay "
    "out; otherwise add it"
)


def _measured(states: Sequence[str], steps: Sequence[Step], macro_step: float) -> Array:
    """Return the FMU's derivatives (steps, n): those that it declares, and mean slopes over the steps."""
    rows = [
        [step.xdot.get(state, (step.x[1][i] - step.x[0][i]) / macro_step) for i, state in enumerate(states)]
        for step in steps
    ]
    return np.array(rows)


def _modelled(
    model: Model,
    states: Sequence[str],
    steps: Sequence[Step],
    order: Sequence[int] | None = None,
    inputs: Sequence[tuple[float, ...]] | None = None,
) -> Array:
    """Return the model's derivatives (steps, n), with its x in another order, or with other inputs."""
    declared = np.array([state in steps[0].xdot for state in states])
    rows: list[Array] = []
    for k, step in enumerate(steps):
        u = step.u if inputs is None else inputs[k]
        ordered = [x if order is None else [x[i] for i in order] for x in step.x]
        try:
            first, last = (np.array(model(x, u, step.theta)) for x in ordered)
        except ValueError as e:
            raise ValueError(f"at t = {seconds(step.t)} s: {e}") from e
        rows.append(np.where(declared, last, 0.5 * (first + last)))
    return np.array(rows)


def _rms(values: Array) -> Array:
    return np.sqrt(np.mean(values**2, axis=0))


def _size(fmu: Array, found: Array) -> Array:
    return np.maximum(np.maximum(_rms(fmu), _rms(found)), 1e-12)


def _shares(fmu: Array, found: Array) -> Array:
    return _rms(fmu - found) / _size(fmu, found)


def _unlike(fmu: Array, found: Array) -> str:
    """Return how the changes of a derivative (steps,) differ from the model's; empty where they are alike."""
    size, text = float(_size(fmu, found)), ""
    for apart in _APART:
        f, m = fmu[apart:] - fmu[:-apart], found[apart:] - found[:-apart]
        if len(f) < _FEWEST or _rms(m) < 1e-3 * size or not np.any(f):
            continue
        gain, correlation = float(f @ m / (m @ m)), float(f @ m / np.sqrt((f @ f) * (m @ m)))
        if correlation > _CORRELATED and 1.0 / _ALIKE < gain < _ALIKE:
            return ""
        if not text:
            is_scaled = abs(correlation) > 0.9
            text = f"the FMU's changes by {gain:.3g} times the model's from step to step" if is_scaled else ""
    return f"{text or 'the two do not change alike'}: look at signs, units and the order of states and inputs"


def _exchanged(model: Model, states: Sequence[str], steps: Sequence[Step], fmu: Array, share: Array) -> str:
    """Return the two states that, exchanged, make the model fit; empty where there are none."""
    few = _few(steps)
    before, best, names = float(np.linalg.norm(share)), _BETTER, ""
    for i, j in combinations(range(len(states)), 2):
        order = list(range(len(states)))
        order[i], order[j] = j, i
        try:
            found = _modelled(model, states, [steps[k] for k in few], order)
        except ValueError:
            continue
        for tried in (found, found[:, order]):
            left = float(np.linalg.norm(_shares(fmu[few], tried))) / before
            if left < best:
                best, names = left, f"{states[i]} and {states[j]}"
    return f"it fits with {names} exchanged; the model's x is {', '.join(states)}" if names else ""


def _few(steps: Sequence[Step]) -> list[int]:
    return list(range(0, len(steps), max(1, len(steps) // 25)))


def _late(model: Model, states: Sequence[str], steps: Sequence[Step], fmu: Array, found: Array) -> tuple[str, Array]:
    """Return by how many steps inputs are late, where that explains the differences, and the derivatives then."""
    best, late, delayed = _BETTER * float(np.linalg.norm(_shares(fmu, found))), 0, found
    for n in _LATE[: bisect_left(_LATE, len(steps))]:
        inputs = [steps[max(k - n, 0)].u for k in range(len(steps))]
        try:
            tried = _modelled(model, states, steps, inputs=inputs)
        except ValueError:
            continue
        left = float(np.linalg.norm(_shares(fmu, tried)))
        if left < best:
            best, late, delayed = left, n, tried
    text = f"it fits with inputs {late} macro step{'s' * (late > 1)} late: a lag may stay out of the model"
    return text if late else "", delayed
