"""Drone in a vertical plane: height and roll by two rotors.

Mahony, Kumar and Corke (2012), "Multirotor aerial vehicles", IEEE Robotics and Automation Magazine 19.
State x = (z [m], v [m/s], phi [rad], omega [rad/s]): height and roll. The load is a vertical force [N].
"""

from math import cos

from .plant import Estimated, ForeignPlant, Signal, Values, total, wave

G = 9.81
MASS = 1.2
"""Mass [kg]."""
ARM = 0.2
"""Distance of a rotor from the centre [m]."""
HEIGHT, ROLL = 5.0, 14.0
"""Both poles of the height's error at -5 rad/s, both of the roll's at -14 rad/s."""


def derivative(x: Values, u: Values, k: float, J: float, load: float = 0.0) -> Values:
    """Return the time derivative of the state: 1.2 v_dot = k (u_1 + u_2) cos phi - 1.2 g + load.

    J omega_dot = 0.2 k (u_1 - u_2);  u: (squared speeds of the rotors [rad^2/s^2]);  k: thrust by it [N s^2/rad^2];
    J: inertia [kg m^2].
    """
    _, v, phi, omega = x
    lift = (k * (u[0] + u[1]) * cos(phi) + load) / MASS
    return (v, lift - G, omega, ARM * k * (u[0] - u[1]) / J)


def control(x: Values, reference: Values, k: float, J: float) -> Values:
    """Return the squared speeds of the law of computed torque."""
    z, v, phi, omega = x
    z_ref, phi_ref, v_ref, omega_ref, a_ref, alpha_ref = reference
    a = a_ref + 2.0 * HEIGHT * (v_ref - v) + HEIGHT**2 * (z_ref - z)
    alpha = alpha_ref + 2.0 * ROLL * (omega_ref - omega) + ROLL**2 * (phi_ref - phi)
    both, apart = MASS * (a + G) / (k * cos(phi)), J * alpha / (ARM * k)
    return (0.5 * (both + apart), 0.5 * (both - apart))


def reference(t: float) -> Values:
    """Return the desired height and roll, their rates and second derivatives."""
    z = total(wave(t, 0.4, 2.0, n=2), wave(t, 0.05, 6.0, n=2))
    phi = wave(t, 0.3, 4.0, 0.7, n=2)
    return (z[0], phi[0], z[1], phi[1], z[2], phi[2])


_BEGIN = reference(0.0)
PLANT = ForeignPlant(
    name="drone",
    title="Drone in a vertical plane",
    parameters=(
        Estimated("k", "N.s2/rad2", 1e-5, 0.78e-5, "Thrust by squared speed"),
        Estimated("J", "kg.m2", 0.015, 0.022, "Inertia of roll"),
    ),
    states=(
        Signal("z", "m", "Height", _BEGIN[0]),
        Signal("v", "m/s", "Its rate", _BEGIN[2]),
        Signal("phi", "rad", "Roll", _BEGIN[1]),
        Signal("omega", "rad/s", "Its rate", _BEGIN[3]),
    ),
    controls=(
        Signal("u_1", "rad2/s2", "Squared speed of the right rotor"),
        Signal("u_2", "rad2/s2", "Squared speed of the left rotor"),
    ),
    references=(
        Signal("z_ref", "m", "Desired height"),
        Signal("phi_ref", "rad", "Desired roll"),
        Signal("v_ref", "m/s", "Desired rate of the height"),
        Signal("omega_ref", "rad/s", "Desired rate of the roll"),
        Signal("a_ref", "m/s2", "Desired second derivative of the height"),
        Signal("alpha_ref", "rad/s2", "Desired second derivative of the roll"),
    ),
    derivative=derivative,
    control=control,
    reference=reference,
    tracked={"z": "z_ref", "phi": "phi_ref"},
    noise={"v": 0.03, "omega": 0.1},
    step=0.005,
    divergence=1.5,
    rate=8.9e5,
    limit=7e5,
    speed="v",
    pace=0.6,
    omitted={"limited-change": "the true parameters do not hold it either", "dry": "nothing rubs"},
)
