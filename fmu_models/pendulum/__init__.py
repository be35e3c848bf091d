"""Actuated planar pendulum with friction: its equations. The FMUs are in `plant`, `controller` and `reference`."""

from .equations import coefficients as coefficients
from .equations import control as control
from .equations import derivative as derivative
from .equations import regression as regression
