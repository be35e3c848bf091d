"""Entry script of PendulumControllerAdaptive.fmu."""

from fmu_models.blocks import Adaptive
from fmu_models.pendulum_controller_fmu import PendulumController


class PendulumControllerAdaptive(Adaptive, PendulumController):
    """Feedback-linearising controller of an actuated pendulum, with its mass and length as inputs."""

    estimated = ("m", "l")
