"""A search that proposes one candidate at a time, though several are evaluated at one sample."""

from estimator import Estimate, Vector
from estimator.contract import Rescoring


class OneByOne:
    """Search of an estimator that could propose several candidates at once, without that.

    Each candidate then learns from those before it, however many are evaluated at a sample.
    """

    def __init__(self, search: Rescoring) -> None:
        """search: proposes the candidates."""
        self._search, self.is_whitened = search, search.is_whitened

    @property
    def candidates(self) -> Vector:
        """Stored candidates (n, d), in the parameters' units."""
        return self._search.candidates

    def restart(self, start: Vector) -> None:
        """Begin an episode at theta (d,)."""
        self._search.restart(start)

    def ask(self) -> Vector:
        """Return the next candidate theta (d,)."""
        return self._search.ask()

    def tell(self, theta: Vector, residual: Vector) -> None:
        """Record the residual (D,) of a candidate."""
        self._search.tell(theta, residual)

    def rescore(self, residuals: Vector) -> None:
        """Replace the residuals of the stored candidates."""
        self._search.rescore(residuals)

    def estimate(self) -> Estimate:
        """Return the present estimate. Raises NoEstimateError before any candidate has succeeded."""
        return self._search.estimate()
