"""Entry script of RigidBodyControllerAdaptive.fmu."""

from fmu_models.blocks import Adaptive
from fmu_models.rigid_body_controller_fmu import INERTIA, C, RigidBodyController


class RigidBodyControllerAdaptive(Adaptive, RigidBodyController):
    """Computed-torque controller of a free rigid body on SE(3), with its ten inertial parameters as inputs."""

    estimated = ("m", *(v.name for v in (*C, *INERTIA)))
