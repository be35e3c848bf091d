"""Scrambled Sobol points for few dimensions, without scipy.stats, which takes half a second to import."""

from typing import Final

import numpy as np
import scipy

from ..space import Vector

_BITS: Final = 30
"""Binary digits of a coordinate."""
_DIRECTIONS: Final = np.array(
    [
        [1, 1, 1, 1, 1, 1, 1, 1], [1, 3, 5, 15, 17, 51, 85, 255], [1, 3, 3, 9, 29, 23, 71, 197],
        [1, 3, 1, 5, 31, 29, 81, 147], [1, 1, 1, 11, 31, 55, 61, 157], [1, 1, 3, 3, 25, 9, 43, 251],
        [1, 3, 5, 13, 11, 37, 31, 227], [1, 1, 5, 5, 17, 9, 9, 45], [1, 1, 5, 5, 5, 53, 53, 113],
        [1, 1, 7, 11, 19, 37, 69, 91], [1, 1, 5, 1, 1, 27, 79, 35], [1, 1, 1, 3, 11, 43, 75, 43],
        [1, 3, 5, 5, 31, 35, 113, 51], [1, 3, 3, 9, 7, 49, 33, 163], [1, 1, 1, 15, 21, 21, 77, 157],
        [1, 3, 1, 13, 27, 49, 35, 133],
    ]
)  # fmt: skip
"""First direction integers m_1 .. m_8 of each dimension: Joe and Kuo (2008), table new-joe-kuo-6."""


def sobol_points(n: int, d: int, rng: np.random.Generator) -> Vector:
    """Return the first n points (n, d) of a scrambled Sobol sequence; n a power of 2.

    Bratley and Fox (1988), algorithm 659, in the order of Gray's code; scrambled by a random lower triangular matrix
    and a shift: Matousek (1998). The points are those of scipy.stats.qmc.Sobol with the same rng, bit for bit, which
    makes them where there are more than 256 or 16 dimensions.
    """
    n_digits = n.bit_length() - 1
    if d > len(_DIRECTIONS) or n_digits > _DIRECTIONS.shape[1]:
        return scipy.stats.qmc.Sobol(d, rng=rng).random(n)
    (own,) = rng.spawn(1)
    weights = 2 ** np.arange(_BITS)
    shift = own.integers(2, size=(d, _BITS), dtype=np.uint32) @ weights
    lower = np.tril(own.integers(2, size=(d, _BITS, _BITS), dtype=np.uint32), -1)
    scramble = lower + np.eye(_BITS, dtype=np.int64)
    directions = _DIRECTIONS[:d, :n_digits] << (_BITS - 1 - np.arange(n_digits))
    digits = directions[:, None, :] >> (_BITS - 1 - np.arange(_BITS))[:, None] & 1  # (d, 30, k), the largest first
    columns = np.einsum("djk,j->dk", scramble @ digits % 2, weights[::-1])
    points = np.empty((n, d), dtype=np.int64)
    points[0] = shift
    for k in range(1, n):
        lowest = (k & -k).bit_length() - 1  # the digit in which Gray's codes of k - 1 and k differ
        points[k] = points[k - 1] ^ columns[:, lowest]
    return points / 2**_BITS
