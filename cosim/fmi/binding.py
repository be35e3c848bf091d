"""The life of an FMU in this process, whichever FMI version and interface its binding is for."""

from collections.abc import Sequence
from ctypes import c_int
from typing import Final, NamedTuple, Protocol, TypeAlias

from .types import Value
from .value_buffers import ScalarVariable

LARGEST_STATE: Final = (1 << 28) - (1 << 12)
"""Bytes of a serialised state that is still saved: it must fit into one message between two processes."""
WARNING: Final = 1
"""The status above which a call has failed."""
_STATUS: Final = ("ok", "warning", "discard", "error", "fatal", "pending")

StartValues: TypeAlias = Sequence[tuple[str, str, int, Value]]
"""Name, type, value reference and value of each variable that is set before initialization."""


class FmuToLoad(NamedTuple):
    """An FMU that is unpacked, and how to load it. It crosses to the FMU's process as a list."""

    folder: str
    """Folder that the FMU is unpacked into."""
    model_identifier: str
    guid: str
    instance_name: str
    has_plain_log: bool
    """True where log texts are plain text, not formats with arguments; see MessageLog."""
    fmi_version: str = "2.0"
    interface: str = "co-simulation"
    """'co-simulation', 'model-exchange', as a component that is integrated, or 'derivatives', as a function."""
    has_event_mode: bool = False
    """True for an FMI 3.0 co-simulation FMU that is used with its event mode."""
    tolerance: float | None = None
    """Relative tolerance for its own solver; None gives it none."""
    writes_bytecode: bool = False
    """True where Python may keep in the folder what it compiles of it; else the folder stays as it is."""


class Binding(Protocol):
    """One FMU, from loading to freeing.

    1. load                 loads and instantiates it
    2. bind                 names the variables that are set and got at communication points
    3. initialize           sets start values, passes initialization mode
    4. step, any number of times; in co-simulation get, get_state and set_state too
    5. close                terminates and frees it

    Every call raises SlaveError when the FMU returns anything but OK and Warning; it must not be called afterwards.
    """

    def bind(
        self, inputs: Sequence[ScalarVariable], tunables: Sequence[ScalarVariable], outputs: Sequence[ScalarVariable]
    ) -> None: ...
    def initialize(self, start: StartValues, start_time: float, stop_time: float | None) -> None: ...
    def step(
        self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None
    ) -> tuple[float, ...]: ...
    def close(self) -> None: ...


def failure(status: int, reason: str) -> str:
    """Return the meaning of a status other than OK and Warning in words, with the reason that was logged."""
    number = c_int(status).value
    word = _STATUS[number] if 0 <= number < len(_STATUS) else f"the illegal status {number}"
    return f"returned {word}{': ' if reason else ''}{reason}"
