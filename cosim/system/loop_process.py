"""A closed loop of shadows in a process of its own: one for all its FMUs, and a message for many steps."""

import logging
from collections.abc import Mapping, Sequence
from typing import Any

from ..errors import COLON, ScenarioError, SlaveError, WiringError
from ..slaves.process import FmuProcess
from .loop_plan import LoopPlan, named_state
from .shadow_loop import Course

_log = logging.getLogger(__name__)


class LoopProcess:
    """The shadows of `loop_child`, contained as an FMU in its own process is: what they do harms nothing here.

    Each call of each FMU has its time limit, and a fault the name of its FMU. They load while this process goes on; the
    first call waits for that, and raises what became of it: SlaveError, WiringError; ScenarioError where an FMU cannot
    be unpacked.
    """

    def __init__(self, plan: LoopPlan, memory_limit: float = 0.0, environment: Sequence[str] = ()) -> None:
        """memory_limit: of the process [MB], 0 for half of the machine's; environment: as for FmuProcess."""
        self._name, self._is_open = plan.instance_name, False
        self._sent: Mapping[str, Any] | None = None
        self._process = FmuProcess(
            plan, plan.timeout, memory_limit=memory_limit, environment=environment, program="cosim.system.loop_child"
        )

    def prove(self) -> None:
        """Save and restore the state of every FMU once."""
        self._call("prove")

    def restore(self, states: Mapping[str, Any], values: Sequence[float]) -> None:
        """Go to these states, which are sent but once, at which all outputs of the loop are values."""
        if states is not self._sent:
            for name, state in states.items():
                self._call("state", named_state(name, state))
            self._sent = states
        self._call("restore", list(values))

    def peak(self, course: Course) -> float:
        """Return the largest norm of the tracking error on the way; infinite where it diverges."""
        return float(self._call("peak", *course))

    def close(self) -> None:
        """End the process, politely where it still answers; idempotent."""
        try:
            self._process.close(None, is_polite=True)
        except SlaveError as error:
            _log.warning("%s", error)

    def _call(self, function: str, *arguments: object) -> Any:
        if not self._is_open:
            self._is_open = True
            self._call("open")
        try:
            value, raised = self._process.call(function, None, *arguments)
            if raised is None:
                return value
            error = SlaveError(*raised) if len(raised) > 2 else _error(*raised)
        except (TypeError, ValueError) as e:
            raise SlaveError(self._name, function, None, "the process gave an answer of the wrong form", COLON) from e
        raise error


def _error(kind: str, text: str) -> ScenarioError | WiringError:
    return ScenarioError(text) if kind == ScenarioError.__name__ else WiringError(text)
