"""Declaration of a plant, its controller and its reference, from which FMUs and scenarios are made."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import pi, sin

Values = tuple[float, ...]


@dataclass(frozen=True)
class Estimated:
    """Parameter that the controller computes with, and that may change."""

    name: str
    unit: str
    start: float
    """Value that the controller is made for [unit]."""
    changed: float
    """Value after the change [unit]."""
    description: str
    lower: float = 0.0
    """Lower bound of the estimate [unit]; 0: a quarter of the start value."""
    upper: float = 0.0
    """Upper bound; 0: four times the start value."""

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the estimate [unit]."""
        return self.lower or self.start / 4.0, self.upper or self.start * 4.0


@dataclass(frozen=True)
class Signal:
    """State, input or reference."""

    name: str
    unit: str | None
    """Unit in the form of the model description; None for one that its tables do not have."""
    description: str
    start: float = 0.0
    """Start value [unit]."""


PLACE = (
    Signal("x_ref", "m", "Desired place"),
    Signal("v_ref", "m/s", "Desired speed"),
    Signal("a_ref", "m/s2", "Desired acceleration"),
    Signal("jerk_ref", "m/s3", "Desired derivative of the acceleration"),
    Signal("snap_ref", "m/s4", "Desired second derivative of the acceleration"),
)
"""References of a body that moves along a line."""
SPEED = (
    Signal("omega_ref", "rad/s", "Desired speed"),
    Signal("alpha_ref", "rad/s2", "Desired acceleration"),
    Signal("jerk_ref", "rad/s3", "Desired derivative of the acceleration"),
)
"""References of a shaft that turns."""


@dataclass(frozen=True, kw_only=True)
class ForeignPlant:
    """A plant with its controller and its reference.

    The load is a force, or what is like one, that acts on the plant from outside. In the FMU it is the disturbance,
    less the friction of one speed; the model that estimates knows neither.
    """

    name: str
    title: str
    """One line for the model description."""
    parameters: Sequence[Estimated]
    states: Sequence[Signal]
    controls: Sequence[Signal]
    """Inputs that the controller computes."""
    references: Sequence[Signal]
    """What the controller is told to follow: values and derivatives."""
    derivative: Callable[..., Values]
    """f(x, u, *parameters, load=0.0): derivatives of the states."""
    control: Callable[..., Values]
    """f(x, reference, *parameters): inputs of the plant."""
    reference: Callable[[float], Values]
    """f(t): values of the references at t [s]."""
    tracked: Mapping[str, str]
    """Each tracked state, and its reference."""
    noise: Mapping[str, float]
    """Declared standard deviation of each sampled derivative, by its state [unit/s]."""
    step: float
    """Time from one communication point to the next [s]."""
    n_steps: int = 900
    """Number of macro steps of a run."""
    divergence: float
    """Tracking error at which a run is lost."""
    rate: float
    """Limit of the actuators' rate in the case `rate` [unit/s]: the inputs change faster at times, without it."""
    limit: float
    """Limit of the first input in the case `limited`: it is larger at times, without it."""
    speed: str = ""
    """State that friction brakes, by way of the load; empty: there is none."""
    pace: float = 1.0
    """Usual size of that speed."""
    gust: float = 40.0
    """Largest load of a gust, in standard deviations of the derivative that shows it best."""
    constant: float = 30.0
    """Constant load, likewise."""
    friction: float = 20.0
    """Friction at the usual speed, likewise."""
    omitted: Mapping[str, str] = field(default_factory=dict)
    """Cases that have no meaning for this plant, each with the reason."""

    def start(self) -> tuple[Values, Values, Values]:
        """Return states, inputs and parameters at the start; the states are on the reference."""
        x, values = tuple(s.start for s in self.states), tuple(p.start for p in self.parameters)
        return x, self.control(x, self.reference(0.0), *values), values

    def unit_load(self) -> float:
        """Return the load that moves the derivative that shows it best by one standard deviation."""
        x, u, values = self.start()
        loaded, free = (self.derivative(x, u, *values, load=load) for load in (1.0, 0.0))
        places = {s.name: i for i, s in enumerate(self.states)}
        return 1.0 / max(abs(loaded[places[n]] - free[places[n]]) / sigma for n, sigma in self.noise.items())


def wave(t: float, amplitude: float, omega: float, phase: float = 0.0, n: int = 4) -> Values:
    """Return amplitude sin(omega t + phase) with its first n time derivatives;  t [s], omega [rad/s], phase [rad]."""
    return tuple(amplitude * omega**k * sin(omega * t + phase + k * pi / 2.0) for k in range(n + 1))


def total(*waves: Values) -> Values:
    """Return the sum of signals, derivative by derivative."""
    return tuple(map(sum, zip(*waves, strict=True)))


def limited(value: float, lower: float, upper: float) -> float:
    """Return the value within its limits."""
    return min(max(value, lower), upper)
