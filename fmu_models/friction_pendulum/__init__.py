"""Actuated planar pendulum with stiction and a dead band: its equations. The FMUs are in `plant` and `controller`."""

from .equations import control as control
from .equations import dead_band as dead_band
from .equations import derivative as derivative
from .equations import stribeck as stribeck
