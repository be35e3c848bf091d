"""The command `retune estimate` as a function, `cosim.estimate`."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from estimator.offline.evaluated import FitProgress
from estimator.space import Scale

from ..blas_threads import one_thread
from ..runs.lock import new_locked_folder
from .estimate import Estimation, with_profiles
from .estimate import estimate as estimate_from
from .fit_folder import estimate_into, profile_into
from .log_windows import Cut
from .request import EstimateError, Request, Sought

Bounds = tuple[float, float] | tuple[float, float, Scale]
"""Lower bound, upper bound and, where it is not "linear", the scale of the search: "log"."""


def estimate(
    fmu: Path | str,
    logs: Path | str | Sequence[Path | str],
    parameters: Mapping[str, Bounds],
    measured: Mapping[str, str],
    inputs: Mapping[str, str] | None = None,
    *,
    start: Mapping[str, str | float] | None = None,
    noise: Mapping[str, float] | None = None,
    time: str | None = None,
    time_unit: str | None = None,
    windows: Sequence[Cut] = (),
    own: Sequence[str] = (),
    validation: Sequence[Path | str] = (),
    holdout: float | None = None,
    step: float | None = None,
    method: str = "target",
    evaluations: int = 60,
    seed: int = 0,
    jobs: int | None = None,
    timeout: float = 10.0,
    environment: Sequence[str] = (),
    loss: str = "linear",
    f_scale: float = 1.0,
    profile: bool = False,
    out: Path | str | None = None,
    progress: FitProgress = lambda n, cost: None,
) -> Estimation:
    """Estimate parameters of a plant FMU from logs of measurements.

    fmu: the plant. logs: one file or several (.csv, .parquet, .mat, .mf4).
    parameters: bounds by name, in the FMU's units, `{"m": (0.5, 4.0), "J": (0.1, 12.0, "log")}`.
    measured, inputs: the log's column for each output and input of the FMU.
    start: the start value of a state or of a known parameter, as a number or as a column of the log.
    noise: standard deviation by output, in its unit; estimated from the logs by default.
    time: the column of time stamps; time_unit: their unit, by default the log's, or s.
    windows: parts of each log to use, (from, to) [s].
    own: parameters that have a value of their own in each log; the others have one for all logs.
    validation: logs that are not fitted to. holdout: share of each log's rows that is not fitted to, 0.25 by default.
    step: communication step [s]; by default from row to row.
    method: "target", "least-squares" or "multi-start". evaluations: candidates that the search may simulate.
    jobs: roll-outs at a time, by default one per processor. timeout: for each call of the FMU [s].
    environment: environment variables that the FMU needs beside those which every FMU is given.
    loss: "huber", "soft_l1" or "cauchy", SciPy's names: outliers count for less than their square; f_scale: from how
    many standard deviations of the noise on.
    profile: whether profile likelihoods decide what is identifiable, by further roll-outs.
    out: an absent or empty folder for the files that `retune estimate` writes; nothing is written by default.
    progress: called with the evaluations so far and the least sum of squares.

    Raises CosimError in one line for what is refused, and where no roll-out succeeds.
    """
    paths = [logs] if isinstance(logs, Path | str) else logs
    request = Request(
        fmu=Path(fmu),
        logs=tuple(map(Path, paths)),
        parameters=tuple(sought(name, bounds) for name, bounds in parameters.items()),
        measured=measured,
        inputs=inputs or {},
        start=start or {},
        noise=noise or {},
        time=time,
        time_unit=time_unit,
        windows=cuts_of(windows),
        own=tuple(dict.fromkeys(own)),
        validation=tuple(map(Path, validation)),
        holdout=holdout,
        step=step,
        method=method,
        evaluations=evaluations,
        seed=seed,
        jobs=(os.cpu_count() or 1) if jobs is None else jobs,
        timeout=timeout,
        environment=tuple(environment),
        loss=loss,
        f_scale=f_scale,
    )
    with one_thread():  # as the command runs: the number of BLAS threads changes bits
        if out is None:
            found = estimate_from(request, progress)
            return with_profiles(found) if profile else found
        with new_locked_folder(request.fmu.stem, Path(out)) as folder:
            found = estimate_into(folder, request, progress)
            return profile_into(folder, found) if profile else found


def sought(name: str, bounds: Bounds) -> Sought:
    """Return a parameter to estimate, as its bounds say. Raises EstimateError."""
    try:
        lower, upper, scale = bounds if len(bounds) == 3 else (*bounds, "linear")
        return Sought(name, float(lower), float(upper), scale)
    except (TypeError, ValueError) as e:
        raise EstimateError(f"bounds of {name} must be (lower, upper) or (lower, upper, scale), got {bounds!r}.") from e


def cuts_of(windows: Sequence[Cut]) -> tuple[Cut, ...]:
    """Return the parts of each log to use, as pairs of numbers. Raises EstimateError."""
    try:
        return tuple((float(low), float(high)) for low, high in windows)
    except (TypeError, ValueError) as e:
        raise EstimateError(f"windows must be pairs of numbers, [(from, to), ...], got {windows!r}.") from e
