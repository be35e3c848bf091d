"""The controller FMUs of the rigid body."""

from pythonfmu import DefaultExperiment

from ..kernel.blocks import Adaptive, ControllerSlave, StateVector
from ..kernel.description import input_variable, output, parameter
from . import equations

GAINS = equations.Gains()
C = tuple(
    parameter(f"c_{a}", "m", 0.0, f"Centre of mass the controller believes in, body {a}", min=-0.3, max=0.3)
    for a in "xyz"
)
INERTIA = (
    *(
        parameter(f"J_{a}{a}", "kg.m2", s, f"Inertia the controller believes in, body {a}", min=0.1, max=12.0)
        for a, s in zip("xyz", (0.3, 0.4, 0.5))
    ),
    *(
        parameter(f"J_{ab}", "kg.m2", 0.0, f"Element {ab} of the inertia the controller believes in", min=-2.0, max=2.0)
        for ab in ("xy", "xz", "yz")
    ),
)
FORCE_PARAMETERS = (
    parameter("m", "kg", 2.5, "Mass the controller believes in", min=0.5, max=8.0),
    *C,
    parameter("g", "m/s2", 9.81, "Gravity", min=0.0),
    parameter("K_r", "1/s2", GAINS.K_r, "Position gain", min=0.0),
    parameter("K_v", "1/s", GAINS.K_v, "Velocity gain", min=0.0),
    parameter("K_R", "1/s2", GAINS.K_R, "Attitude gain", min=0.0),
    parameter("K_Omega", "1/s", GAINS.K_Omega, "Angular velocity gain", min=0.0),
)


def motion_inputs(suffix: str, text: str) -> tuple:
    """Return the inputs position, velocity, attitude and angular velocity, measured or desired."""
    return (
        *(input_variable(f"r{suffix}_{a}", "m", 0.0, f"{text} position, inertial {a}") for a in "xyz"),
        *(input_variable(f"v{suffix}_{a}", "m/s", 0.0, f"{text} velocity, inertial {a}") for a in "xyz"),
        *(
            input_variable(f"R{suffix}_{i}{j}", "1", float(i == j), f"{text} attitude, row {i}, column {j}")
            for i in "123"
            for j in "123"
        ),
        *(input_variable(f"Omega{suffix}_{a}", "rad/s", 0.0, f"{text} angular velocity, body {a}") for a in "xyz"),
    )


INPUTS = (
    *motion_inputs("", "Measured"),
    *motion_inputs("_d", "Desired"),
    *(input_variable(f"a_d_{a}", "m/s2", 0.0, f"Desired acceleration, inertial {a}") for a in "xyz"),
    *(input_variable(f"Omega_dot_d_{a}", "rad/s2", 0.0, f"Desired angular acceleration, body {a}") for a in "xyz"),
)
COMMON = [v.name for v in (*FORCE_PARAMETERS, *INPUTS)]


class RigidBodyController(ControllerSlave):
    """Computed-torque controller of a free rigid body on SE(3), memoryless."""

    default_experiment = DefaultExperiment(0.0, 10.0, 0.01)
    table = (
        *FORCE_PARAMETERS,
        *INERTIA,
        *INPUTS,
        *(output(f"F_{a}", "N", f"Force at the origin, body {a}", depends=COMMON, nominal=10.0) for a in "xyz"),
        *(
            output(f"M_{a}", "N.m", f"Moment about the origin, body {a}", depends=[*COMMON, *(v.name for v in INERTIA)])
            for a in "xyz"
        ),
    )

    def outputs(self, inputs: StateVector, parameters: StateVector) -> StateVector:
        """Return the control law's output."""
        i, p = inputs, parameters
        d = equations.Motion(i[18:21], i[21:24], i[36:39], i[24:33], i[33:36], i[39:42])
        return equations.control(i[:18], d, p[0], p[1:4], p[9:15], p[4], equations.Gains(*p[5:9]))


class RigidBodyControllerAdaptive(Adaptive, RigidBodyController):
    """Computed-torque controller of a free rigid body on SE(3), with its ten inertial parameters as inputs."""

    estimated = ("m", *(v.name for v in (*C, *INERTIA)))
