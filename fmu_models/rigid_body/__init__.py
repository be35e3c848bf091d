"""Free rigid body, its centre of mass off the origin: its equations. The FMUs are beside them."""

from .equations import TONES as TONES
from .equations import Gains as Gains
from .equations import Inertia as Inertia
from .equations import Motion as Motion
from .equations import State as State
from .equations import Wrench as Wrench
from .equations import control as control
from .equations import derivative as derivative
from .equations import matrix as matrix
from .equations import motion as motion
from .equations import solve as solve
