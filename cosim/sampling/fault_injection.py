"""Injection of sensor faults into measured samples, for tests of a set-up."""

from collections.abc import Sequence
from dataclasses import replace
from math import sqrt

import numpy as np

from estimator import Sample

from ..errors import WiringError
from ..names import did_you_mean
from ..scenarios.schema.sampling import SensorFault


class FaultInjection:
    """Sensor faults of a scenario, applied to its samples, with a random stream of their own: noise is unaffected."""

    def __init__(self, faults: Sequence[SensorFault], sensors: Sequence[str], rng: np.random.Generator) -> None:
        """sensors: names of the measured values, xdot, x, then y. Raises WiringError for an unknown one."""
        for fault in faults:
            if fault.sensor is not None and fault.sensor not in sensors:
                hint = did_you_mean(fault.sensor, sensors)
                raise WiringError(
                    f"sampling.faults: '{fault.sensor}' is no sampled derivative, state or output{hint or '.'}"
                )
        self._faults = [(f, [i for i, name in enumerate(sensors) if f.sensor in (None, name)]) for f in faults]
        self._rng = rng
        self._frozen: dict[int, tuple[float, ...]] = {}
        self._errors: dict[int, dict[int, float]] = {}
        self._past: list[Sample] = []
        self._memory = 1 + max((f.steps for f in faults), default=0)

    def __call__(self, sample: Sample) -> Sample:
        """Return the sample with the faults in force at its time, applied one after the other."""
        self._past = [*self._past[-self._memory :], sample]
        measured, stamp = [*sample.xdot, *sample.x, *sample.y], sample.t
        for i, (fault, places) in enumerate(self._faults):
            draw, sign = self._rng.random(), 1.0 if self._rng.random() < 0.5 else -1.0
            if not fault.is_in_force(sample.t):
                self._frozen.pop(i, None)
                self._errors.pop(i, None)
            elif draw < fault.probability:
                old = self._past[max(len(self._past) - 1 - fault.steps, 0)]
                if fault.kind == "late":
                    measured, stamp = [*old.xdot, *old.x, *old.y], old.t  # what the inputs are is known
                    continue
                source = {"delay": (*old.xdot, *old.x, *old.y)}.get(fault.kind, tuple(measured))
                if fault.kind == "stuck":
                    source = self._frozen.setdefault(i, source)
                for place in places:
                    noise = self._noise(i, place, fault.correlation) if fault.kind == "noise" else sign
                    measured[place] = _faulty(fault, source[place], noise)
        n = len(sample.xdot)
        m = n + len(sample.x)
        return replace(sample, t=stamp, xdot=tuple(measured[:n]), x=tuple(measured[n:m]), y=tuple(measured[m:]))

    def _noise(self, fault: int, place: int, correlation: float) -> float:
        """Return the next value of a sensor's noise, of unit variance (Box and Jenkins 1970, first-order process)."""
        draw, errors = float(self._rng.standard_normal()), self._errors.setdefault(fault, {})
        before = errors.get(place)
        errors[place] = draw if before is None else correlation * before + sqrt(1.0 - correlation**2) * draw
        return errors[place]


def _faulty(fault: SensorFault, value: float, draw: float) -> float:
    """Return a faulty value; draw: a sign, or a number from the standard normal distribution."""
    match fault.kind:
        case "dropout":
            return float("nan")
        case "infinite":
            return draw * float("inf")
        case "bias":
            return value + fault.size
        case "spikes" | "noise":
            return value + draw * fault.size
        case "sign":
            return -value
        case "scale":
            return value * fault.size
        case _:  # stuck, delay: the value is an older one already
            return value
