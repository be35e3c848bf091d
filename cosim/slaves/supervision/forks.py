"""Copies of its own process that an FMU forks off: they must not answer in its place."""

import os

from ..channel import Channel


class UnforkedChannel:
    """A channel for the process that opened it: a forked copy of that process ends where it would use the channel.

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
