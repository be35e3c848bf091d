"""The plant FMU of magnetic levitation."""

from pythonfmu import DefaultExperiment

from ..kernel.blocks import PlantSlave
from ..kernel.description import disturbance, input_variable, parameter, state
from . import equations


class MagneticLevitation(PlantSlave):
    """Steel ball held below an electromagnet; the gap z grows downwards."""

    default_experiment = DefaultExperiment(0.0, 0.1, 0.001)
    table = (
        parameter("m", "kg", 0.1, "Mass", min=0.01, max=1.0),
        parameter("z_0", "m", 0.004, "Gap that iron and layers are worth", min=1e-4, max=0.05),
        parameter("k", "N.m2/A2", 2e-4, "Force times squared gap over squared current", min=0.0),
        parameter("g", "m/s2", 9.81, "Gravity", min=0.0),
        parameter("k_d", "kg/s", 0.0, "Linear drag", min=0.0),
        input_variable("i", "A", 0.98, "Current", nominal=1.0),
        disturbance("F_d", "N", "Disturbance force, downwards"),
        state("z", "m", 0.01, "Gap between magnet and ball", depends=("v",), nominal=0.01),
        state(
            "v", "m/s", 0.0, "Velocity, downwards",
            depends=("m", "z_0", "k", "g", "k_d", "i", "F_d", "z", "v"), nominal=0.1,
        ),
    )  # fmt: skip
    derivative = staticmethod(equations.derivative)
