"""The tables of a scenario file on what is measured: sensors, their faults, the filter, which samples are kept out."""

from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from .table import MOST, Reference, Table


class Noise(Table):
    """Gaussian measurement noise of one sampled variable."""

    noise: float = Field(default=0.0, ge=0.0)
    """Standard deviation, in the variable's unit."""


class Derivative(Noise):
    """A state's derivative, measured or made by the filter."""

    of: Reference | None = None
    """The state that the filter differentiates; its noise gives the derivative's, unless `noise` does."""


class SavitzkyGolay(Table):
    """The slope of the polynomial through the newest points that fits them best, at their middle."""

    kind: Literal["savitzky-golay"]
    """savitzky-golay"""
    points: int = Field(default=11, ge=3, le=MOST)
    """How many; odd."""
    order: int = Field(default=3, ge=1, le=MOST)
    """Of the polynomial."""
    every: int | None = Field(default=None, ge=1, le=MOST)
    """A sample every so many points; by default so many that two share at most 5 % of their noise."""

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
    """[rad/s]"""
    order: int = Field(default=2, ge=1, le=10)
    """How many low-passes follow one another."""
    every: int | None = Field(default=None, ge=1, le=MOST)
    """A sample every so many points; by default so many that two share at most 5 % of their noise."""


class SensorFault(Table):
    """What goes wrong with a sensor, to try out a set-up; the estimator is not told."""

    kind: Literal["dropout", "infinite", "bias", "noise", "spikes", "sign", "scale", "stuck", "delay", "late"]
    """dropout: not a number. noise: Gaussian, of standard deviation size, added. spikes: +-size added, the sign at
    random. sign: multiplied by -1; scale: by size. stuck: the value at the fault's beginning. delay: the value of
    `steps` before; late: the whole sample of then, its time stamp and input included."""
    sensor: Reference | None = None
    """A sampled derivative or a state of the plant; none: all of them."""
    start: float = 0.0
    """In force from this time on [s]."""
    stop: float | None = None
    """Until before this time [s]; none: to the end."""
    size: float = 0.0
    """Of bias, noise, spikes, in the sensor's unit; of scale."""
    steps: int = Field(default=1, ge=1, le=10_000)
    """Of delay, late: macro steps."""
    probability: float = Field(default=1.0, gt=0.0, le=1.0)
    """That a sample in that time is hit."""

    @model_validator(mode="after")
    def _is_sound(self) -> Self:
        if self.kind == "late" and self.sensor is not None:
            raise ValueError("a whole sample is late: leave out 'sensor'")
        if (self.kind in ("bias", "noise", "spikes", "scale")) != ("size" in self.model_fields_set):
            raise ValueError(f"'size' belongs to bias, noise, spikes and scale, which need it, got kind '{self.kind}'")
        return self

    def is_in_force(self, t: float) -> bool:
        """Whether a sample of t [s] may be hit; half a nanosecond late counts as in time."""
        return t >= self.start - 5e-10 and (self.stop is None or t < self.stop - 5e-10)


class Sampling(Table):
    """What the estimator gets to see."""

    derivatives: dict[Reference, Derivative] = {}
    """Derivatives that are compared with the model's, all of one component: the plant."""
    filter: Annotated[SavitzkyGolay | StateVariable, Field(discriminator="kind")] | None = None
    """Makes the derivatives from sampled states, where they are not measured."""
    outputs: dict[Reference, Noise] = {}
    """Outputs of the plant that are compared with simulated ones."""
    states: dict[Reference, Noise] = {}
    """Noise on states, where they are not measured exactly; one that is among the outputs has that noise."""
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
        twice = next((name for name in self.outputs if name in self.derivatives or name in self.states), None)
        if twice:
            raise ValueError(f"'{twice}' must have its noise once")
        return self

    @model_validator(mode="after")
    def _is_filtered_or_not(self) -> Self:
        if self.filter is None:
            loose = next((name for name, d in self.derivatives.items() if d.of), None)
            if loose:
                raise ValueError(f"'{loose}' of a state needs sampling.filter, which makes it")
            return self
        if self.outputs:
            raise ValueError("filter makes derivatives, outputs are for roll-outs, which need every point: have one")
        for name, d in self.derivatives.items():
            if d.of is None:
                raise ValueError(f"'{name}' must say of which state the filter makes it: of = \"plant.x\"")
            if d.of.component != name.component:
                raise ValueError(f"'{name}' and '{d.of}' must be of one component")
            if d.of not in self.states or not self.states[d.of].noise:
                raise ValueError(f"'{d.of}' must have noise > 0 in sampling.states: it weighs the residual")
        return self


class ObservationSettings(Table):
    """Which samples the estimator does not get."""

    enabled: bool = True
    """Whether samples are looked at."""
    outlier: float = Field(default=8.0, gt=0.0)
    """Jump of the residual, in its usual standard deviations, that the next sample must confirm."""
    inconsistent: float = Field(default=8.0, gt=0.0)
    """Standard deviations by which a derivative, summed, may differ from the change of its state."""
    stuck: int = Field(default=10, ge=2, le=MOST)
    """Times that a sensor which should move has repeated its bits when it is taken for stuck."""
    patience: int = Field(default=100, ge=2, le=MOST)
    """Newest samples of which more than half must be bad for a sensor to count as failed."""
