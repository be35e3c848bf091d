"""The plant FMU of the pendulum."""

from ..kernel.blocks import PlantSlave
from ..kernel.description import disturbance, input_variable, parameter, state
from . import equations


class Pendulum(PlantSlave):
    """Actuated planar pendulum with friction; phi = 0 hangs down."""

    table = (
        parameter("m", "kg", 1.75, "Mass", min=0.1, max=5.0),
        parameter("l", "m", 0.75, "Length", min=0.1, max=3.0),
        parameter("b", "kg/s", 0.1, "Friction", min=0.0),
        parameter("g", "m/s2", 9.81, "Gravity", min=0.0),
        parameter("F_c", "N", 0.0, "Dry friction, tangential", min=0.0),
        input_variable("u", "N", 0.0, "Tangential force", nominal=10.0),
        disturbance("F_d", "N", "Disturbance force, tangential"),
        state("phi", "rad", 0.5, "Angle from hanging down", depends=("phi_dot",)),
        state(
            "phi_dot", "rad/s", 0.0, "Angular velocity",
            depends=("m", "l", "b", "g", "F_c", "u", "F_d", "phi", "phi_dot"),
        ),
    )  # fmt: skip
    derivative = staticmethod(equations.derivative)
