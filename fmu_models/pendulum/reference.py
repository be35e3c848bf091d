"""The reference FMUs of the pendulum."""

from math import pi

from ..kernel import references
from ..kernel.blocks import ReferenceSlave, StateVector
from ..kernel.description import output, parameter


class PendulumReference(ReferenceSlave):
    """Desired angle of a pendulum: a step from one angle to another."""

    table = (
        parameter("phi_initial", "rad", 0.0, "Angle before the step"),
        parameter("phi_final", "rad", pi / 3.0, "Angle from the step on"),
        parameter("step_time", "s", 1.0, "Time of the step"),
        output("phi_ref", "rad", "Desired angle", depends=("time", "phi_initial", "phi_final", "step_time")),
        output("phi_dot_ref", "rad/s", "Desired angular velocity, zero", depends=()),
    )

    def outputs(self, time: float, parameters: StateVector) -> StateVector:
        """Return angle and angular velocity."""
        return (references.step(time, *parameters), 0.0)


NEEDED = ("time", "amplitude_1", "omega_1", "amplitude_2", "omega_2")


class PendulumSine(ReferenceSlave):
    """Desired angle of a pendulum, the sum of two sinusoids, to its second derivative."""

    table = (
        parameter("amplitude_1", "rad", 0.15, "Amplitude of the first sinusoid"),
        parameter("omega_1", "rad/s", 1.5, "Angular frequency of the first sinusoid", min=0.0),
        parameter("amplitude_2", "rad", 0.08, "Amplitude of the second sinusoid"),
        parameter("omega_2", "rad/s", 6.0, "Angular frequency of the second sinusoid", min=0.0),
        output("phi_ref", "rad", "Desired angle", depends=NEEDED),
        output("phi_dot_ref", "rad/s", "Desired angular velocity, the derivative of phi_ref", depends=NEEDED),
        output("phi_ddot_ref", "rad/s2", "Desired angular acceleration, the derivative of phi_dot_ref",
               depends=NEEDED),
    )  # fmt: skip

    def outputs(self, time: float, parameters: StateVector) -> StateVector:
        """Return angle, angular velocity and angular acceleration."""
        amplitude_1, omega_1, amplitude_2, omega_2 = parameters
        first = references.sinusoid(time, amplitude_1, omega_1)
        second = references.sinusoid(time, amplitude_2, omega_2)
        return (first[0] + second[0], first[1] + second[1], first[2] + second[2])
