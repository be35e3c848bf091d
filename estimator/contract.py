"""Interfaces of the estimators, and the estimate that they return."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from .identifiability import Information
from .objective import Objective
from .space import ParameterSpace, Vector


class NoEstimateError(RuntimeError):
    """Raised by an `AskTell` none of whose candidates has succeeded yet, so that there is no estimate."""


@dataclass(frozen=True)
class Estimate:
    """Values of the parameters, their standard deviations, and the reason why these values were taken."""

    theta: Vector
    """Values (d,), in each parameter's unit; always inside the bounds."""
    std: Vector
    """Root mean square errors (d,), in the same units; as wide as the bounds where the data say nothing.

    On a log scale std / theta is that of the logarithm: the 95 % interval is theta exp(+- 1.96 std / theta).
    """
    is_identifiable: tuple[bool, ...]
    """True where the data determine the parameter (d,); elsewhere theta stays near its value from the start."""
    cost: float
    """Objective at theta: sum of squared residuals (`target`; the surrogate's where directions are held), noisy norm
    (`paper`)."""
    n_evaluations: int
    """Number of evaluations since the last restart."""
    reason: str
    """Reason why this value was taken, for the record."""
    information: Information | None = None
    """Sensitivity of the residuals at theta, in standard deviations of the misfit; None where it is not known."""

    def as_json(self) -> dict[str, Any]:
        """Return the values and their certainty as JSON values."""
        return {
            "theta": self.theta.tolist(),
            "std": self.std.tolist(),
            "is_identifiable": list(self.is_identifiable),
            "reason": self.reason,
        }


def scaled_estimate(
    space: ParameterSpace,
    z: Vector,
    std: Vector,
    below: float,
    information: Information,
    *,
    cost: float,
    n_evaluations: int,
    reason: str,
) -> Estimate:
    """Return the estimate at z (d,) of the unit cube; std (d,): there too; below: std of an identifiable parameter."""
    theta = space.from_unit(z)
    identifiable = tuple(bool(s <= below) for s in std)
    return Estimate(theta, std * space.slope(theta), identifiable, cost, n_evaluations, reason, information)


@runtime_checkable
class Estimator(Protocol):
    """Interface that both kinds of estimator share; an estimator is either an `AskTell` or a `Solver`."""

    is_whitened: bool
    """True where its residuals are in standard deviations of the noise, False where in physical units."""

    def restart(self, start: Vector) -> None:
        """Begin an episode at theta (d,), the value to fall back on. Results of earlier episodes may be kept."""
        ...

    def estimate(self) -> Estimate:
        """Return the present estimate. An `AskTell` raises NoEstimateError before any candidate has succeeded."""
        ...


@runtime_checkable
class AskTell(Estimator, Protocol):
    """Estimator that proposes candidates one by one and receives their residuals, which it makes small.

    An episode of n evaluations:

        estimator.restart(held)  # the controller's parameters (d,)
        for _ in range(n):
            theta = estimator.ask()
            estimator.tell(theta, objective.residual(theta))
        held = estimator.estimate().theta
    """

    def ask(self) -> Vector:
        """Return the next candidate theta (d,)."""
        ...

    def tell(self, theta: Vector, residual: Vector) -> None:
        """Record the residual (D,) of a candidate. A non-finite one marks a candidate that failed."""
        ...


@runtime_checkable
class Rescoring(AskTell, Protocol):
    """Ask-tell estimator whose stored candidates can be evaluated again when the data have changed."""

    @property
    def candidates(self) -> Vector:
        """Stored candidates (n, d), in the parameters' units."""
        ...

    def rescore(self, residuals: Vector) -> None:
        """Replace the residuals of the stored candidates by residuals (n, D); D may have changed."""
        ...


@runtime_checkable
class Batching(AskTell, Protocol):
    """Ask-tell estimator that can propose several candidates at once, to be evaluated at the same time."""

    def ask_many(self, n: int) -> list[Vector]:
        """Return at least one candidate theta (d,), at most n."""
        ...


@runtime_checkable
class Converging(AskTell, Protocol):
    """Ask-tell estimator that knows when more evaluations gain nothing."""

    @property
    def is_done(self) -> bool:
        """True where the residual is explained, and nothing worth a tenth of a standard deviation is to be gained."""
        ...


@runtime_checkable
class Solver(Estimator, Protocol):
    """Estimator that evaluates candidates by itself: an optimiser, or a filter that takes the newest sample.

    A solve on the present samples:

        estimator.restart(held)  # the controller's parameters (d,)
        estimator.solve(objective)  # calls objective.residual(theta) as often as it needs
        held = estimator.estimate().theta
    """

    def solve(self, objective: Objective) -> None:
        """Update the estimate with the present samples."""
        ...


@runtime_checkable
class Jumping(Solver, Protocol):
    """Filter that can go on from other parameters with what is known of them, as after a jump of the plant's."""

    def jump(self, estimate: Estimate) -> None:
        """Go on from an estimate that has its information."""
        ...
