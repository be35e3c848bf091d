"""Arm of two links in the vertical plane, with a payload on the second one.

Spong, Hutchinson and Vidyasagar (2006), "Robot Modeling and Control", section 7.4.
State x = (q_1, q_2 [rad], w_1, w_2 [rad/s]): angles of the first link from the horizontal and of the second from the
first, and their rates. The load is a torque on the shoulder [N m].
"""

from math import cos, sin

from .plant import Estimated, ForeignPlant, Signal, Values, total, wave

G = 9.81
LENGTH = 0.5
"""Length of the first link [m]."""
LINKS = ((2.0, 0.25, 0.04), (1.5, 0.2, 0.02))
"""Of each link: mass [kg], distance of its centre from its joint [m], inertia about it [kg m^2]."""
K_P, K_D = 100.0, 20.0
"""Gains on the errors of angle [1/s^2] and speed [1/s]: both poles of each joint at -10 rad/s."""


def _terms(x: Values, m: float, r: float) -> tuple[Values, Values]:
    """Return inertias (M_11, M_12, M_22) [kg m^2], and torques of speed and gravity [N m]."""
    q_1, q_2, w_1, w_2 = x
    (m_1, c_1, J_1), (m_2, c_2, J_2) = LINKS
    first = J_1 + m_1 * c_1**2 + (m_2 + m) * LENGTH**2
    second = J_2 + m_2 * c_2**2 + m * r * r
    moment = m_2 * c_2 + m * r
    coupling = LENGTH * moment * cos(q_2)
    swing = LENGTH * moment * sin(q_2)
    weight = G * moment * cos(q_1 + q_2)
    torques = (
        weight + G * (m_1 * c_1 + (m_2 + m) * LENGTH) * cos(q_1) - swing * (2.0 * w_1 + w_2) * w_2,
        weight + swing * w_1 * w_1,
    )
    return (first + second + 2.0 * coupling, second + coupling, second), torques


def derivative(x: Values, u: Values, m: float, r: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state: M(q) w_dot + n(q, w) = u + (load, 0).

    u: (torques of shoulder and elbow [N m]);  m: payload [kg];  r: its distance from the elbow [m].
    """
    (M_11, M_12, M_22), n = _terms(x, m, r)
    a, b = u[0] + load - n[0], u[1] - n[1]
    det = M_11 * M_22 - M_12 * M_12
    return (x[2], x[3], (M_22 * a - M_12 * b) / det, (M_11 * b - M_12 * a) / det)


def control(x: Values, reference: Values, m: float, r: float) -> Values:
    """Return the torques of the law of computed torque."""
    (M_11, M_12, M_22), n = _terms(x, m, r)
    a, b = (reference[4 + j] + K_P * (reference[j] - x[j]) + K_D * (reference[2 + j] - x[2 + j]) for j in (0, 1))
    return (M_11 * a + M_12 * b + n[0], M_12 * a + M_22 * b + n[1])


def reference(t: float) -> Values:
    """Return the desired angles, speeds and accelerations."""
    q_1 = total(wave(t, 0.5, 2.0, n=2), wave(t, 0.1, 5.0, n=2))
    q_2 = wave(t, 0.6, 3.0, 1.0, n=2)
    return (q_1[0], q_2[0], q_1[1], q_2[1], q_1[2], q_2[2])


_BEGIN = reference(0.0)
PLANT = ForeignPlant(
    name="arm",
    title="Arm of two links with a payload",
    parameters=(
        Estimated("m", "kg", 1.0, 1.8, "Payload"),
        Estimated("r", "m", 0.3, 0.4, "Distance of the payload from the elbow"),
    ),
    states=(
        Signal("q_1", "rad", "Angle of the shoulder", _BEGIN[0]),
        Signal("q_2", "rad", "Angle of the elbow", _BEGIN[1]),
        Signal("w_1", "rad/s", "Speed of the shoulder", _BEGIN[2]),
        Signal("w_2", "rad/s", "Speed of the elbow", _BEGIN[3]),
    ),
    controls=(Signal("u_1", "N.m", "Torque of the shoulder"), Signal("u_2", "N.m", "Torque of the elbow")),
    references=(
        Signal("q_1_ref", "rad", "Desired angle of the shoulder"),
        Signal("q_2_ref", "rad", "Desired angle of the elbow"),
        Signal("w_1_ref", "rad/s", "Desired speed of the shoulder"),
        Signal("w_2_ref", "rad/s", "Desired speed of the elbow"),
        Signal("a_1_ref", "rad/s2", "Desired acceleration of the shoulder"),
        Signal("a_2_ref", "rad/s2", "Desired acceleration of the elbow"),
    ),
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"q_1": "q_1_ref", "q_2": "q_2_ref"},
    noise={"w_1": 0.02, "w_2": 0.05},
    step=0.005,
    divergence=2.0,
    rate=38.0,
    limit=23.0,
    speed="w_1",
    pace=1.0,
)
