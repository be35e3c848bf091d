"""Quadrotor on SE(3): its equations. The FMUs are in `plant`, `controller` and `reference`."""

from .equations import Attitude as Attitude
from .equations import Gains as Gains
from .equations import State as State
from .equations import coefficients as coefficients
from .equations import control as control
from .equations import derivative as derivative
from .equations import desired_attitude as desired_attitude
from .equations import regression as regression
from .trajectory import Trajectory as Trajectory
from .trajectory import sinusoid_trajectory as sinusoid_trajectory
