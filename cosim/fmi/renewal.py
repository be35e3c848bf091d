"""Renewal of an FMU's instance between two simulations: by fmi2Reset where that is as good as a new one."""

from array import array
from collections.abc import Callable
from typing import Any

from ..errors import SlaveError
from .binding import Binding


class Renewal:
    """Renewal of an instance. fmi2Reset takes 40 us for an FMU in Python, a new one 2.5 ms; but it may be left undone.

    So the first simulation after a reset is made again with a new instance. Where both have the same outputs, to the
    bit, the FMU is reset from then on, where not it is instantiated anew each time.
    """

    def __init__(self, anew: Callable[[], Binding]) -> None:
        """anew: frees the instance and returns another, with the same variables bound."""
        self._anew = anew
        self._is_trusted: bool | None = None

    def simulated(
        self, binding: Binding, simulate: Callable[[Binding], "array[float]"]
    ) -> tuple[Binding, "array[float]"]:
        """Return the instance, renewed, and what `simulate` has made of it. Raises SlaveError."""
        if self._is_trusted:
            _reset(binding)
            return binding, simulate(binding)
        after_reset = self._tried(binding, simulate) if self._is_trusted is None else None
        binding = self._anew()
        outputs = simulate(binding)
        self._is_trusted = after_reset == outputs.tobytes()
        return binding, outputs

    def _tried(self, binding: Binding, simulate: Callable[[Binding], "array[float]"]) -> bytes | None:
        """Return the outputs after a reset as bytes, or None where that fails or there is no such call."""
        try:
            _reset(binding)
            return simulate(binding).tobytes()
        except (SlaveError, AttributeError):
            return None


def _reset(binding: Any) -> None:
    binding.reset()
