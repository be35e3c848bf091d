"""Tables of a scenario file on measurement: sensors, their faults, the filter, checks of samples."""

from math import ceil
from typing import Annotated, Final, Literal, Self

import scipy  # its parts, 0.3 s, are loaded when they are used
from pydantic import Field, field_validator, model_validator

from .table import MOST, Reference, Table

_SMALLEST: Final = 1e-100
"""Smallest standard deviation of a noise: the squares of residuals divided by it stay finite."""


_LONGEST: Final = 5000
"""Largest number of macro steps that a filter weighs: more are a mistake, and its correlation takes their square."""
_TAIL: Final = 1e-3
"""Share of a state-variable filter's endless response that is left out."""


class Noise(Table):
    """Gaussian measurement noise of one sampled variable."""

    noise: float = Field(default=0.0, ge=0.0)
    """Standard deviation, in the variable's unit."""

    @field_validator("noise")
    @classmethod
    def _can_be_divided_by(cls, noise: float) -> float:
        if 0.0 < noise < _SMALLEST:
            raise ValueError(f"must be 0 or at least {_SMALLEST:g}, got {noise:g}")
        return noise


class Derivative(Noise):
    """A state's derivative, measured or computed by the filter."""

    of: Reference | None = None
    """The state that it is the derivative of. With a filter, the state that this differentiates; its noise gives the
    derivative's, unless `noise` does. Without one, an output that the FMU does not declare as a derivative."""


class SavitzkyGolay(Table):
    """Slope, at the middle one of the newest points, of the polynomial that fits them best."""

    kind: Literal["savitzky-golay"]
    """savitzky-golay"""
    points: int = Field(default=11, ge=3, le=_LONGEST + 1)
    """Number of points; odd."""
    order: int = Field(default=3, ge=1, le=MOST)
    """Order of the polynomial."""
    every: int | None = Field(default=None, ge=1, le=MOST)
    """Points from one sample to the next; by default enough that two samples share at most 5 % of their noise."""

    @model_validator(mode="after")
    def _fits_a_polynomial(self) -> Self:
        if self.points % 2 == 0 or self.points <= self.order:
            raise ValueError(f"points must be odd and more than order, got {self.points} and {self.order}")
        return self


class StateVariable(Table):
    """Low-pass filters (cutoff / (s + cutoff))^order of state, derivative and input."""

    kind: Literal["state-variable"]
    """state-variable"""
    cutoff: float = Field(gt=0.0)
    """Cutoff frequency [rad/s]."""
    order: int = Field(default=2, ge=1, le=10)
    """Number of low-pass filters in series."""
    every: int | None = Field(default=None, ge=1, le=MOST)
    """Points from one sample to the next; by default enough that two samples share at most 5 % of their noise."""

    def n_steps(self, macro_step: float) -> int:
        """Return after how many macro steps [s] 0.1 % of the response is left. Raises ValueError for too many.

        F's step response is that of a gamma distribution.
        """
        length = float(scipy.special.gammaincinv(self.order, 1.0 - _TAIL)) / macro_step  # times cutoff
        if length > _LONGEST * self.cutoff:
            least = 1.01 * length / _LONGEST  # which rounding does not make too small
            raise ValueError(
                f"sampling.filter.cutoff: must be {least:.3g} rad/s at least, got {self.cutoff:g}: the filter would "
                f"weigh more than {_LONGEST} macro steps of {macro_step:g} s"
            )
        return ceil(length / self.cutoff)


class SensorFault(Table):
    """A sensor fault to inject for a test; the estimator does not know of it."""

    kind: Literal["dropout", "infinite", "bias", "noise", "spikes", "sign", "scale", "stuck", "delay", "late"]
    """dropout: not a number. bias: `size` is added. noise: Gaussian noise of standard deviation `size` is added.
    spikes: `size` is added with random sign. sign: multiplied by -1. scale: multiplied by `size`. stuck: holds the
    value at the fault's start. delay: the value of `steps` earlier. late: the whole sample of `steps` earlier, its
    time stamp and input included."""
    sensor: Reference | None = None
    """A sampled derivative or a state of the plant; by default all of them."""
    start: float = 0.0
    """Time at which the fault begins [s]."""
    stop: float | None = None
    """Time before which it ends [s]; by default it lasts to the end."""
    size: float = 0.0
    """Size of a bias, of noise or of spikes, in the sensor's unit; the factor of scale."""
    correlation: float = Field(default=0.0, ge=0.0, lt=1.0)
    """Correlation of noise from one sample to the next: an autoregression of first order, of the same `size`."""
    steps: int = Field(default=1, ge=1, le=10_000)
    """Macro steps of a delay, or by which a sample is late."""
    probability: float = Field(default=1.0, gt=0.0, le=1.0)
    """Probability that a sample in that time is affected."""

    @model_validator(mode="after")
    def _is_sound(self) -> Self:
        if self.kind == "late" and self.sensor is not None:
            raise ValueError("a whole sample is late: leave out 'sensor'")
        needs_size = self.kind in ("bias", "noise", "spikes", "scale")
        if needs_size != ("size" in self.model_fields_set and (needs_size or self.size != 0.0)):  # a manifest has all
            raise ValueError(f"{self.kind} needs 'size'" if needs_size else f"{self.kind} has no 'size'")
        if self.correlation and self.kind != "noise":
            raise ValueError(f"{self.kind} has no 'correlation'")
        if self.stop is not None and self.stop <= self.start:
            raise ValueError(f"stop must be after start, got {self.stop:g} s and {self.start:g} s")
        return self

    def is_in_force(self, t: float) -> bool:
        """Return whether a sample at t [s] may be affected; half a nanosecond late counts as in time."""
        return t >= self.start - 5e-10 and (self.stop is None or t < self.stop - 5e-10)


class Sampling(Table):
    """Measured variables of the plant."""

    derivatives: dict[Reference, Derivative] = {}
    """Derivatives that are compared with the model's, all of one component, the plant."""
    filter: Annotated[SavitzkyGolay | StateVariable, Field(discriminator="kind")] | None = None
    """The filter that computes the derivatives from sampled states, where they are not measured."""
    outputs: dict[Reference, Noise] = {}
    """Outputs of the plant that are compared with simulated ones."""
    states: dict[Reference, Noise] = {}
    """Measurement noise of states, which are exact without it. A state among `outputs` has its noise there. If the
    FMU declares no derivatives, these outputs are the plant's states, in this order."""
    noise_ratio: float = Field(default=1.0, ge=0.0)
    """Size of the noise that is added by the declared one, to try out a declaration that is wrong."""
    faults: tuple[SensorFault, ...] = ()
    """Faults of the sensors, in the order in which they act."""

    @field_validator("derivatives", "outputs")
    @classmethod
    def _has_noise(cls, value: dict[str, Noise]) -> dict[str, Noise]:
        silent = next((name for name, n in value.items() if n.noise == 0.0 and not getattr(n, "of", None)), None)
        if silent:
            raise ValueError(f"'{silent}' must have noise > 0: it weighs the residual")
        return value

    @model_validator(mode="after")
    def _is_of_one_plant(self) -> Self:
        compared = [*self.derivatives, *self.outputs]
        if not compared:
            raise ValueError("must have derivatives or outputs")
        if len({name.component for name in compared}) > 1:
            raise ValueError("all sampled derivatives and outputs must be of one component")
        noisy = {*self.derivatives, *(name for name, state in self.states.items() if state.noise)}
        twice = next((name for name in self.outputs if name in noisy), None)
        if twice:
            raise ValueError(f"'{twice}' must have its noise once")
        return self

    @model_validator(mode="after")
    def _is_filtered_or_not(self) -> Self:
        for name, d in self.derivatives.items():
            if d.of is not None and d.of.component != name.component:
                raise ValueError(f"'{name}' and '{d.of}' must be of one component")
        if self.filter is None:
            for name, d in self.derivatives.items():
                if d.of and not d.noise:
                    raise ValueError(f"'{name}' must have noise > 0, or sampling.filter, which makes it of '{d.of}'")
            return self
        if self.outputs:
            raise ValueError("filter makes derivatives, outputs are for roll-outs, which need every point: have one")
        for name, d in self.derivatives.items():
            if d.of is None:
                raise ValueError(f"'{name}' must say of which state the filter makes it: of = \"plant.x\"")
            if d.of not in self.states or not self.states[d.of].noise:
                raise ValueError(f"'{d.of}' must have noise > 0 in sampling.states: it weighs the residual")
        return self


class ObservationSettings(Table):
    """Checks that keep bad samples from the estimator."""

    enabled: bool = True
    """True to check samples."""
    outlier: float = Field(default=8.0, gt=0.0)
    """Jump of the residual, in its usual standard deviations, above which the next sample must confirm it."""
    inconsistent: float = Field(default=8.0, gt=0.0)
    """Standard deviations by which an integrated derivative may differ from the change of its state."""
    stuck: int = Field(default=10, ge=2, le=MOST)
    """Identical readings in a row after which a sensor that should have changed counts as stuck."""
    patience: int = Field(default=100, ge=2, le=MOST)
    """Number of newest samples; a sensor that is bad in more than half of them counts as failed."""
