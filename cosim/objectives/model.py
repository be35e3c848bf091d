"""The estimator's model: a Python function, the user's or one of this package, or a model-exchange FMU of the plant.

An FMU is read the FMI way: set continuous states, inputs and parameters, get the states' derivatives.
"""

import logging
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
from fmpy.model_description import ModelDescription, ModelVariable

from estimator import Parameter

from ..errors import CosimError, NotResumableError, ScenarioError, SlaveError
from ..files import sha256
from ..fmi.archive import fmu_to_load, read_description, unpacked
from ..fmi.elements import resolved
from ..fmi.ports import Catalogue
from ..fmi.preflight.description import is_true
from ..fmi.value_buffers import ScalarVariable
from ..names import did_you_mean
from ..scenarios.scenario import Scenario
from ..slaves.killed import unless_killed
from ..slaves.process import FmuProcess
from ..system.fmu_cache import find_fmu
from ..system.parameters import narrower_range
from ..system.plant import Plant
from ..user_code import load

_log = logging.getLogger(__name__)

_STEP: Final = 1e-5
"""Step of differences that directional derivatives are compared with, as a share of a parameter."""
_AGREED: Final = 1e-3
"""Largest difference between the two, as a share of the largest slope."""


@contextmanager
def opened_model(scenario: Scenario, plant: Plant) -> Generator[Any]:
    """Open the model, xdot (n,) = model(x, u, **parameters), see DerivativeResidual. Raises ScenarioError."""
    fmu = model_fmu(scenario)
    if fmu is None:
        yield load(scenario.estimation.model or "", scenario.folder, origin=scenario.origin)
        return
    settings = scenario.scenario
    with _as_of_model():
        parameters = scenario.estimation.space.parameters
        model = FmuModel(fmu, plant, parameters, settings.timeout, settings.memory_limit, settings.environment)
    try:
        yield model
    finally:
        model.close()


def model_fmu(scenario: Scenario) -> Path | None:
    """Return the file of a scenario's model if it is an FMU, None for a Python function. Raises ScenarioError."""
    reference = scenario.estimation.model
    if reference is None:
        raise ScenarioError("estimation.model: derivatives need it.")
    if ":" in reference and not reference.endswith(".fmu"):
        return None
    with _as_of_model():
        return find_fmu(reference, scenario.folder, 3, "ModelExchange")


def check_model_fmu(scenario: Scenario, plant: Plant) -> None:
    """Raise ScenarioError for a model FMU that lacks what the plant has; it is not started."""
    fmu = model_fmu(scenario)
    if fmu is not None:
        with _as_of_model():
            _binding(fmu, read_description(fmu, "model-exchange"), plant, scenario.estimation.space.parameters)


@contextmanager
def _as_of_model() -> Generator[None]:
    """Name the key in what is raised, all of which becomes ScenarioError."""
    try:
        yield
    except CosimError as e:
        text = str(e) if isinstance(e, ScenarioError) else f"{str(e).rstrip('.')}."
        raise ScenarioError(f"estimation.model: {text}") from e


class FmuModel:
    """Model of a model-exchange FMU, xdot (n,) = model(x, u, **parameters), in a process of its own.

    x and u are the plant's states and inputs, in its order; the FMU has them, and the parameters, under the same names.
    Parameters are set only when they change, so that a call is one round trip. Where the FMU fails, the model has no
    value (ValueError), and the FMU is started anew for the next call.
    """

    def __init__(
        self,
        fmu: Path,
        plant: Plant,
        parameters: Sequence[Parameter],
        timeout: float = 10.0,
        memory_limit: float = 0.0,
        environment: Sequence[str] = (),
    ) -> None:
        """timeout of a call [s], memory_limit [MB], environment: see open_slave. Raises CosimError."""
        self._fmu, self._timeout, self._memory_limit, self._environment = fmu, timeout, memory_limit, environment
        self._parameters = [p.name for p in parameters]
        self._bounds = {p.name: (p.lower, p.upper) for p in parameters}
        self._theta: tuple[float, ...] | None = None
        self._process: FmuProcess | None = None
        self._description, self._folder = unpacked(fmu, "model-exchange")
        try:
            self._unproven = set(self._parameters) if has_directions(self._description) else None
            self._bound = _binding(fmu, self._description, plant, parameters)
            self._process = self._started()
        except BaseException:
            self.close()
            raise

    def __call__(self, x: Sequence[float], u: Sequence[float], **parameters: float) -> tuple[float, ...]:
        """Return the derivatives (n,) in the order of x. Raises ValueError where the FMU fails."""
        theta = tuple([float(parameters[name]) for name in self._parameters])

        def derivatives() -> tuple[float, ...]:
            process = self._process = self._process or self._started()
            process.begin_step(0.0, 0.0, (*x, *u), None if theta == self._theta else theta)
            self._theta = theta
            return process.end_step(0.0)

        try:
            return unless_killed(derivatives, self._end)
        except SlaveError as error:
            self._end()
            raise ValueError(str(error)) from error

    @property
    def has_slopes(self) -> bool:
        """True where the FMU offers derivatives by its parameters, as long as they have not been found wrong."""
        return self._unproven is not None

    def slopes(self, x: Sequence[float], u: Sequence[float], **parameters: float) -> list[list[float]]:
        """Return d xdot / d theta (n, d), the FMU's own. Raises ValueError where it gives none, or wrong ones.

        Those by a parameter are compared with differences until they have been right where they are not zero: not
        every FMU that declares directional derivatives has those by parameters.
        """
        if self._unproven is None:
            raise ValueError("no directional derivatives by parameters")
        theta = [float(parameters[name]) for name in self._parameters]

        def slopes() -> list[list[float]]:
            process = self._process = self._process or self._started()
            return process.call("slopes", 0.0, [*x, *u], theta)

        try:
            found = unless_killed(slopes, self._end)
            self._theta = tuple(theta)
        except SlaveError as error:
            self._end()
            self._unproven = None
            raise ValueError(str(error)) from error
        for name in [*self._unproven]:
            self._prove(name, [row[self._parameters.index(name)] for row in found], x, u, parameters)
        return found

    def _prove(
        self, name: str, slope: Sequence[float], x: Sequence[float], u: Sequence[float], parameters: dict[str, float]
    ) -> None:
        """Compare the slope (n,) by a parameter with a difference; it is proven where that is not zero.

        Raises ValueError where they differ, and slopes are not used again.
        """
        assert self._unproven is not None
        (lower, upper), value = self._bounds[name], float(parameters[name])
        h = _STEP * max(abs(value), _STEP * (upper - lower))
        places = min(value + h, upper), max(value - h, lower)
        above, below = (np.array(self(x, u, **parameters | {name: place})) for place in places)
        difference, own = (above - below) / (places[0] - places[1]), np.array(slope)
        size = max(float(np.abs(difference).max()), float(np.abs(own).max()))
        if not np.all(np.abs(own - difference) <= _AGREED * size):
            self._unproven = None
            raise ValueError(
                f"its directional derivatives by {name} are {own.tolist()}, differences {difference.tolist()}"
            )
        if size > 0.0:
            self._unproven.discard(name)

    def to_checkpoint(self) -> str:
        """Return the SHA-256 of the FMU, which keeps nothing from one call to the next."""
        return sha256(self._fmu)

    def from_checkpoint(self, saved: str) -> None:
        """Check that the FMU is the saved one. Raises NotResumableError for another."""
        if saved != sha256(self._fmu):
            raise NotResumableError(f"{self._fmu} has changed")

    def close(self) -> None:
        """End the FMU and remove its folder; idempotent. A failure is logged, as one of `Slave.close` is."""
        try:
            if self._process is not None:
                self._process.close(0.0, is_polite=True)
        except SlaveError as error:
            _log.warning("%s", error)
        finally:
            self._process = None
            self._folder.remove()

    def _end(self) -> None:
        if self._process is not None:
            self._process.close(None, is_polite=False)
        self._process = self._theta = None

    def _started(self) -> FmuProcess:
        to_load = fmu_to_load(self._description, self._folder.path, self._fmu.stem, "model-exchange")
        to_load = to_load._replace(interface="derivatives")
        process = FmuProcess(to_load, self._timeout, memory_limit=self._memory_limit, environment=self._environment)
        try:
            process.bind(*self._bound)
            process.call("initialize", 0.0, (), 0.0, None)
        except BaseException:
            process.close(None, is_polite=False)
            raise
        return process


def has_directions(description: ModelDescription) -> bool:
    """Return whether an FMU may give derivatives of its state derivatives by parameters.

    In FMI 2.0, section 2.2.8, only inputs, states and time are knowns after initialization.
    """
    interface = description.modelExchange
    declared = interface is not None and is_true(interface.providesDirectionalDerivative)
    return str(description.fmiVersion).startswith("3") and declared


def _binding(
    fmu: Path, description: ModelDescription, plant: Plant, parameters: Sequence[Parameter]
) -> tuple[list[ScalarVariable], list[ScalarVariable], list[ScalarVariable]]:
    """Return the FMU's variables: states and inputs, parameters, derivatives. Raises ScenarioError, WiringError."""
    known = description.modelVariables
    variables = {v.name: v for v in known}
    rates = {v.derivative.name: v for v in known if v.derivative is not None}
    states = _named(fmu, "state", plant.states, {name: variables[name] for name in rates})
    inputs = _named(fmu, "input", plant.inputs, {n: v for n, v in variables.items() if v.causality == "input"})
    if len(states) != len(rates):
        missing = next(name for name in rates if name not in {v.name for v in states})
        raise ScenarioError(f"{fmu.name} has the state {missing!r}, which {plant.name} has not.")
    names = [resolved(p.name, variables) for p in parameters]
    tunables = Catalogue(fmu.name, known).ports("tunable parameter", names)
    for p, name in zip(parameters, names, strict=True):
        _check_bounds(p, variables[name], fmu)
    return (
        [_variable(v) for v in (*states, *inputs)],
        tunables.variables,
        [_variable(rates[v.name]) for v in states],
    )


def _variable(variable: ModelVariable) -> ScalarVariable:
    return ScalarVariable(variable.name, variable.type, variable.valueReference)


def _named(fmu: Path, kind: str, names: Iterable[str], known: Mapping[str, ModelVariable]) -> list[ModelVariable]:
    """Return the variables of these names, in this order. Raises ScenarioError for one that the FMU does not have."""
    found = [resolved(name, known) for name in names]
    for name in found:
        if name not in known:
            raise ScenarioError(
                f"{fmu.name} has no {kind} {name!r}{did_you_mean(name, known) or ''}, as the plant has."
            )
    return [known[name] for name in found]


def _check_bounds(parameter: Parameter, variable: ModelVariable, fmu: Path) -> None:
    if narrower := narrower_range(parameter, variable):
        bounds = f"[{parameter.lower:g}, {parameter.upper:g}]"
        raise ScenarioError(f"{variable.name!r} of {fmu.name} takes {narrower}; '{parameter.name}' has {bounds}.")
