"""Messages between this process and an FMU's process: channels that carry bytes, and what the bytes mean.

A channel keeps message borders and says at once when the other side has died. On Linux it is a pair of
AF_UNIX SOCK_SEQPACKET sockets (a third of the round trip of a stream with length prefixes); elsewhere a
multiprocessing pipe. The content is JSON, raw bytes and IEEE doubles: nothing from an FMU's process is unpickled.
"""

import contextlib
import json
import os
import socket
import struct
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

if TYPE_CHECKING:
    from multiprocessing.connection import Connection  # at run time only where there are pipes

PACKET_SIZE: Final = 32768
"""Bytes of one packet; longer messages travel in pieces."""
LARGEST_MESSAGE: Final = 1 << 28
"""Bytes; an announced length above it is a fault of the sender."""

_LENGTH = struct.Struct("<Q")
_TIMEVAL = struct.Struct("@ll")


class Channel(Protocol):
    """One end of a two-way connection between two processes."""

    def send(self, message: bytes) -> None:
        """Send one message of at least one byte. Raises OSError when the other side is gone."""
        ...

    def receive(self, timeout_s: float | None) -> bytes:
        """Return the next message. Raises TimeoutError, EOFError when the other side is gone, OSError."""
        ...

    def hang_up(self) -> None:
        """Make a receive at this end, in any thread, see the end after pending messages; the other side may go on."""
        ...

    def close(self) -> None:
        """Close this end; idempotent."""
        ...


class PacketChannel:
    """A channel on a SOCK_SEQPACKET socket.

    A message shorter than PACKET_SIZE is one packet. A longer one starts with a packet of exactly PACKET_SIZE bytes,
    its total length (uint64) first, and ends when that many bytes have arrived.
    """

    def __init__(self, sock: socket.socket) -> None:
        sock.setblocking(True)
        self._socket = sock
        self._timeout_s: float | None = None

    def send(self, message: bytes) -> None:
        if not message:
            raise ValueError("message must not be empty: an empty packet means the end.")
        if len(message) < PACKET_SIZE:
            self._socket.send(message, socket.MSG_NOSIGNAL)
            return
        whole = _LENGTH.pack(len(message)) + message
        for start in range(0, len(whole), PACKET_SIZE):
            self._socket.send(whole[start : start + PACKET_SIZE], socket.MSG_NOSIGNAL)

    def receive(self, timeout_s: float | None) -> bytes:
        # The kernel keeps the time (SO_RCVTIMEO): a poll before each recv would be one system call more.
        # Nor is there a spin before it: runs a quarter faster on an idle machine, seven times slower on a busy one.
        if timeout_s != self._timeout_s:
            self._set_timeout(timeout_s)
        packet = self._packet()
        return packet if len(packet) < PACKET_SIZE else self._rest(packet, timeout_s)

    def hang_up(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._socket.close()

    def _set_timeout(self, timeout_s: float | None) -> None:
        microseconds = 0 if timeout_s is None else max(1, round(timeout_s * 1e6))
        value = _TIMEVAL.pack(*divmod(microseconds, 1_000_000))
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, value)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, value)
        self._timeout_s = timeout_s

    def _packet(self) -> bytes:
        try:
            packet = self._socket.recv(PACKET_SIZE)
        except BlockingIOError:
            raise TimeoutError(f"no message within {self._timeout_s} s") from None
        except ConnectionError as error:
            raise EOFError("the other side has closed the channel") from error
        if not packet:
            raise EOFError("the other side has closed the channel")
        return packet

    def _rest(self, first: bytes, timeout_s: float | None) -> bytes:
        (length,) = _LENGTH.unpack_from(first)
        if not PACKET_SIZE <= length <= LARGEST_MESSAGE:
            raise OSError(f"a message of {length} bytes was announced, the largest is {LARGEST_MESSAGE}")
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        message = bytearray(memoryview(first)[_LENGTH.size :])
        while len(message) < length:
            if deadline is not None and time.monotonic() > deadline:
                raise TimeoutError(f"no whole message within {timeout_s} s")
            message += self._packet()
        return bytes(message)


class PipeChannel:
    """A channel on a multiprocessing connection, used as a carrier of bytes only."""

    def __init__(self, connection: "Connection[bytes, bytes]") -> None:
        self._connection = connection

    def send(self, message: bytes) -> None:
        if not message:
            raise ValueError("message must not be empty: an empty packet means the end.")
        self._connection.send_bytes(message)

    def receive(self, timeout_s: float | None) -> bytes:
        try:
            if not self._connection.poll(timeout_s):
                raise TimeoutError(f"no message within {timeout_s} s")
            return self._connection.recv_bytes(LARGEST_MESSAGE)
        except (BrokenPipeError, ConnectionResetError) as error:
            raise EOFError("the other side has closed the channel") from error

    def hang_up(self) -> None:
        """Do nothing: a wait on a pipe goes on to its limit."""

    def close(self) -> None:
        self._connection.close()


KIND: Final = "packet" if sys.platform == "linux" and hasattr(socket, "SOCK_SEQPACKET") else "pipe"
"""Default kind of channel_pair: chosen once, when this module is imported."""


@dataclass(frozen=True)
class ChildEnd:
    """End of a channel passed to a child process. The parent closes its copy after the start."""

    argument: str
    """Argument of open_channel in the child."""
    handle: int
    """File descriptor, or Windows handle, that the child has to inherit."""
    owner: "socket.socket | Connection[bytes, bytes]"
    """Object that closes the parent's copy."""

    @property
    def is_packet(self) -> bool:
        """True for an end of a PacketChannel, which may be passed to a process that runs already."""
        return self.argument.startswith("packet:")

    def popen_arguments(self) -> dict[str, Any]:
        """Return keyword arguments of subprocess.Popen that let the child inherit the handle, and nothing else."""
        if sys.platform != "win32":
            return {"pass_fds": (self.handle,)}
        import subprocess

        os.set_handle_inheritable(self.handle, True)
        return {"startupinfo": subprocess.STARTUPINFO(lpAttributeList={"handle_list": [self.handle]})}

    def close(self) -> None:
        self.owner.close()


def channel_pair(kind: str = KIND) -> tuple[Channel, ChildEnd]:
    """Return this process's channel and the end for a child; kind is 'packet' or 'pipe'."""
    if kind == "packet":
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        return PacketChannel(ours), ChildEnd(f"packet:{theirs.fileno()}", theirs.fileno(), theirs)
    from multiprocessing.connection import Pipe

    mine, other = Pipe(duplex=True)
    return PipeChannel(mine), ChildEnd(f"pipe:{other.fileno()}", other.fileno(), other)


def open_channel(argument: str) -> Channel:
    """Open the child's channel, from its ChildEnd's argument. Grandchildren do not inherit it."""
    kind, _, number = argument.partition(":")
    handle = int(number)
    if kind == "packet":
        os.set_inheritable(handle, False)
        return PacketChannel(socket.socket(fileno=handle))
    if sys.platform == "win32":
        from multiprocessing.connection import PipeConnection

        os.set_handle_inheritable(handle, False)
        return PipeChannel(PipeConnection(handle))
    from multiprocessing.connection import Connection

    os.set_inheritable(handle, False)
    return PipeChannel(Connection(handle))


# The first byte of a message.
STEP, STEP_TUNED, CALL = 1, 2, 3  # requests
VALUES, RESULT, FAULT = 16, 17, 18  # replies
LOG = 32  # a line that the FMU logs, before the reply
ALIVE = 33  # before the reply to many calls: the one just ended was in time

_HEAD = struct.Struct("<BI")


class StepCodec:
    """The codec for messages of a step, all doubles: kind, t, h, inputs, tunables one way; kind, outputs the other."""

    def __init__(self, n_inputs: int, n_tunables: int, n_outputs: int) -> None:
        self._n_inputs = n_inputs
        self._step = struct.Struct(f"<B{2 + n_inputs}d")
        self._step_tuned = struct.Struct(f"<B{2 + n_inputs + n_tunables}d")
        self._values = struct.Struct(f"<B{n_outputs}d")

    def encode_step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> bytes:
        """Return the message of a step. Raises struct.error when the numbers of values are not those bound."""
        if tunables is None:
            return self._step.pack(STEP, t, h, *inputs)
        return self._step_tuned.pack(STEP_TUNED, t, h, *inputs, *tunables)

    def decode_step(self, message: bytes) -> tuple[float, float, Sequence[float], Sequence[float] | None]:
        """Return t [s], h [s], inputs, and tunables or None."""
        if message[0] == STEP:
            _, t, h, *inputs = self._step.unpack(message)
            return t, h, inputs, None
        _, t, h, *values = self._step_tuned.unpack(message)
        return t, h, values[: self._n_inputs], values[self._n_inputs :]

    def encode_values(self, outputs: Sequence[float]) -> bytes:
        return self._values.pack(VALUES, *outputs)

    def decode_values(self, message: bytes) -> tuple[float, ...]:
        """Return the values in a message. Raises struct.error when the message has another length."""
        return self._values.unpack(message)[1:]


def encode(kind: int, value: object, blob: bytes | None = None) -> bytes:
    """Return a message of a JSON value and, behind it, raw bytes or None."""
    text = json.dumps([value, blob is not None]).encode()
    return _HEAD.pack(kind, len(text)) + text + (blob or b"")


def decode(message: bytes) -> tuple[Any, bytes | None]:
    """Return the value and the bytes of a message of encode. Raises ValueError for any other bytes."""
    try:
        _, length = _HEAD.unpack_from(message)
        end = _HEAD.size + length
        value, has_blob = json.loads(message[_HEAD.size : end])
    except (struct.error, TypeError, RecursionError) as error:
        raise ValueError("the message is not of the form that encode makes") from error
    return value, message[end:] if has_blob else None
