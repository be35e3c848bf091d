"""The controller FMUs of the pendulum with stiction."""

from ..kernel.blocks import Adaptive, ControllerSlave, StateVector
from ..kernel.description import input_variable, output, parameter
from . import equations

PARAMETERS = (
    parameter("m", "kg", 1.75, "Mass the controller believes in", min=0.1, max=5.0),
    parameter("l", "m", 0.75, "Length the controller believes in", min=0.1, max=3.0),
    parameter("F_c", "N", 1.0, "Coulomb friction the controller believes in", min=0.0),
    parameter("F_s", "N", 0.8, "Excess of the break-away force the controller believes in", min=0.0),
    parameter("u_d", "N", 2.0, "Half width of the dead band the controller believes in", min=0.0),
    parameter("b", "kg/s", 0.1, "Viscous friction the controller believes in", min=0.0),
    parameter("g", "m/s2", 9.81, "Gravity", min=0.0),
    parameter("phi_dot_s", "rad/s", 0.3, "Stribeck's velocity the controller believes in", min=1e-3),
    parameter("Kp", "1/s2", 10.0, "Gain on the angle error", min=0.0),
    parameter("Kd", "1/s", 5.0, "Gain on the angular velocity error", min=0.0),
    parameter("phi_dot_w", "rad/s", 0.02, "Half width of the ramp of the friction's sign", min=1e-6),
    parameter("F_w", "N", 0.05, "Half width of the ramp of the dead band's sign", min=1e-6),
)
INPUTS = (
    input_variable("phi", "rad", 0.0, "Measured angle from hanging down"),
    input_variable("phi_dot", "rad/s", 0.0, "Measured angular velocity"),
    input_variable("phi_ref", "rad", 0.0, "Desired angle"),
    input_variable("phi_dot_ref", "rad/s", 0.0, "Desired angular velocity"),
    input_variable("phi_ddot_ref", "rad/s2", 0.0, "Desired angular acceleration"),
)


class FrictionPendulumController(ControllerSlave):
    """Feedback-linearising controller of a pendulum with stiction and a dead band, memoryless."""

    table = (
        *PARAMETERS,
        *INPUTS,
        output("u", "N", "Tangential force", depends=[v.name for v in (*PARAMETERS, *INPUTS)], nominal=10.0),
    )

    def outputs(self, inputs: StateVector, parameters: StateVector) -> StateVector:
        """Return the control law's output."""
        return (equations.control(inputs[0:2], inputs[2:5], *parameters),)


class FrictionPendulumControllerAdaptive(Adaptive, FrictionPendulumController):
    """Feedback-linearising controller of a pendulum with stiction, with what is estimated as inputs."""

    estimated = ("m", "l", "F_c", "F_s", "u_d")
