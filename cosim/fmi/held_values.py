"""Values kept beside an FMU's state that belong to it: time, next event and held inputs, saved and restored with it."""

import math
import struct
from typing import Final, NamedTuple, Self

MOST_EVENTS: Final = 100
"""Events at one time, and updates of the discrete states in one of them: a model that has more never ends."""
SLACK: Final = 1e-9
"""Share of a step by which an event may miss a communication point, from rounding, and still be at it."""
_HEAD: Final = struct.Struct("<ddq")


class HeldValues(NamedTuple):
    """Values that hold from one communication point, or event, to the next."""

    time: float = 0.0
    """Time reached [s]."""
    next_event: float = math.inf
    """Time of the next event that the FMU has announced [s]; infinite without one."""
    inputs: tuple[float, ...] | None = None
    """Inputs set last; None: none yet."""

    def joined(self, state: bytes) -> bytes:
        """Return these values and an FMU's state in one."""
        n = -1 if self.inputs is None else len(self.inputs)
        values = struct.pack(f"<{max(n, 0)}d", *self.inputs or ())
        return _HEAD.pack(self.time, self.next_event, n) + values + state

    @classmethod
    def split(cls, joined: bytes) -> tuple[Self, bytes]:
        """Return the values and the FMU's state of which `joined` was made."""
        time, next_event, n = _HEAD.unpack_from(joined)
        values = struct.Struct(f"<{max(n, 0)}d")
        inputs = None if n < 0 else values.unpack_from(joined, _HEAD.size)
        return cls(time, next_event, inputs), joined[_HEAD.size + values.size :]
