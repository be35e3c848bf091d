"""The plant FMU of the pendulum with stiction."""

from ..kernel.blocks import PlantSlave
from ..kernel.description import disturbance, input_variable, parameter, state
from . import equations

PARAMETERS = (
    parameter("m", "kg", 1.75, "Mass", min=0.1, max=5.0),
    parameter("l", "m", 0.75, "Length", min=0.1, max=3.0),
    parameter("F_c", "N", 1.0, "Coulomb friction, tangential", min=0.0),
    parameter("F_s", "N", 0.8, "Excess of the break-away force over Coulomb friction", min=0.0),
    parameter("u_d", "N", 2.0, "Half width of the actuator's dead band", min=0.0),
    parameter("b", "kg/s", 0.1, "Viscous friction", min=0.0),
    parameter("g", "m/s2", 9.81, "Gravity", min=0.0),
    parameter("phi_dot_s", "rad/s", 0.3, "Stribeck's velocity", min=1e-3),
    parameter("phi_dot_0", "rad/s", 0.01, "Half width of the band of velocity that sticks", min=0.0),
    parameter("tau", "s", 0.01, "Time constant at which the velocity decays where it sticks", min=1e-6),
)


class FrictionPendulum(PlantSlave):
    """Actuated planar pendulum with stiction and an actuator with a dead band; phi = 0 hangs down."""

    table = (
        *PARAMETERS,
        input_variable("u", "N", 3.0, "Tangential force commanded; starts beyond the dead band", nominal=10.0),
        disturbance("F_d", "N", "Disturbance force, tangential"),
        state("phi", "rad", 0.0, "Angle from hanging down", depends=("phi_dot",)),
        state(
            "phi_dot", "rad/s", 0.0, "Angular velocity",
            depends=(*(v.name for v in PARAMETERS), "u", "F_d", "phi", "phi_dot"),
        ),
    )  # fmt: skip
    derivative = staticmethod(equations.derivative)
