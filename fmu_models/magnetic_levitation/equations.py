"""Steel ball held below an electromagnet, and its feedback-linearising controller. Independent of FMI.

State x = (z [m], v [m/s]): the gap between magnet and ball, and its rate; z grows downwards. The inputs are the current
i [A] and a disturbance force F_d [N], downwards, which may be left out. Open loop the ball falls, or jumps to the
magnet; stops are not modelled.

Wong (1986), "Design of a magnetic levitation control system: an undergraduate project", IEEE Trans. Education E-29: the
force goes with the square of current over gap. z_0 is added to the gap: the length of air that iron and non-magnetic
layers are worth, so that the force stays finite where the ball touches.
"""

from math import sqrt


def derivative(
    x: tuple[float, float], u: tuple[float, ...], m: float = 0.1, z_0: float = 0.004, k: float = 2e-4, g: float = 9.81,
    k_d: float = 0.0,
) -> tuple[float, float]:  # fmt: skip
    """Return the time derivative of the ball's state.

    v_dot = g - (k/m) (i/(z + z_0))^2 + (F_d - k_d v)/m

    x: (gap z [m], v [m/s]);  u: (current i [A], disturbance F_d [N], zero if left out);  m: mass [kg];
    z_0: gap that iron and layers are worth [m];  k: force times squared gap over squared current [N m^2/A^2];
    g: gravity [m/s^2];  k_d: linear drag [kg/s];  returns (m/s, m/s^2). Raises ZeroDivisionError where z = -z_0.
    """
    z, v = x
    ratio = u[0] / (z + z_0)
    v_dot = g - k / m * (ratio * ratio)
    if any(u[1:]):
        v_dot += u[1] / m
    if k_d:
        v_dot -= k_d / m * v
    return (v, v_dot)


def control(
    x: tuple[float, float], x_ref: tuple[float, float, float], m: float, z_0: float, k: float, g: float, K_p: float,
    K_d: float, i_max: float,
) -> float:  # fmt: skip
    """Return the current [A] of the feedback-linearising law, computed with the controller's own parameters.

    i = (z + z_0) sqrt((m/k) max(g - v_dot_ref - K_p e - K_d e_dot, 0)),  e = z_ref - z,  limited to 0 ... i_max

    x: (gap z [m], v [m/s]);  x_ref: (z_ref, v_ref, v_dot_ref);  K_p [1/s^2], K_d [1/s]: gains of the linear error
    dynamics e_ddot + K_d e_dot + K_p e = 0, which hold off the limits where the parameters are true; the others as in
    `derivative`. The magnet can only pull.
    """
    z, v = x
    z_ref, v_ref, v_dot_ref = x_ref
    pull = g - v_dot_ref - K_p * (z_ref - z) - K_d * (v_ref - v)
    return min(max(z + z_0, 0.0) * sqrt(m / k * max(pull, 0.0)), i_max)
