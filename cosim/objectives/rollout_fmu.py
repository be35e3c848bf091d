"""The FMU that is rolled out: a second FMU of the plant, with the plant's variables by name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal

from ..errors import CosimError, ScenarioError
from ..fmi.archive import capabilities, read_description
from ..fmi.ports import Catalogue
from ..scenarios.scenario import Scenario
from ..slaves.slave import Slave, open_slave
from ..system.fmu_cache import component_path, find_fmu
from ..system.plant import Plant

StartMethod = Literal["state", "measured", "replay"]
START_METHODS: Final[tuple[StartMethod, ...]] = ("state", "measured", "replay")
"""Ways to bring a shadow to the beginning of a window, in the order of preference."""


@dataclass(frozen=True)
class RunningPlant:
    """The plant that runs in the co-simulation."""

    slave: Slave
    """Its slave, at the newest sample's time whenever an objective is called."""
    outputs: tuple[str, ...]
    """Variables read from it."""
    changes: Mapping[str, Callable[[float], float]]
    """Parameters changed from outside, as functions of t [s]: used only to prove that a step can be repeated."""
    disturbances: Mapping[str, Callable[[float], float]] = field(default_factory=dict[str, Callable[[float], float]])
    """Inputs changed from outside, likewise."""


@dataclass(frozen=True)
class Shadow:
    """The FMU to roll out, and the variables of it that are set and read."""

    fmu: Path
    inputs: tuple[str, ...]
    """Inputs, in the order of a sample's u."""
    states: tuple[str, ...]
    """States, in the order of a sample's x."""
    outputs: tuple[str, ...]
    """Outputs, in the order of a sample's y."""
    noise: tuple[float, ...]
    """Standard deviation of each output (c,), in its unit."""
    parameters: tuple[str, ...]
    """Estimated parameters, in the order of theta."""
    start: Mapping[str, Any]
    """Start values that are not estimated."""
    start_time: float
    """Start time of the co-simulation [s]."""
    stop_time: float
    """Its stop time [s], which no roll-out passes."""
    is_restartable: bool
    """True where it may be instantiated several times in a process."""
    obstacles: Mapping[StartMethod, str]
    """Ways of bringing it to the beginning of a window that do not work, each with the reason."""
    timeout: float = 10.0
    """Longest time that a call may take [s]."""
    environment: tuple[str, ...] = ()
    """Environment variables that its process is given: see open_slave."""
    tolerance: float | None = None
    """Relative tolerance for its own solver: see open_slave."""
    told_by: Mapping[str, str] = field(default_factory=dict[str, str])
    """Output that has the value of a state, by the parameter that the state starts as."""
    undisturbed: Mapping[str, float] = field(default_factory=dict[str, float])
    """Start values of the inputs that the scenario changes: a saved state has others, which nobody knows."""

    def opened(self, tunables: tuple[str, ...] | None = None) -> Slave:
        """Start a process of it, variables bound; tunables: by default the parameters, if settable while it runs."""
        slave = open_slave(
            self.fmu, "shadow", timeout=self.timeout, environment=self.environment, tolerance=self.tolerance
        )
        if tunables is None:
            tunables = () if "replay" in self.obstacles else self.parameters
        try:
            slave.bind(self.inputs, tunables, self.outputs)
        except BaseException:
            slave.close()
            raise
        return slave


def shadow_of(scenario: Scenario, plant: Plant, is_live: bool) -> Shadow:
    """Return the shadow for a scenario; is_live: the plant runs beside it. Raises ScenarioError in one line."""
    settings = scenario.estimation.rollout
    own = component_path(scenario.components[plant.name], scenario.folder)
    where = "estimation.rollout"
    try:
        fmu = own if settings.fmu is None else find_fmu(settings.fmu, scenario.folder)
        description = read_description(fmu)
        variables = {v.name: v for v in description.modelVariables}
        catalogue = Catalogue(fmu.name, description.modelVariables)
        inputs, outputs = tuple(plant.inputs), tuple(r.variable for r in scenario.sampling.outputs)
        catalogue.ports("input", inputs)
        catalogue.ports("output", outputs)
        names: list[str] = []
        for p in scenario.estimation.parameters:
            name = scenario.true_reference(p).variable
            names.append(name if name in variables else p.name)
            port = catalogue.start_port(names[-1], p.lower)
            if problem := port.problem([p.lower]) or port.problem([p.upper]):
                raise ScenarioError(f"bounds of '{p.name}': {problem}")
        interface: Any = capabilities(description)
        start = {k: v for k, v in scenario.components[plant.name].start.items() if k in variables}
        shadow = Shadow(
            fmu, inputs, plant.states, outputs, tuple(n.noise for n in scenario.sampling.outputs.values()),
            tuple(names), {k: v for k, v in start.items() if k not in names}, scenario.scenario.start_time,
            scenario.scenario.stop_time, not interface.canBeInstantiatedOnlyOncePerProcess, {},
            scenario.scenario.timeout, scenario.scenario.environment, scenario.components[plant.name].tolerance,
            undisturbed=plant.disturbances,
        )  # fmt: skip
    except CosimError as e:
        raise ScenarioError(f"{where}: {str(e).rstrip('.')}.") from e
    obstacles = _obstacles(shadow, catalogue, interface, own if is_live else None)
    if settings.start in obstacles:
        raise ScenarioError(f"{where}.start = '{settings.start}': {obstacles[settings.start]}.")
    if len(obstacles) == len(START_METHODS):
        raise ScenarioError(f"{where}: no way to begin a roll-out: {obstacles_in_words(obstacles)}.")
    return replace(shadow, obstacles=obstacles)


def obstacles_in_words(obstacles: Mapping[StartMethod, str]) -> str:
    """Return the obstacles in one line."""
    return "; ".join(f"{way}: {reason}" for way, reason in obstacles.items())


def _obstacles(shadow: Shadow, catalogue: Catalogue, interface: Any, live: Path | None) -> dict[StartMethod, str]:
    obstacles: dict[StartMethod, str] = {}
    fixed = _refusal(lambda: catalogue.ports("tunable parameter", shadow.parameters))
    if live is None:
        obstacles["state"] = "the plant does not run beside it"
    elif live != shadow.fmu:
        obstacles["state"] = f"{shadow.fmu.name} is not the plant's FMU"
    elif not (interface.canGetAndSetFMUstate and interface.canSerializeFMUstate):
        obstacles["state"] = f"{shadow.fmu.name} cannot save and restore its state"
    elif fixed:
        obstacles["state"] = fixed
    if not shadow.states:
        obstacles["measured"] = "the plant declares no states: name them in sampling.states"
    elif problem := _refusal(lambda: [catalogue.start_port(name, 0.0) for name in shadow.states]):
        obstacles["measured"] = problem
    if fixed:
        obstacles["replay"] = fixed
    return obstacles


def _refusal(check: Callable[[], object]) -> str | None:
    try:
        check()
    except CosimError as e:
        return str(e).rstrip(".")
    return None
