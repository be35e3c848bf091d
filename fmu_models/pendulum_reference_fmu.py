"""Entry script of PendulumReference.fmu."""

from math import pi

from fmu_models import references
from fmu_models.blocks import Reference, Vector
from fmu_models.description import output, parameter


class PendulumReference(Reference):
    """Desired angle of a pendulum: a step from one angle to another."""

    table = (
        parameter("phi_initial", "rad", 0.0, "Angle before the step"),
        parameter("phi_final", "rad", pi / 3.0, "Angle from the step on"),
        parameter("step_time", "s", 1.0, "Time of the step"),
        output("phi_ref", "rad", "Desired angle", depends=("time", "phi_initial", "phi_final", "step_time")),
        output("phi_dot_ref", "rad/s", "Desired angular velocity, zero", depends=()),
    )

    def outputs(self, time: float, parameters: Vector) -> Vector:
        """Angle and angular velocity."""
        return (references.step(time, *parameters), 0.0)
