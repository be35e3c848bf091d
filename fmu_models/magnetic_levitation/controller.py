"""The controller FMUs of magnetic levitation."""

from pythonfmu import DefaultExperiment

from ..kernel.blocks import Adaptive, ControllerSlave, StateVector
from ..kernel.description import input_variable, output, parameter
from . import equations

PARAMETERS = (
    parameter("m", "kg", 0.1, "Mass the controller believes in", min=0.01, max=1.0),
    parameter("z_0", "m", 0.004, "Gap that iron and layers are worth, as the controller believes", min=1e-4, max=0.05),
    parameter("k", "N.m2/A2", 2e-4, "Force times squared gap over squared current", min=1e-9),
    parameter("g", "m/s2", 9.81, "Gravity", min=0.0),
    parameter("K_p", "1/s2", 1600.0, "Gain on the gap error", min=0.0),
    parameter("K_d", "1/s", 80.0, "Gain on the velocity error", min=0.0),
    parameter("i_max", "A", 3.0, "Largest current", min=0.0),
)
INPUTS = (
    input_variable("z", "m", 0.01, "Measured gap", nominal=0.01),
    input_variable("v", "m/s", 0.0, "Measured velocity, downwards", nominal=0.1),
    input_variable("z_ref", "m", 0.01, "Desired gap", nominal=0.01),
    input_variable("v_ref", "m/s", 0.0, "Desired velocity", nominal=0.1),
    input_variable("v_dot_ref", "m/s2", 0.0, "Desired acceleration"),
)


class MagneticLevitationController(ControllerSlave):
    """Feedback-linearising controller of a ball below an electromagnet, memoryless."""

    default_experiment = DefaultExperiment(0.0, 3.0, 0.001)
    table = (
        *PARAMETERS,
        *INPUTS,
        output("i", "A", "Current", depends=[v.name for v in (*PARAMETERS, *INPUTS)], nominal=1.0),
    )

    def outputs(self, inputs: StateVector, parameters: StateVector) -> StateVector:
        """Return the control law's output."""
        return (equations.control(inputs[0:2], inputs[2:5], *parameters),)


class MagneticLevitationControllerAdaptive(Adaptive, MagneticLevitationController):
    """Feedback-linearising controller of a ball below an electromagnet, with what is estimated as inputs."""

    estimated = ("m", "z_0")
