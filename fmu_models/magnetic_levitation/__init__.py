"""Steel ball held below an electromagnet: its equations. The FMUs are in `plant`, `controller` and `reference`."""

from .equations import control as control
from .equations import derivative as derivative
