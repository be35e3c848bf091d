"""Offline estimation: parameters of a plant FMU from logs of measurements."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from estimator import ParameterSpace, Vector
from estimator.offline.evaluated import FitProgress
from estimator.offline.fit import NoFitError, OfflineFit, fit
from estimator.offline.profile_likelihood import Profile, profile
from estimator.offline.robust_loss import Loss

from ..errors import CosimError
from ..fmi.component import Component
from .counted_twice import counted_twice
from .finer_step import FinerStep, finer_step
from .log_windows import LogWindow
from .noisy_start import NoisyStart, start_noise_of
from .request import EstimateError, Request
from .rollout import RolloutResidual, Rollouts, SimulatedPlant
from .swapped_columns import swapped_columns
from .understood import understand


class FailedError(CosimError):
    """Error for an estimation in which every roll-out failed."""


@dataclass(frozen=True)
class Estimation:
    """Result of an estimation: the estimates, and the plant's fit to the logs."""

    request: Request
    component: Component
    space: ParameterSpace
    nominal: Vector
    """Values (d,) before: the FMU's own, or the user's."""
    fit: OfflineFit
    windows: tuple[LogWindow, ...]
    noise: Vector
    """Standard deviation (c,) of each output's noise."""
    before: tuple[Vector | None, ...]
    """Outputs (n, c) with the nominal parameters, by window; None where the simulation fails."""
    after: tuple[Vector | None, ...]
    """Outputs (n, c) with the estimated parameters, by window."""
    warnings: tuple[str, ...]
    """Warnings about parts of the logs that were not used."""
    evaluations: tuple[tuple[Vector, float, str | None], ...]
    """Candidates in order: theta, sum of squares and, where it failed, the reason."""
    seconds: float
    """Wall time [s]."""
    finer: FinerStep | None = None
    """Change of the estimates by half the communication step; None where it cannot be told."""
    profiles: tuple[Profile, ...] = ()
    """Profile likelihood of each parameter; empty where none was asked for."""

    @property
    def is_identifiable(self) -> tuple[bool, ...]:
        """True where the data determine the parameter (d,): by its profile, if there is one."""
        return tuple(p.is_identifiable for p in self.profiles) or self.fit.is_identifiable

    def __repr__(self) -> str:
        """Return one line with the estimates: the series would fill pages."""
        values = ", ".join(f"{name} = {value:.5g} ± {self.std[name]:.2g}" for name, value in self.estimates.items())
        return f"<Estimation from {self.request.fmu.name}: {values}>"

    @property
    def estimates(self) -> dict[str, float]:
        """The estimated value of each parameter, in its unit."""
        return self.space.named(self.fit.theta)

    @property
    def std(self) -> dict[str, float]:
        """The standard deviation of each estimate; see `docs/estimate.md` for what it covers."""
        return self.space.named(self.fit.std)

    @property
    def failures(self) -> Mapping[str, int]:
        """Number of candidates that failed, by reason."""
        return Counter(reason for _, _, reason in self.evaluations if reason is not None)

    def rms(self, outputs: Sequence[Vector | None], is_held_out: bool) -> Vector:
        """Return the root mean square error (c,) over the rows fitted to or held out; NaN where there are none.

        Under a loss outliers count in it as they do in the fit.
        """
        loss, noise = self.fit.loss, self.noise
        errors = [
            loss.shrunk((y - w.measured) / noise)[slice(w.n_fit, None) if is_held_out else slice(w.n_fit)] * noise
            for y, w in zip(outputs, self.windows, strict=True)
            if y is not None
        ]
        columns = np.concatenate(errors).T if errors else np.empty((len(self.noise), 0))
        known = [e[np.isfinite(e)] for e in columns]
        return np.array([np.sqrt(np.mean(e * e)) if len(e) else np.nan for e in known])


def estimate(request: Request, progress: FitProgress = lambda n, cost: None) -> Estimation:
    """Estimate parameters of a plant FMU from logs.

    Raises CosimError in one line for what is refused, FailedError where no roll-out succeeds.
    """
    began = perf_counter()
    component, space, nominal, windows, noise, warnings = understand(request)
    warnings += counted_twice(request.logs, request.windows, request.validation)
    start_noise = start_noise_of(request.start_columns, request.measured, component, windows, noise)
    noisy_start = NoisyStart(_plant(request), component, windows, space, noise, start_noise, request.jobs)
    with Rollouts(_plant(request), component, windows, request.jobs) as rollouts:
        residual = RolloutResidual(rollouts, space, windows, noise)
        if residual.n_residuals <= len(space):
            raise EstimateError(
                f"{residual.n_residuals} measured values are too few for {len(space)} parameters; hold less of it out."
            )
        rng = np.random.default_rng(request.seed)
        try:
            loss = Loss(request.loss, request.f_scale)
            found = fit(
                residual, space, nominal, request.method, request.evaluations, rng, progress, residual.series, loss,
                noisy_start.effects,
            )  # fmt: skip
        except NoFitError as e:
            raise FailedError(f"every roll-out failed, the first so: {residual.evaluations[0][2]}.") from e
        named = [space.named(nominal), space.named(found.theta)]
        of_nominal, of_found = rollouts.simulate(named, is_whole=True)
    before, after = ([r.outputs for r in row] for row in (of_nominal, of_found))
    failed = [(w, r.reason) for w, r in zip(windows, of_found, strict=True) if r.reason is not None]
    warnings += [f"{w.name}: with the estimates the FMU fails in held-out rows: {reason}" for w, reason in failed]
    if noisy_start.failure:
        warnings.append(f"± lacks the noise of the start values, aside of which the FMU fails: {noisy_start.failure}")
    warnings += swapped_columns(request.measured, residual.cross_misfits, residual.n_residuals)
    return Estimation(
        request,
        component,
        space,
        nominal,
        found,
        tuple(windows),
        noise,
        tuple(before),
        tuple(after),
        tuple(warnings),
        tuple(residual.evaluations),
        perf_counter() - began,
        finer_step(_plant(request), component, windows, space, noise, found),
    )


def with_profiles(found: Estimation, progress: Callable[[int], None] = lambda n: None) -> Estimation:
    """Return the estimation with the profile likelihood of each parameter, by further roll-outs.

    progress: called with the number of parameters done.
    """
    request, profiles = found.request, list[Profile]()
    with Rollouts(_plant(request), found.component, found.windows, request.jobs) as rollouts:
        residual = RolloutResidual(rollouts, found.space, found.windows, found.noise)
        for j in range(len(found.space)):
            progress(j)
            profiles.append(profile(residual, found.space, found.fit, j))
    return replace(found, profiles=tuple(profiles))


def _plant(request: Request) -> SimulatedPlant:
    return SimulatedPlant(
        request.fmu,
        tuple(request.inputs),
        tuple(request.measured),
        request.constants,
        request.step,
        request.timeout,
        request.environment,
        request.of_one_log,
    )
