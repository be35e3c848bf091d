"""The controller FMUs of the quadrotor."""

from pythonfmu import DefaultExperiment

from ..kernel.blocks import Adaptive, ControllerSlave, StateVector
from ..kernel.description import VariableRow, input_variable, output, parameter
from . import equations
from .trajectory import Trajectory


def triple(make, name: str, unit: str, start, text: str, **bounds: float) -> tuple[VariableRow, ...]:
    """Return one variable for each axis."""
    return tuple(make(f"{name}_{a}", unit, s, f"{text} {a}", **bounds) for a, s in zip("xyz", start))


ZERO = (0.0, 0.0, 0.0)
GAINS = equations.Gains()
INERTIA = triple(
    parameter, "J", "kg.m2", (1.1, 1.1, 2.2), "Inertia the controller believes in, body", min=0.1, max=12.0
)
PARAMETERS = (
    parameter("m", "kg", 1.25, "Mass the controller believes in", min=0.5, max=4.0),
    *INERTIA,
    parameter("g", "m/s2", 9.81, "Gravity", min=0.0),
    *triple(parameter, "K_r", "N/m", GAINS.K_r, "Position gain, inertial", min=0.0),
    *triple(parameter, "K_v", "N.s/m", GAINS.K_v, "Velocity gain, inertial", min=0.0),
    *triple(parameter, "K_R", "N.m", GAINS.K_R, "Attitude gain, body", min=0.0),
    *triple(parameter, "K_Omega", "N.m.s/rad", GAINS.K_Omega, "Angular velocity gain, body", min=0.0),
)
POSITION = triple(input_variable, "r", "m", ZERO, "Measured position, inertial")
VELOCITY = triple(input_variable, "v", "m/s", ZERO, "Measured velocity, inertial")
ATTITUDE = tuple(
    input_variable(f"R_{i}{j}", "1", float(i == j), f"Measured attitude, row {i}, column {j}")
    for i in "123"
    for j in "123"
)
DESIRED_TO_ACCELERATION = (
    *triple(input_variable, "r_d", "m", ZERO, "Desired position, inertial"),
    *triple(input_variable, "v_d", "m/s", ZERO, "Desired velocity, inertial"),
    *triple(input_variable, "a_d", "m/s2", ZERO, "Desired acceleration, inertial"),
)
INPUTS = (
    *POSITION,
    *VELOCITY,
    *ATTITUDE,
    *triple(input_variable, "Omega", "rad/s", ZERO, "Measured angular velocity, body"),
    *DESIRED_TO_ACCELERATION,
    *triple(input_variable, "j_d", "m/s3", ZERO, "Desired jerk, inertial"),
    *triple(input_variable, "s_d", "m/s4", ZERO, "Desired snap, inertial"),
    input_variable("psi_d", "rad", 0.0, "Desired yaw"),
    input_variable("psi_d_dot", "rad/s", 0.0, "Desired yaw rate"),
    input_variable("psi_d_ddot", "rad/s2", 0.0, "Desired yaw acceleration"),
)
TRANSLATION = [v.name for v in (*POSITION, *VELOCITY, *ATTITUDE[2::3], *DESIRED_TO_ACCELERATION)]
COMMON = ("m", "g", *(f"{gain}_{a}" for gain in ("K_r", "K_v") for a in "xyz"))


class QuadrotorController(ControllerSlave):
    """Geometric tracking controller of Lee, Leok and McClamroch (2010), memoryless."""

    default_experiment = DefaultExperiment(0.0, 16.0, 0.01)
    table = (
        *PARAMETERS,
        *INPUTS,
        output("F", "N", "Thrust along -z of the body", depends=(*COMMON, *TRANSLATION), nominal=10.0),
        *(
            output(
                f"M_{a}", "N.m", f"Moment, body {a}",
                depends=(*COMMON, "J_x", "J_y", "J_z", f"K_R_{a}", f"K_Omega_{a}", *(v.name for v in INPUTS)),
            ) for a in "xyz"
        ),
    )  # fmt: skip

    def outputs(self, inputs: StateVector, parameters: StateVector) -> StateVector:
        """Return the control law's output. Raises ValueError where it is undefined."""
        i, p = inputs, parameters
        d = Trajectory(i[18:21], i[21:24], i[24:27], i[27:30], i[30:33], i[33], i[34], i[35])
        gains = equations.Gains(p[5:8], p[8:11], p[11:14], p[14:17])
        try:
            return equations.control(i[:18], d, p[0], p[1:4], p[4], gains)
        except ZeroDivisionError as error:
            raise ValueError(
                "desired attitude undefined: the commanded force is zero or along the heading; "
                "lower the reference's acceleration or the position and velocity gains."
            ) from error


class QuadrotorControllerAdaptive(Adaptive, QuadrotorController):
    """Geometric tracking controller of Lee, Leok and McClamroch (2010), with mass and inertia as inputs."""

    estimated = ("m", "J_x", "J_y", "J_z")
