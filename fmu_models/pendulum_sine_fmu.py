"""Entry script of PendulumSine.fmu."""

from fmu_models import references
from fmu_models.blocks import Reference, Vector
from fmu_models.description import output, parameter

NEEDED = ("time", "amplitude_1", "omega_1", "amplitude_2", "omega_2")


class PendulumSine(Reference):
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

    def outputs(self, time: float, parameters: Vector) -> Vector:
        """Angle, angular velocity and angular acceleration."""
        amplitude_1, omega_1, amplitude_2, omega_2 = parameters
        first = references.sinusoid(time, amplitude_1, omega_1)
        second = references.sinusoid(time, amplitude_2, omega_2)
        return (first[0] + second[0], first[1] + second[1], first[2] + second[2])
