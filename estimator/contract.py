"""What every estimator is and returns."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from .identifiability import Information
from .objective import Objective
from .space import ParameterSpace, Vector


class NoEstimateError(RuntimeError):
    """No candidate of an `AskTell` has succeeded yet, so there is nothing to believe."""


@dataclass(frozen=True)
class Estimate:
    """Values of the parameters, how well they are known, and why these were taken."""

    theta: Vector
    """Values (d,), in each parameter's unit; always inside the bounds."""
    std: Vector
    """Root mean square errors (d,), in the same units; as wide as the bounds where the data say nothing.

    On a log scale std / theta is that of the logarithm: the 95 % interval is theta exp(+- 1.96 std / theta).
    """
    is_identifiable: tuple[bool, ...]
    """Whether the data fix each parameter (d,); where not, theta keeps near its value from the start."""
    cost: float
    """Objective at theta: sum of squared residuals (`target`; the surrogate's where directions are held), noisy norm
    (`paper`)."""
    n_evaluations: int
    """Evaluations told since the last restart."""
    reason: str
    """Why this value was taken, for the record."""
    information: Information | None = None
    """What the data see at theta, in standard deviations of the misfit; None where the estimator cannot tell."""


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
    """The estimate at z (d,) of the unit cube; std (d,): there too; below: std of an identifiable parameter."""
    theta = space.from_unit(z)
    identifiable = tuple(bool(s <= below) for s in std)
    return Estimate(theta, std * space.slope(theta), identifiable, cost, n_evaluations, reason, information)


@runtime_checkable
class Estimator(Protocol):
    """Believes something of the parameters. It is either an `AskTell` or a `Solver`."""

    is_whitened: bool
    """Whether its residuals are in standard deviations of the noise, or in physical units."""

    def restart(self, start: Vector) -> None:
        """Begin an episode at theta (d,): the value to fall back on. Earlier knowledge may be kept."""
        ...

    def estimate(self) -> Estimate:
        """The present belief. An `AskTell` raises NoEstimateError before any candidate has succeeded."""
        ...


@runtime_checkable
class AskTell(Estimator, Protocol):
    """Asks for candidates one by one and is told their residuals. Lower residuals are better."""

    def ask(self) -> Vector:
        """The next candidate theta (d,)."""
        ...

    def tell(self, theta: Vector, residual: Vector) -> None:
        """The residual (D,) of a candidate. A non-finite one marks a candidate that failed."""
        ...


@runtime_checkable
class Rescoring(AskTell, Protocol):
    """Its stored candidates can be judged anew when the data have changed."""

    @property
    def candidates(self) -> Vector:
        """Stored candidates (n, d), in the parameters' units."""
        ...

    def rescore(self, residuals: Vector) -> None:
        """Replace what was told of the stored candidates by residuals (n, D); D may have changed."""
        ...


@runtime_checkable
class Batching(AskTell, Protocol):
    """It can ask for several candidates before it is told of any, so that they are judged at the same time."""

    def ask_many(self, n: int) -> list[Vector]:
        """One candidate theta (d,) at least, n at most."""
        ...


@runtime_checkable
class Solver(Estimator, Protocol):
    """Evaluates as many candidates as it likes at once: an optimiser, or a filter that takes the newest sample."""

    def solve(self, objective: Objective) -> None:
        """Take the present samples into the belief."""
        ...
