"""Correlation of a filter's innovations, which white noise does not have: Mehra (1970), "On the identification of
variances and adaptive Kalman filtering"."""

from dataclasses import dataclass
from math import sqrt
from typing import Final

from .space import Vector

_MEMORY: Final = 0.95
"""Factor by which the innovations' sums fade from sample to sample."""
_CORRELATED: Final = 0.5
"""Correlation of an innovation with the one before that shows what no parameter explains."""
_N_STD: Final = 3.5
"""Standard deviations of white noise that it must exceed, where there are few samples or channels."""
_FEWEST: Final = 10
"""Least number of innovations that say whether they are correlated."""


@dataclass(frozen=True)
class Whiteness:
    """Correlation of each innovation with the one before, of the newest samples: white ones have none.

    That is the mean cosine of the angle between them. However large innovations are while a filter catches up with a
    drift, they count as much as others.
    """

    newest: Vector
    """Direction (c,) of the newest innovation in its own standard deviations; empty before the first."""
    weight: float = 0.0
    """Sum of the innovations' weights, which fade."""
    cosines: float = 0.0
    """Sum of the cosines between each innovation and the one before, fading."""
    squares: float = 0.0
    """Sum of the innovations' mean squares over their channels, fading."""
    n_samples: int = 0
    """Number of samples in them."""

    def updated(self, innovation: Vector) -> "Whiteness":
        """Return the correlation with one more innovation (c,)."""
        squared = float(innovation @ innovation)
        direction = innovation / max(sqrt(squared), 1e-300)
        cosine = float(direction @ self.newest) if len(self.newest) == len(direction) else 0.0
        weight, cosines = _MEMORY * self.weight + 1.0, _MEMORY * self.cosines + cosine
        squares = _MEMORY * self.squares + squared / len(innovation)
        return Whiteness(direction, weight, cosines, squares, self.n_samples + 1)

    @property
    def is_refuted(self) -> bool:
        """True where the innovations are correlated, by more than chance and by more than a filter's lag.

        Not where they are smaller than white noise would be, as with a noise that is declared too large.
        """
        if self.n_samples < _FEWEST or self.squares < self.weight:
            return False
        squares = (1.0 - _MEMORY ** (2 * self.n_samples)) / (1.0 - _MEMORY**2)  # sum of the weights' squares
        std = sqrt(squares / len(self.newest)) / self.weight
        return self.cosines > max(_CORRELATED, _N_STD * std) * self.weight
