"""The reference FMU of the quadrotor."""

from pythonfmu import DefaultExperiment

from ..kernel.blocks import ReferenceSlave, StateVector
from ..kernel.description import output, parameter
from .trajectory import sinusoid_trajectory

POSITION = (
    ("r_d", "m", "Desired position"),
    ("v_d", "m/s", "Desired velocity, the derivative of r_d"),
    ("a_d", "m/s2", "Desired acceleration, the second derivative of r_d"),
    ("j_d", "m/s3", "Desired jerk, the third derivative of r_d"),
    ("s_d", "m/s4", "Desired snap, the fourth derivative of r_d"),
)
YAW = ("time", "amplitude_x", "amplitude_y", "omega")


class QuadrotorReference(ReferenceSlave):
    """Desired position of a quadrotor, three sinusoids, to its fourth derivative, and yaw to its second."""

    default_experiment = DefaultExperiment(0.0, 16.0, 0.01)
    table = (
        parameter("amplitude_x", "m", 4.0, "Amplitude of x, at twice the angular frequency", min=0.0),
        parameter("amplitude_y", "m", 5.0, "Amplitude of y", min=1e-3),
        parameter("amplitude_z", "m", 2.0, "Amplitude of z", min=0.0),
        parameter("omega", "rad/s", 0.4, "Angular frequency", min=0.0),
        parameter("smooth_yaw", None, False, "Smooth branch of the yaw, not atan2(y, x), which jumps by pi"),
        *(
            output(f"{name}_{a}", unit, f"{text}, inertial {a}", depends=("time", f"amplitude_{a}", "omega"))
            for name, unit, text in POSITION
            for a in "xyz"
        ),
        output("psi_d", "rad", "Desired yaw", depends=(*YAW, "smooth_yaw")),
        output("psi_d_dot", "rad/s", "Desired yaw rate, the derivative of psi_d", depends=YAW),
        output("psi_d_ddot", "rad/s2", "Desired yaw acceleration, the second derivative of psi_d", depends=YAW),
    )

    def outputs(self, time: float, parameters: StateVector) -> StateVector:
        """Return position and derivatives, then yaw and derivatives."""
        *amplitudes, omega, smooth_yaw = parameters
        yaw = "smooth" if smooth_yaw else "paper"
        d = sinusoid_trajectory(time, tuple(amplitudes), omega, yaw)
        return (*d.r, *d.v, *d.a, *d.j, *d.s, d.psi, d.psi_dot, d.psi_ddot)
