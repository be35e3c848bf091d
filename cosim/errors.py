"""Exceptions of the package; the message of each is one line."""

import errno
from collections.abc import Callable, Generator
from contextlib import contextmanager
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
    """Base class of errors that are no fault of the calling code and end a co-simulation."""


class ModelDescriptionError(CosimError):
    """Error for a file that is not an FMU, or not one that can be used here."""


class WiringError(CosimError):
    """Error for variables that are connected or set, but that the FMUs lack or do not allow to be so."""


class ScenarioError(CosimError):
    """Error for a scenario that is not valid."""


@contextmanager
def told_at(place: str) -> Generator[None]:
    """Put a place, a scenario's key or its file, before what an error about it says."""
    try:
        yield
    except (ModelDescriptionError, ScenarioError, WiringError) as e:
        e.args = (f"{place}: {e}",)  # the same error: its traceback and cause stay
        raise


class SspError(CosimError):
    """Error for an SSP package, or a parameter file of that standard, that is not valid."""


class UnfinishedError(CosimError):
    """Error for a run that cannot be recorded any further, though its input was valid."""


class NotResumableError(CosimError):
    """Error for a run that cannot be resumed. The message is the reason, without a full stop."""


class SlaveError(CosimError):
    """Failure of a running FMU."""

    instance: str
    """Name of the instance, such as 'plant'."""
    function: str
    """The FMI function without its prefix, such as 'do_step'."""
    time: float | None
    """Communication point [s]; None before the experiment has a time."""
    reason: str
    """Reason of the failure, in one line."""

    def __init__(
        self, instance: str, function: str, time: float | None, reason: str, form: str = AFTER_THE_CALL
    ) -> None:
        """form: places call and reason in the message; one of the three above.

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
    """Error for an FMU state that is too large to be saved. The FMU itself can go on."""


def is_refusal(error: Exception) -> bool:
    """Return whether the error refuses the input; otherwise the work could not be finished, as on a full disk."""
    cause = error.__cause__
    has_no_room = isinstance(cause, OSError) and cause.errno in _NO_ROOM
    return isinstance(error, CosimError) and not isinstance(error, UnfinishedError) and not has_no_room


def one_line(text: str, longest: int = _LONGEST_REASON) -> str:
    """Return text without line breaks or control characters, cut to a readable length."""
    line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return line if len(line) <= longest else line[: longest - 3] + "..."


def seconds(time: float) -> str:
    """Return time [s] as text, to the millisecond or with as many digits as it needs."""
    text = f"{time:.3f}"
    return text if abs(float(text) - time) <= 1e-9 else f"{time:.9g}"


class FolderError(CosimError):
    """Error for a folder, such as a run folder, that cannot be made, written or read."""
