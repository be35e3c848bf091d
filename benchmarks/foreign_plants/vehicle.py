"""Yaw rate of a car by the single-track model, loaded so that it is unstable at its speed without its controller.

Rajamani (2012), "Vehicle Dynamics and Control", section 2.3. State x = (beta [rad], r [rad/s]): slip angle of the body
and yaw rate. The load is a yawing moment, by side wind [N m].
"""

from .plant import Estimated, ForeignPlant, Signal, Values, total, wave

MASS, INERTIA = 1600.0, 2600.0
"""Mass [kg], and inertia about the vertical [kg m^2]."""
FRONT, REAR = 1.6, 1.1
"""Distances of the axles from the centre [m]."""
SPEED = 33.0
"""Speed [m/s]."""
POLE = 12.0
"""Pole of the yaw rate's error at -12 rad/s."""


def derivative(x: Values, u: Values, C_f: float, C_r: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state, with the forces F = C_f (u - beta - a r/V), R = C_r (b r/V - beta).

    m V (beta_dot + r) = F + R,  J r_dot = a F - b R + load

    u: (steering angle [rad]);  C_f, C_r: stiffness of the axles by slip angle [N/rad].
    """
    beta, r = x
    front = C_f * (u[0] - beta - FRONT * r / SPEED)
    rear = C_r * (REAR * r / SPEED - beta)
    return ((front + rear) / (MASS * SPEED) - r, (FRONT * front - REAR * rear + load) / INERTIA)


def control(x: Values, reference: Values, C_f: float, C_r: float) -> Values:
    """Return the steering angle of the feedback-linearising law."""
    beta, r = x
    rear = C_r * (REAR * r / SPEED - beta)
    wanted = reference[1] + POLE * (reference[0] - r)
    return ((INERTIA * wanted + REAR * rear) / (FRONT * C_f) + beta + FRONT * r / SPEED,)


def reference(t: float) -> Values:
    """Return the desired yaw rate and its derivative."""
    return total(wave(t, 0.12, 1.5, n=1), wave(t, 0.03, 4.0, n=1))


_OWN = "the tyres are all that touches the road, and they are parameters of the model"
PLANT = ForeignPlant(
    name="vehicle",
    title="Yaw rate of a car",
    parameters=(
        Estimated("C_f", "N/rad", 9e4, 7e4, "Stiffness of the front axle"),
        Estimated("C_r", "N/rad", 9.5e4, 7e4, "Stiffness of the rear axle"),
    ),
    states=(Signal("beta", "rad", "Slip angle of the body"), Signal("r", "rad/s", "Yaw rate")),
    controls=(Signal("u", "rad", "Steering angle"),),
    references=(Signal("r_ref", "rad/s", "Desired yaw rate"), Signal("r_dot_ref", "rad/s2", "Its derivative")),
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"r": "r_ref"},
    noise={"beta": 0.004, "r": 0.01},
    step=0.01,
    divergence=0.5,
    rate=0.022,
    limit=0.009,
    omitted={"viscous": _OWN, "dry": _OWN},
)
