"""The order in which a slave may be called: FMI 2.0.4, section 4.2.4, as far as a master needs it."""

from collections.abc import Callable
from enum import Enum
from typing import Any

from ..errors import SlaveError


class Phase(Enum):
    """Phase of an FMU's life; the value says which call leads to it."""

    INSTANTIATED = "must come before initialize"
    INITIALIZING = "must follow enter_initialization"
    RUNNING = "must follow initialize"


class LifeCycle:
    """Present phase of one slave. A call out of order raises RuntimeError, and does not reach the FMU."""

    def __init__(self, name: str) -> None:
        """name: the instance's."""
        self.phase = Phase.INSTANTIATED
        self.time: float | None = None
        """Present communication point [s]; None before initialization."""
        self.fault: SlaveError | None = None
        """The first failure of the FMU, after which it is not called again."""
        self._name = name
        self._is_closed = False
        self._end_of_step: float | None = None

    def check(self, function: str, phase: Phase) -> None:
        """Raise RuntimeError unless the slave is in that phase, and can be called."""
        self._check_usable()
        if self.phase is not phase:
            raise RuntimeError(f"{self._name}: {function} {phase.value}.")

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call the FMU, unless it is closed, has failed before, or is in a step; remember where it fails."""
        self._check_usable()
        try:
            return function(*arguments)
        except SlaveError as error:
            self.fault = error
            raise

    def step_begins(self, t: float, h: float) -> None:
        """Record that the FMU has been asked for a step from t to t + h [s]."""
        self.time, self._end_of_step = t, t + h

    def end_of_step(self) -> float:
        """Mark the step that has begun as ended, and return its end [s]. Raises RuntimeError without one."""
        end, self._end_of_step = self._end_of_step, None
        if end is None:
            raise RuntimeError(f"{self._name}: end_step must follow begin_step.")
        return end

    def close(self) -> None:
        """Refuse any further call."""
        self._is_closed = True

    def _check_usable(self) -> None:
        if self.fault is not None or self._is_closed:
            raise RuntimeError(f"{self._name} must not be called after {self.fault or 'close'}.")
        if self._end_of_step is not None:
            raise RuntimeError(f"{self._name}: begin_step must be followed by end_step.")
