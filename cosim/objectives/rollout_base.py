"""State in which the newest window begins, so that no roll-out is simulated again from the start."""

from collections.abc import Callable
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from ..errors import StateTooLargeError
from ..slaves.slave import Slave
from .rollout_fmu import Shadow
from .rollout_plan import History, Plan
from .rollout_pool import Outputs, Pool

_SAME: Final = 1e-9
"""Relative difference of outputs that may be rounding."""


class _Reached(NamedTuple):
    """A sample that was reached with the accepted parameters."""

    place: int
    """Its place in the history."""
    state: bytes
    """State of the FMU there."""


class WindowStart:
    """A shadow that goes on from window to window with the accepted parameters, and saves its state there.

    An FMU that cannot save its state, or goes on otherwise from it in another process, is simulated from the start.
    """

    def __init__(self, shadow: Shadow) -> None:
        """Raises nothing: the FMU is started when it is first needed."""
        self._pool = Pool(shadow.opened, 1, shadow.is_restartable)
        self._reached: _Reached | None = None
        self._is_proved: bool | None = None

    def close(self) -> None:
        """End the process."""
        self._pool.__exit__()

    def forget(self, place: int) -> None:
        """Forget a state behind a place from which on other parameters are accepted, or inputs have acted."""
        if self._reached is not None and self._reached.place > place:
            self._reached = None

    def shortened(
        self, plan: Plan, history: History, place: int, simulate: Callable[[Plan], Outputs | None]
    ) -> Plan | None:
        """Return a plan from the start, begun in the state at its window's place instead; None where it cannot.

        simulate: makes the roll-out of a plan in another process.
        """
        if self._is_proved is False or place == 0:
            return None
        if self._reached is None or self._reached.place != place:
            self._go_to(plan, history, place)
        if self._reached is None:
            return None
        begun = replace(plan, state=self._reached.state, before=())
        if self._is_proved is None:
            self._is_proved = _is_same(simulate(begun), simulate(plan))
        return begun if self._is_proved else None

    def _go_to(self, plan: Plan, history: History, place: int) -> None:
        last = self._reached if self._reached is not None and self._reached.place < place else None
        legs = history.legs(place, last.place if last else 0)
        on_the_way = replace(plan, state=last.state if last else None, before=legs)

        def save(slave: Slave, is_new: bool) -> bytes | None:
            on_the_way.begin(self._pool, slave, is_new)
            try:
                return slave.get_state() if slave.has_states else None
            except StateTooLargeError:
                return None

        (outcome,) = self._pool.map([save], is_renewed=last is None)
        self._reached = None if outcome.result is None else _Reached(place, outcome.result)
        if outcome.result is None:
            self._is_proved = False


def _is_same(one: Outputs | None, other: Outputs | None) -> bool:
    return one is not None and other is not None and np.allclose(one, other, rtol=_SAME, atol=_SAME)
