"""Accuracy and CPU time a sample of moving-horizon estimators, ours and other people's, on streams of frozen samples.

    python -m benchmarks.horizon [--seeds N] [--samples N] [--spreads 0.05 0.3]

The samples are those of the nominal controller's run after a jump of the parameters, one macro step apart, with fresh
noise for each seed; each estimator starts from the controller's parameters and takes one after the other. An error is
the largest relative one of all parameters at a sample; a row has its median over the second half of the stream and over
the seeds, and the CPU time a sample. The spread is what all but `target` take for the start's standard deviation, as a
share of the scaled bounds: 0.05 is the filters' default, 0.3 allows for the jump; they let parameters walk by 0.003 a
sample. `target` is the whole loop with an innovation trigger, its searches included; what it takes in a search shows in
the largest time. A peer that is not installed is named and left out.
"""

import argparse
import importlib.util
from collections.abc import Callable
from time import process_time
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.frozen import noisy_samples, truth_at
from benchmarks.horizon_peers import PEERS, Problem, pendulum, quadrotor
from benchmarks.report import Row
from cosim.blas_threads import one_thread
from cosim.retuning.estimators import find_method, make_estimator
from cosim.runs.result import Run
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario
from cosim.user_code import load
from estimator import DerivativeResidual, Sample, Vector
from estimator.baselines.moving_horizon import MovingHorizonSettings
from estimator.retuning.factory import make_retuner
from estimator.retuning.search import Budget

OURS = ("mhe", "ukf", "enkf", "target")
STREAMS: dict[str, tuple[float, Callable[..., Any], int, int]] = {
    "pendulum": (5.0, pendulum, 2, 1),
    "quadrotor": (5.9, quadrotor, 18, 4),
}
"""Time of the newest sample [s], the model in CasADi's symbols, its numbers of states and inputs, by scenario."""
_MODULES = {"do-mpc": "do_mpc", "casadi-ipopt": "casadi"}
_INNOVATION = {"estimation.trigger": '{ kind = "innovation", false_alarm = 1e-6 }', "scenario.isolation": "none"}


def main() -> None:
    """Measure each estimator on each stream, print and keep the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--samples", type=int, default=100)
    parser.add_argument("--spreads", type=float, nargs="+", default=[0.05, 0.3])
    options = parser.parse_args()
    absent = [name for name, module in _MODULES.items() if not importlib.util.find_spec(module)]
    notes = "".join(f"{name}: absent, pip install '.[peers]'\n" for name in absent)
    names = [*OURS, *(name for name in PEERS if name not in absent)]
    with one_thread():
        rows = [
            row
            for scenario in STREAMS
            for spread in options.spreads
            for row in measured(scenario, names, spread, options.seeds, options.samples)
        ]
    report.write("horizon", report.updated("horizon", rows, "stream", "spread", "estimator"), notes)


def measured(scenario: str, names: list[str], spread: float, n_seeds: int, n_samples: int) -> list[Row]:
    """Return a row for each estimator on one stream; estimators take turns."""
    at = STREAMS[scenario][0]
    spreads = {f"estimation.{name}.spread": str(spread) for name in ("mhe", "ukf", "enkf")}
    recorded = run(Scenario.load(scenario, _INNOVATION | spreads), "none")
    truth = truth_at(recorded, at)
    errors: dict[str, list[Vector]] = {name: [] for name in names}
    seconds: dict[str, list[float]] = {name: [] for name in names}
    for seed in range(n_seeds):
        samples = noisy_samples(recorded, at, n_samples, 1, np.random.default_rng([seed, 1]))
        for name in names:
            step = stepper(recorded, name, scenario, spread, seed)
            for sample in samples:
                begun = process_time()
                theta = step(sample)
                seconds[name].append(process_time() - begun)
                errors[name].append(np.abs(theta / truth - 1.0))
    return [{"stream": scenario, "spread": spread} | _row(name, errors[name], seconds[name], n_seeds) for name in names]


def stepper(recorded: Run, name: str, scenario: str, spread: float, seed: int) -> Callable[[Sample], Vector]:
    """Return a new estimator as a function that takes a sample and returns theta (d,)."""
    settings = recorded.scenario.estimation
    start = np.array([series[0] for series in recorded.estimates.values()])
    noise = tuple(n.noise for n in recorded.scenario.sampling.derivatives.values())
    if name in PEERS:
        _, symbols, n_states, n_inputs = STREAMS[scenario]
        horizon = MovingHorizonSettings(spread=spread)
        return PEERS[name](Problem(settings.space, start, noise, symbols, horizon, n_states, n_inputs)).step
    search, loop = make_estimator(
        name, find_method(name, recorded.scenario), recorded.scenario, start, np.random.default_rng([seed, 2])
    )
    assert settings.model is not None
    model = load(settings.model, recorded.scenario.folder)
    whitened = DerivativeResidual(model, settings.space, recorded.plant.channels, noise)
    budget = Budget(loop.budget, loop.evaluations_per_step, loop.commit)
    retuner, held = make_retuner(search, whitened, loop.trigger, budget, loop.window), start

    def step(sample: Sample) -> Vector:
        nonlocal held
        proposal = retuner.step(sample.t, sample, 0.0, held)
        held = held if proposal.theta is None else proposal.theta
        return held

    return step


def _row(name: str, errors: list[Vector], seconds: list[float], n_seeds: int) -> Row:
    worst = np.max(np.array(errors).reshape(n_seeds, -1, errors[0].size), axis=2)
    milliseconds = 1e3 * np.array(seconds)
    return {
        "estimator": name,
        "seeds": n_seeds,
        "median error": float(np.median(worst[:, worst.shape[1] // 2 :])),
        "error at the end, worst seed": float(worst[:, -1].max()),
        "ms a sample": report.spread(milliseconds),
        "mean ms": float(milliseconds.mean()),
        "largest ms": float(milliseconds.max()),
    }


if __name__ == "__main__":
    main()
