"""Accuracy of each estimator with the same number of evaluations, in one episode on a frozen window.

    python -m benchmarks.frozen stiction --at 4.0 --window 100 --evaluations 30 60 120 --seeds 20

The samples are those of the nominal controller's run (FMUs and all), up to `--at`, every `--stride`-th, with fresh
noise for each seed. An evaluation is the model on the whole window, and each estimator gets as many: for least squares
those of its Jacobian count. The error is the largest, over the groups of parameters of one unit, of the norm of
estimated minus true divided by the norm of the true ones. Prints its median and worst over the seeds, and the share of
seeds within 5 %; `--out` writes them, and the error of each seed.
"""

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
from scipy.optimize import least_squares

from benchmarks.report import Row, table, to_lines
from cosim.blas_threads import one_thread
from cosim.files import write_text
from cosim.retuning.estimators import find_method
from cosim.runs.result import Run
from cosim.runs.simulation import run
from cosim.sampling.sampler import recorded_samples
from cosim.scenarios.scenario import Scenario
from cosim.user_code import load
from estimator import (
    AskTell,
    DerivativeResidual,
    Estimate,
    LinearForm,
    Objective,
    ParameterSpace,
    ResidualWindow,
    Sample,
    Vector,
)
from estimator.baselines.solvers import LeastSquaresSettings

CLOSED_FORM = "closed-form"
"""Name of linear least squares on the model's linear form: what a search is measured against where there is one."""
DEFAULT = ("target", "least-squares", "multi-start", "bo-scalar")


def main() -> None:
    """Solve the window with each estimator, print and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario")
    parser.add_argument("--at", type=float, required=True, help="time of the newest sample [s]")
    parser.add_argument("--window", type=int, default=10, help="samples")
    parser.add_argument("--stride", type=int, default=1, help="macro steps between samples")
    parser.add_argument("--evaluations", type=int, nargs="+", default=[30])
    parser.add_argument("--estimators", nargs="+", default=list(DEFAULT))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--out", type=Path, help="JSON file")
    options = parser.parse_args()
    with one_thread():
        recorded = run(Scenario.load(options.scenario), "none")
        rows = [
            row(recorded, name, n, options)
            for n in options.evaluations
            for name in options.estimators
        ]  # fmt: skip
    print(table([{k: v for k, v in r.items() if k != "errors"} for r in rows]))
    if options.out:
        command = {k: v for k, v in vars(options).items() if k != "out"}
        write_text(options.out, to_lines({"command": command, "rows": rows}))


def row(recorded: Run, name: str, n_evaluations: int, options: argparse.Namespace) -> Row:
    """Return the errors of one estimator over the seeds."""
    truth = truth_at(recorded, options.at)
    groups = places_by_unit(recorded.scenario.estimation.space).values()
    errors: list[float] = []
    seconds: list[float] = []
    for seed in range(options.seeds):
        samples = noisy_samples(recorded, options.at, options.window, options.stride, np.random.default_rng([seed, 1]))
        rng = np.random.default_rng([seed, 2])
        by = closed_form if name == CLOSED_FORM else partial(solve, name=name, n_evaluations=n_evaluations, rng=rng)
        theta, wall = by(recorded, samples)
        seconds.append(wall)
        errors.append(max(float(np.linalg.norm((theta - truth)[g]) / np.linalg.norm(truth[g])) for g in groups))
    return {
        "estimator": name,
        "evaluations": n_evaluations,
        "median": float(np.median(errors)),
        "worst": max(errors),
        "within_5_percent": float(np.mean(np.array(errors) <= 0.05)),
        "milliseconds": 1e3 * float(np.median(seconds)),
        "errors": errors,
    }


def places_by_unit(space: ParameterSpace) -> dict[str, list[int]]:
    """Return the places of the parameters of each unit."""
    places: dict[str, list[int]] = {}
    for i, parameter in enumerate(space):
        places.setdefault(parameter.unit, []).append(i)
    return places


def truth_at(recorded: Run, at: float) -> Vector:
    """Return the plant's parameters theta (d,) in force at this time [s]."""
    return np.array([series[_row_at(recorded, at)] for series in recorded.true_parameters.values()])


def noisy_samples(recorded: Run, at: float, window: int, stride: int, rng: np.random.Generator) -> list[Sample]:
    """Return the last samples up to a time [s], stride steps apart: the plant's derivatives with fresh noise."""
    k = _row_at(recorded, at)
    rows = [*reversed(range(k, max(k - window * stride, 0), -stride))]
    derivatives = recorded.scenario.sampling.derivatives
    exact = np.array([[recorded.series[name][k] for name in derivatives] for k in rows])
    noisy = exact + np.array([n.noise for n in derivatives.values()]) * rng.standard_normal(exact.shape)
    clean = recorded_samples(recorded.scenario, recorded.plant, recorded.series, rows)
    return [replace(s, xdot=tuple(y)) for s, y in zip(clean, noisy.tolist(), strict=True)]


def residual_window(recorded: Run, samples: list[Sample], is_whitened: bool) -> ResidualWindow:
    """Return the residuals on these samples, in standard deviations of the noise or in physical units."""
    scenario = recorded.scenario
    sigma = tuple(n.noise if is_whitened else 1.0 for n in scenario.sampling.derivatives.values())
    model = load(scenario.estimation.model, scenario.folder)
    residual = DerivativeResidual(model, scenario.estimation.space, recorded.plant.channels, sigma)
    window = ResidualWindow(residual, len(sigma), len(samples))
    for sample in samples:
        window.append(sample)
    return window


def solve(
    recorded: Run, samples: list[Sample], name: str, n_evaluations: int, rng: np.random.Generator
) -> tuple[Vector, float]:
    """Return theta (d,) after so many evaluations from the nominal parameters, and the wall time [s]."""
    begun = perf_counter()
    estimate = estimated(recorded, samples, name, n_evaluations, rng)
    return estimate.theta, perf_counter() - begun


def estimated(
    recorded: Run, samples: list[Sample], name: str, n_evaluations: int, rng: np.random.Generator
) -> Estimate:
    """Return the estimate after so many evaluations from the nominal parameters."""
    scenario = recorded.scenario
    space = scenario.estimation.space
    method = find_method(name, scenario)
    settings = scenario.estimation.settings(name)
    if isinstance(settings, LeastSquaresSettings):
        settings = replace(settings, max_evaluations=n_evaluations)
    if name == "multi-start":
        settings = replace(settings, n_starts=n_evaluations)
    start = np.array([series[0] for series in recorded.estimates.values()])
    search = method.estimator(space, start, rng, settings)
    window = residual_window(recorded, samples, search.is_whitened)
    search.restart(start)
    if isinstance(search, AskTell):
        for _ in range(n_evaluations):
            theta = search.ask()
            search.tell(theta, window.residual(theta))
    else:
        search.solve(Objective(window))
    return search.estimate()


def closed_form(recorded: Run, samples: list[Sample]) -> tuple[Vector, float]:
    """Return theta (d,) from the model's linear form by one linear least squares, and the wall time [s] of that."""
    scenario = recorded.scenario
    linear = scenario.estimation.linear
    if linear is None:
        raise SystemExit(f"{scenario.scenario.name} has no estimation.linear: leave {CLOSED_FORM} out.")
    rows_of, coefficients_of = (load(name, scenario.folder) for name in (linear.rows, linear.coefficients))
    form = LinearForm(scenario.estimation.space, rows_of, coefficients_of)
    begun = perf_counter()
    rows, targets = zip(*(form.rows(s) for s in samples), strict=True)
    coefficients = np.linalg.lstsq(np.vstack(rows), np.concatenate(targets), rcond=None)[0]
    seconds = perf_counter() - begun
    space = scenario.estimation.space
    fit = least_squares(
        lambda z: form.coefficients(space.from_unit(z)) / coefficients - 1.0,
        np.full(len(space), 0.5),
        bounds=(0.0, 1.0),
    )
    return space.from_unit(fit.x), seconds


def _row_at(recorded: Run, at: float) -> int:
    return int(np.searchsorted(recorded.time, at - 1e-9))


if __name__ == "__main__":
    main()
