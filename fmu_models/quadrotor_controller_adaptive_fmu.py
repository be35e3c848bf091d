"""Entry script of QuadrotorControllerAdaptive.fmu."""

from fmu_models.blocks import Adaptive
from fmu_models.quadrotor_controller_fmu import QuadrotorController


class QuadrotorControllerAdaptive(Adaptive, QuadrotorController):
    """Geometric tracking controller of Lee, Leok and McClamroch (2010), with mass and inertia as inputs."""

    estimated = ("m", "J_x", "J_y", "J_z")
