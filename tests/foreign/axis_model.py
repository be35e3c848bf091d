def derivative(x, u, m, c=8.0):
    """m s'' = u - c s - v, with v and s the states of Axis.fmu, in its order."""
    v, s = x
    return ((u[0] - c * s - 1.0 * v) / m, v)
