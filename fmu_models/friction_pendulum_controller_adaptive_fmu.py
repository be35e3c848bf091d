"""Entry script of FrictionPendulumControllerAdaptive.fmu."""

from fmu_models.blocks import Adaptive
from fmu_models.friction_pendulum_controller_fmu import FrictionPendulumController


class FrictionPendulumControllerAdaptive(Adaptive, FrictionPendulumController):
    """Feedback-linearising controller of a pendulum with stiction, with what is estimated as inputs."""

    estimated = ("m", "l", "F_c", "F_s", "u_d")
