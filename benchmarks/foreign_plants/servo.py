"""Servo drive of two masses on an elastic shaft: a motor turns a load.

State x = (theta_m [rad], omega_m [rad/s], theta_l [rad], omega_l [rad/s]): angles and speeds of motor and load. The
load from outside is a torque on the driven mass [N m].
"""

from .plant import Estimated, ForeignPlant, Signal, Values, total, wave

STIFFNESS = 10.0
"""Stiffness of the shaft [N m/rad]."""
POLE = 12.0
"""Four poles of the error at -12 rad/s."""


def derivative(x: Values, u: Values, J_m: float, J_l: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state, with the shaft's torque s = 10 (theta_m - theta_l).

    J_m omega_m_dot = u - s,  J_l omega_l_dot = s + load

    u: (torque of the motor [N m]);  J_m, J_l: inertia of motor and load [kg m^2].
    """
    shaft = STIFFNESS * (x[0] - x[2])
    return (x[1], (u[0] - shaft) / J_m, x[3], (shaft + load) / J_l)


def control(x: Values, reference: Values, J_m: float, J_l: float) -> Values:
    """Return the torque that makes the load's angle follow to its fourth derivative: feedback linearisation."""
    theta_m, omega_m, theta_l, omega_l = x
    shaft = STIFFNESS * (theta_m - theta_l)
    actual = (theta_l, omega_l, shaft / J_l, STIFFNESS * (omega_m - omega_l) / J_l)
    gains = (POLE**4, 4.0 * POLE**3, 6.0 * POLE**2, 4.0 * POLE)
    snap = reference[4] + sum(k * (r - y) for k, r, y in zip(gains, reference, actual))
    return (J_m * (snap * J_l / STIFFNESS + shaft / J_l) + shaft,)


def reference(t: float) -> Values:
    """Return the desired angle of the load to its fourth derivative."""
    return total(wave(t, 1.0, 2.0), wave(t, 0.2, 5.0))


_ANGLE, _SPEED, _ACCELERATION, _JERK, _ = reference(0.0)
_TWIST = 0.04 / STIFFNESS
PLANT = ForeignPlant(
    name="servo",
    title="Two masses on an elastic shaft",
    parameters=(
        Estimated("J_m", "kg.m2", 0.01, 0.015, "Inertia of the motor"),
        Estimated("J_l", "kg.m2", 0.04, 0.07, "Inertia of the load"),
    ),
    states=(
        Signal("theta_m", "rad", "Angle of the motor", _ANGLE + _TWIST * _ACCELERATION),
        Signal("omega_m", "rad/s", "Speed of the motor", _SPEED + _TWIST * _JERK),
        Signal("theta_l", "rad", "Angle of the load", _ANGLE),
        Signal("omega_l", "rad/s", "Speed of the load", _SPEED),
    ),
    controls=(Signal("u", "N.m", "Torque of the motor"),),
    references=(
        Signal("theta_ref", "rad", "Desired angle of the load"),
        Signal("omega_ref", "rad/s", "Desired speed"),
        Signal("alpha_ref", "rad/s2", "Desired acceleration"),
        Signal("jerk_ref", "rad/s3", "Desired derivative of the acceleration"),
        Signal("snap_ref", "rad/s4", "Desired second derivative of the acceleration"),
    ),
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"theta_l": "theta_ref"},
    noise={"omega_m": 0.05, "omega_l": 0.05},
    step=0.005,
    divergence=3.0,
    rate=1.35,
    limit=0.35,
    speed="omega_l",
    pace=2.0,
)
