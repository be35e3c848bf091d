"""What runs in an FMU's own process: its Instance, and the answers to a FmuProcess's requests.

The process lives at most as long as the one that has started it: it ends when its channel or its standard input, which
is never written to, ends. Neither fmu_models nor pythonfmu is imported here: an FMU ships its own.
"""

import contextlib
import os
import shutil
import signal
import threading
from typing import Final, NoReturn

from ..errors import COLON, SlaveError
from ..fmi.bindings import load
from ..fmi.fmi2_co_simulation import Identity
from ..fmi.step_batch import take_steps
from .channel import CALL, FAULT, LOG, RESULT, Channel, StepCodec, decode, encode, open_channel
from .supervision.descendants import VARIABLE, adopt_orphans, end_marked, has_children
from .supervision.parent_death import end_after

_CALLS: Final = frozenset(
    {"bind", "initialize", "enter_initialization", "propagate", "exit_initialization", "get", "get_state", "set_state"}
    | {"close"}
)


LINES_A_CALL: Final = 100
"""Lines of an FMU's log that are passed on of one call."""


def main(channel_argument: str) -> NoReturn:
    """Serve one FMU to the process that started this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    adopt_orphans()
    channel = _Own(open_channel(channel_argument))
    lifeline = _take_over_standard_streams()
    end_after(lifeline)  # before the first message: it fails where the other side has ended already
    folder = None
    try:
        channel.send(encode(RESULT, None))
        identity = Identity(*decode(channel.receive(None))[0])
        folder = identity.folder
        threading.Thread(target=_end_with, args=(lifeline, folder), daemon=True).start()
        _serve(channel, identity)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        _leave(folder)
    except SlaveError as error:
        _report(channel, [error.function, error.time, error.reason, error.form])
    except Exception as error:  # whatever the FMU has caused, the other side must be told
        _report(channel, [None, None, f"{type(error).__name__}: {error}", COLON])
    _end_children()
    # Not sys.exit: the FMU may have damaged this interpreter, and its clean-up could hang or crash.
    os._exit(0)


def _serve(channel: Channel, identity: Identity) -> None:
    """Answer requests until the FMU is closed."""
    lines = _LogLines(channel)
    instance = load(identity, lines)
    channel.send(encode(RESULT, None))
    codec = StepCodec(0, 0, 0)
    while True:
        message = channel.receive(None)
        lines.n_left = LINES_A_CALL
        if message[0] != CALL:
            channel.send(codec.encode_values(instance.step(*codec.decode_step(message))))
            continue
        (function, arguments), blob = decode(message)
        if function == "restart":
            instance.close()
            instance = load(identity, lines)
            channel.send(encode(RESULT, None))
            continue
        if function == "many_steps":
            channel.send(encode(RESULT, None, take_steps(instance.step, blob or b"")))
            continue
        if function not in _CALLS:
            raise ValueError(f"no such call: {function!r}")
        result = getattr(instance, function)(*([blob] if blob is not None else arguments))
        if function == "bind":
            codec = StepCodec(*map(len, arguments))
        channel.send(encode(RESULT, None, result) if isinstance(result, bytes) else encode(RESULT, result))
        if function == "close":
            return


class _Own:
    """The channel, for this process only: a copy that the FMU has forked off ends where it would come to use it.

    Both would answer otherwise, and every answer after that would be one to an earlier question.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._process_id = os.getpid()

    def send(self, message: bytes) -> None:
        self._end_a_copy()
        self._channel.send(message)

    def receive(self, timeout_s: float | None) -> bytes:
        self._end_a_copy()
        return self._channel.receive(timeout_s)

    def hang_up(self) -> None:
        self._channel.hang_up()

    def close(self) -> None:
        self._channel.close()

    def _end_a_copy(self) -> None:
        if os.getpid() != self._process_id:
            os._exit(0)


class _LogLines:
    """Passes on at once what the FMU logs, so that it is known even if its process dies in the same call."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self.n_left = LINES_A_CALL

    def __call__(self, status: int, text: str) -> None:
        self.n_left -= 1
        if self.n_left < 0:
            return
        with contextlib.suppress(OSError):
            self._channel.send(encode(LOG, [status, text if self.n_left else "(what it logs after this is left out)"]))


def _end_children() -> None:
    """End what the FMU has started and left behind."""
    if has_children():
        end_marked(os.environ.get(VARIABLE, ""))


def _report(channel: Channel, fault: list[object]) -> None:
    with contextlib.suppress(OSError):
        channel.send(encode(FAULT, fault))


def _take_over_standard_streams() -> int:
    """Give the FMU an empty input and our standard error as output; returns what was the standard input."""
    lifeline = os.dup(0)
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)
    with contextlib.suppress(OSError):  # no standard error: output goes nowhere
        os.dup2(2, 1)
    return lifeline


def _end_with(lifeline: int, folder: str) -> None:
    """Wait for the end of the process that holds the other side of lifeline, however it comes, then end this one.

    The channel shows it too, but nobody looks there while the FMU computes, perhaps for ever. Where the FMU does
    not let this thread run `end_after` does it: then the FMU's folder is left to the next that unpacks one.
    """
    while os.read(lifeline, 1):
        pass
    _leave(folder)


def _leave(folder: str | None) -> NoReturn:
    """End; nobody else is left to remove the FMU's folder."""
    _end_children()
    if folder is not None:
        shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)
