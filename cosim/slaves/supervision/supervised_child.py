"""An FMU's process under supervision, seen from inside: it ends with its parent, and leaves nothing behind."""

import contextlib
import os
import shutil
import signal
import threading
from typing import NoReturn

from .descendants import VARIABLE, adopt_orphans, end_marked, has_children
from .parent_death import end_after


class SupervisedChild:
    """This process, supervised: it lives at most as long as the one that has started it.

    1. SupervisedChild      takes over the standard streams, ignores Ctrl-C, and ends after its parent (Linux)
    2. end_with_parent      ends it at once with its parent, and removes the FMU's folder then
    3. leave                ends it, with all that the FMU has started

    Its standard input, which is never written to, ends with its parent.
    """

    def __init__(self) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        adopt_orphans()
        self._folder: str | None = None
        self._parent = _take_over_standard_streams()
        end_after(self._parent)

    def end_with_parent(self, folder: str) -> None:
        """Wait in a thread for the parent's end, to remove the FMU's folder then and end.

        The channel shows that end too, but nobody looks there while the FMU computes, perhaps for ever. Where the FMU
        lets no thread run `end_after` ends this process: then the folder is left to the next that unpacks an FMU.
        """
        self._folder = folder
        threading.Thread(target=self._wait_for_parents_end, daemon=True).start()

    def leave(self, is_orphaned: bool = False) -> NoReturn:
        """End this process and what the FMU has started; if its parent has ended, also remove the FMU's folder."""
        if has_children():
            end_marked(os.environ.get(VARIABLE, ""))
        if is_orphaned and self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
        # Not sys.exit: the FMU may have damaged this interpreter, and its clean-up could hang or crash.
        os._exit(0)

    def _wait_for_parents_end(self) -> None:
        while os.read(self._parent, 1):
            pass
        self.leave(is_orphaned=True)


def _take_over_standard_streams() -> int:
    """Give the FMU an empty input and standard error as its output; return what was the standard input."""
    parent = os.dup(0)
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)
    with contextlib.suppress(OSError):  # no standard error: output goes nowhere
        os.dup2(2, 1)
    return parent
