"""What can go wrong between us and the world, always told in one line."""

import errno
from collections.abc import Callable
from typing import Final

_LONGEST_REASON = 400  # characters; an FMU may log a whole page

AFTER_THE_CALL = "{call} {reason}"
"""plant: do_step at t = 1.250 s returned discard"""
COLON = "{call}: {reason}"
"""plant: get at t = 0.020 s: output 'y' is nan"""
IN_THE_CALL = "{reason} in {call}"
"""plant: the FMU's process ended with exit code 0 in do_step at t = 0.050 s"""

_NO_ROOM: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
_FORMS = (AFTER_THE_CALL, COLON, IN_THE_CALL)


class CosimError(Exception):
    """A co-simulation cannot go on, through no fault of the calling code."""


class ModelDescriptionError(CosimError):
    """A file is not an FMU that can be used here."""


class WiringError(CosimError):
    """Variables are joined or set that the FMUs do not have or do not allow."""


class ScenarioError(CosimError):
    """A scenario file is not understood."""


class SspError(CosimError):
    """An SSP package, or a parameter file of that standard, is not understood."""


class UnfinishedError(CosimError):
    """A run cannot be recorded any further, through no fault of what was asked for."""


class NotResumableError(CosimError):
    """A run cannot go on from a checkpoint. The message is the reason, without a full stop."""


class SlaveError(CosimError):
    """A running FMU failed."""

    instance: str
    """Name of the instance, such as 'plant'."""
    function: str
    """The FMI function without its prefix, such as 'do_step'."""
    time: float | None
    """Communication point [s]; None before the experiment has a time."""
    reason: str
    """What happened, in one line."""

    def __init__(
        self, instance: str, function: str, time: float | None, reason: str, form: str = AFTER_THE_CALL
    ) -> None:
        """form places call and reason in the message, one of the three above.

        Raises ValueError for any other form: it would be a format string of unknown origin.
        """
        if form not in _FORMS:
            raise ValueError(f"form must be one of {_FORMS}, got {form!r}.")
        self.instance = instance
        self.function = function
        self.time = time
        self.reason = one_line(reason)
        self.form = form
        call = function if time is None else f"{function} at t = {seconds(time)} s"
        super().__init__(f"{instance}: " + form.format(call=call, reason=self.reason))

    def __reduce__(self) -> tuple[Callable[..., "SlaveError"], tuple[object, ...]]:
        return SlaveError, (self.instance, self.function, self.time, self.reason, self.form)


class StateTooLargeError(SlaveError):
    """An FMU's state cannot be saved for its size. Nothing else has come of it: the FMU can go on."""


def is_refusal(error: Exception) -> bool:
    """Whether something was refused; else it could not be finished, for want of room on the disk if nothing else."""
    cause = error.__cause__
    has_no_room = isinstance(cause, OSError) and cause.errno in _NO_ROOM
    return isinstance(error, CosimError) and not isinstance(error, UnfinishedError) and not has_no_room


def one_line(text: str, longest: int = _LONGEST_REASON) -> str:
    """text without line breaks or control characters, cut to a readable length."""
    line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return line if len(line) <= longest else line[: longest - 3] + "..."


def seconds(time: float) -> str:
    """time [s] to the millisecond, or with as many digits as it needs."""
    text = f"{time:.3f}"
    return text if abs(float(text) - time) <= 1e-9 else f"{time:.9g}"


class FolderError(CosimError):
    """A run folder cannot be made, written or read."""
