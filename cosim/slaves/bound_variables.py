"""The variables of one slave that are set and got at communication points, and the checks of their values."""

import logging
from collections.abc import Sequence
from typing import Any

from ..errors import COLON, SlaveError, WiringError, seconds
from ..fmi.ports import Catalogue, Ports
from ..fmi.types import TYPES, Value
from ..fmi.value_buffers import ScalarVariable

_log = logging.getLogger(__name__)


class BoundVariables:
    """Inputs, tunable parameters and outputs of one FMU, in bound order."""

    def __init__(self, name: str, catalogue: Catalogue, is_lenient: bool) -> None:
        """name: the instance's; is_lenient: whether a value outside its min and max is only a warning, given once."""
        self._name = name
        self._catalogue = catalogue
        self._is_lenient = is_lenient
        self._warned: set[str] = set()
        self.inputs, self.tunables, self.outputs = (Ports(role, ()) for role in ("input", "parameter", "output"))

    def bind(self, inputs: Sequence[str], tunables: Sequence[str], outputs: Sequence[str]) -> None:
        """Choose the variables by name. Raises WiringError."""
        for names in (inputs, tunables):
            if len(set(names)) != len(names):
                raise WiringError(f"{self._name}: a variable is bound twice in {', '.join(names)}")
        self.inputs = self._catalogue.ports("input", inputs, self._is_lenient)
        self.tunables = self._catalogue.ports("tunable parameter", tunables)
        self.outputs = self._catalogue.ports("output", outputs, self._is_lenient)

    @property
    def all(self) -> tuple[list[ScalarVariable], list[ScalarVariable], list[ScalarVariable]]:
        """Inputs, tunables and outputs as a host's bind takes them."""
        return self.inputs.variables, self.tunables.variables, self.outputs.variables

    def check_tunables(self, names: Sequence[str]) -> None:
        """Raise WiringError if one of them is not a tunable parameter."""
        self._catalogue.ports("tunable parameter", names)

    def check_set(self, ports: Ports, values: Sequence[float], t: float) -> None:
        """Raise ValueError for another number of values than bound, SlaveError for a value that must not be set."""
        self.check_number(ports, values)
        problem = ports.problem(values)
        if problem is not None:
            raise SlaveError(self._name, "set", t, problem, COLON)
        if self._is_lenient:
            self._warn(ports, values, t)

    def check_number(self, ports: Ports, values: Sequence[float]) -> None:
        """Raise ValueError for another number of values than bound."""
        if len(values) != len(ports.variables):
            raise ValueError(f"{self._name}: {len(ports.variables)} values must be set, got {len(values)}.")

    def check_outputs(self, values: Sequence[float], t: float | None) -> None:
        """Raise SlaveError for an output value that the FMU must not have."""
        problem = self.outputs.problem(values)
        if problem is not None:
            raise SlaveError(self._name, "get", t, problem, COLON)
        if self._is_lenient:
            self._warn(self.outputs, values, t)

    def start_value(self, name: str, value: Value, t: float) -> tuple[str, str, int, Value]:
        """Return a start value as a host's initialize takes it. Raises WiringError, SlaveError."""
        port = self._catalogue.start_port(name, value)
        (variable,) = port.variables
        if TYPES[variable.type].is_numeric:
            self.check_set(port, [float(value)], t)
        convert: Any = TYPES[variable.type].python
        return variable.name, variable.type, variable.reference, convert(value)

    def _warn(self, ports: Ports, values: Sequence[float], t: float | None) -> None:
        for name, text in ports.out_of_range(values):
            if name not in self._warned:
                self._warned.add(name)
                _log.warning("%s at t = %s s: %s", self._name, seconds(t or 0.0), text)
