"""The controller FMUs of the pendulum."""

from ..kernel.blocks import Adaptive, ControllerSlave, StateVector
from ..kernel.description import input_variable, output, parameter
from . import equations

PARAMETERS = (
    parameter("m", "kg", 1.75, "Mass the controller believes in", min=0.1, max=5.0),
    parameter("l", "m", 0.75, "Length the controller believes in", min=0.1, max=3.0),
    parameter("b", "kg/s", 0.1, "Friction the controller believes in", min=0.0),
    parameter("g", "m/s2", 9.81, "Gravity", min=0.0),
    parameter("Kp", "1/s2", 10.0, "Gain on the angle error", min=0.0),
    parameter("Kd", "1/s", 5.0, "Gain on the angular velocity error", min=0.0),
)
INPUTS = (
    input_variable("phi", "rad", 0.0, "Measured angle from hanging down"),
    input_variable("phi_dot", "rad/s", 0.0, "Measured angular velocity"),
    input_variable("phi_ref", "rad", 0.0, "Desired angle"),
    input_variable("phi_dot_ref", "rad/s", 0.0, "Desired angular velocity"),
)


class PendulumController(ControllerSlave):
    """Feedback-linearising controller of an actuated pendulum, memoryless."""

    table = (
        *PARAMETERS,
        *INPUTS,
        output("u", "N", "Tangential force", depends=[v.name for v in (*PARAMETERS, *INPUTS)], nominal=10.0),
    )

    def outputs(self, inputs: StateVector, parameters: StateVector) -> StateVector:
        """Return the control law's output."""
        return (equations.control(inputs[0:2], inputs[2:4], *parameters),)


class PendulumControllerAdaptive(Adaptive, PendulumController):
    """Feedback-linearising controller of an actuated pendulum, with its mass and length as inputs."""

    estimated = ("m", "l")
