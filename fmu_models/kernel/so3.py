"""Vectors and rotations in three dimensions, as tuples; a matrix is nine numbers, row by row."""

from math import sqrt

Vector3 = tuple[float, float, float]
Matrix3 = tuple[float, float, float, float, float, float, float, float, float]

IDENTITY: Matrix3 = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def add(a: Vector3, b: Vector3) -> Vector3:
    """Return a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Vector3, b: Vector3) -> Vector3:
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(s: float, a: Vector3) -> Vector3:
    """Return s a."""
    return (s * a[0], s * a[1], s * a[2])


def multiply(a: Vector3, b: Vector3) -> Vector3:
    """Return diag(a) b, the product component by component."""
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2])


def dot(a: Vector3, b: Vector3) -> float:
    """Return a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector3, b: Vector3) -> Vector3:
    """Return a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def columns(a: Vector3, b: Vector3, c: Vector3) -> Matrix3:
    """Return the matrix [a b c] with these columns."""
    return (a[0], b[0], c[0], a[1], b[1], c[1], a[2], b[2], c[2])


def transpose(m: Matrix3) -> Matrix3:
    """Return M^T."""
    return (m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8])


def apply(m: Matrix3, a: Vector3) -> Vector3:
    """Return M a."""
    return (
        m[0] * a[0] + m[1] * a[1] + m[2] * a[2],
        m[3] * a[0] + m[4] * a[1] + m[5] * a[2],
        m[6] * a[0] + m[7] * a[1] + m[8] * a[2],
    )


def product(a: Matrix3, b: Matrix3) -> Matrix3:
    """Return A B."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = a
    b0, b1, b2, b3, b4, b5, b6, b7, b8 = b
    return (
        a0 * b0 + a1 * b3 + a2 * b6, a0 * b1 + a1 * b4 + a2 * b7, a0 * b2 + a1 * b5 + a2 * b8,
        a3 * b0 + a4 * b3 + a5 * b6, a3 * b1 + a4 * b4 + a5 * b7, a3 * b2 + a4 * b5 + a5 * b8,
        a6 * b0 + a7 * b3 + a8 * b6, a6 * b1 + a7 * b4 + a8 * b7, a6 * b2 + a7 * b5 + a8 * b8,
    )  # fmt: skip


def vee(m: Matrix3) -> Vector3:
    """Return the vector a with hat(a) = (M - M^T)/2, the skew part of M;  hat(a) b = a x b."""
    return (0.5 * (m[7] - m[5]), 0.5 * (m[2] - m[6]), 0.5 * (m[3] - m[1]))


def unit_derivatives(a: Vector3, a_dot: Vector3, a_ddot: Vector3) -> tuple[Vector3, Vector3, Vector3]:
    """Return the unit vector q = a/|a| with its first and second time derivatives.

    Raises ZeroDivisionError where a = 0.
    """
    n = sqrt(dot(a, a))
    q = scale(1.0 / n, a)
    n_dot = dot(q, a_dot)
    q_dot = scale(1.0 / n, subtract(a_dot, scale(n_dot, q)))
    n_ddot = dot(q_dot, a_dot) + dot(q, a_ddot)
    q_ddot = scale(1.0 / n, subtract(subtract(a_ddot, scale(n_ddot, q)), scale(2.0 * n_dot, q_dot)))
    return q, q_dot, q_ddot


def orthonormalized(m: Matrix3) -> Matrix3:
    """Return the rotation by Gram-Schmidt orthonormalisation of the columns of M, from the first.

    An integrated M = R (I + O(1e-12)) becomes a rotation again; and so does any M of rank three, such as that of
    a rotation too fast for the step. Raises ZeroDivisionError where the first two columns are parallel.
    """
    a1, a2 = (m[0], m[3], m[6]), (m[1], m[4], m[7])
    b1 = scale(1.0 / sqrt(dot(a1, a1)), a1)
    b2 = subtract(a2, scale(dot(b1, a2), b1))
    b2 = scale(1.0 / sqrt(dot(b2, b2)), b2)
    return columns(b1, b2, cross(b1, b2))
