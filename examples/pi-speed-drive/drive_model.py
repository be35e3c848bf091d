"""The drive's equations, by which candidates are scored."""


def derivative(x, u, J, d):
    """Return (w',) for x = (w,) and u = (tau,)."""
    (w,), (tau,) = x, u
    return ((tau - d * w) / J,)
