"""Cost of an evaluation as the problem grows, and memory and speed over an hour.

    python -m benchmarks.scaling growth [--estimators target bo-scalar paper] [--seeds 3]
    python -m benchmarks.scaling endurance [--steps 360000] [--limit SECONDS]

`growth` runs our own loop (`Retuner`: one evaluation per macro step, every stored candidate scored again on each new
sample) on a synthetic plant whose parameters are known. The cost of an evaluation is the processor time of asking for a
candidate, scoring it, telling its score and making the estimate; on an idle machine that is the wall time, and a busy
one does not change it. Each size is varied alone from a base case; the exponent is the slope of log cost over log size.
`endurance` runs the pendulum, recorded, each FMU in its own process, with a mass and a length that change every ten
seconds; Linux only. Every 10,000 macro steps it notes the resident memory of this process and of those of the FMUs.
Interrupted, or at its limit, it reports what it has so far.
"""

import argparse
import math
import os
import tempfile
import tracemalloc
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter, thread_time
from typing import Any, NamedTuple

import numpy as np

from benchmarks.report import spread, write
from cosim.blas_threads import one_thread
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario
from estimator import METHODS, DerivativeResidual, Parameter, ParameterSpace, ResidualWindow, Sample
from estimator.retuning.retuner import Retuner
from estimator.retuning.search import Budget
from estimator.triggers import AlwaysTrigger

SIGMA = 1e-3
"""Standard deviation of the noise of the synthetic plant's derivatives."""
MOST_SCALAR = 60
"""Observations up to which the scalar methods are measured: GPy's fits are cubic in them."""
BLOCK = 10_000
"""Macro steps between two readings of the memory."""
RECURRING = {
    "changes.'plant.m'": "1.75 if t % 20 < 10 else 4.271",
    "changes.'plant.l'": "0.75 if t % 20 < 10 else 0.981",
    "estimation.instants": "[]",
    "estimation.budget": "15",
}
"""Overrides that repeat and undo the pendulum's change every ten seconds, with half the evaluations."""


class Size(NamedTuple):
    """Size of a problem."""

    observations: int = 60
    dimensions: int = 4
    channels: int = 6
    window: int = 5


SIZES: dict[str, tuple[int, ...]] = {
    "observations": (15, 30, 60, 125, 250, 500),
    "dimensions": (2, 4, 6, 8, 12),
    "channels": (3, 6, 12, 24, 48),
    "window": (1, 5, 10, 20, 50),
}


def main() -> None:
    """Measure growth or endurance."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    grow = commands.add_parser("growth")
    grow.add_argument("--estimators", nargs="+", default=["target", "bo-scalar", "paper"])
    grow.add_argument("--seeds", type=int, default=3)
    grow.set_defaults(command=lambda o: growth(o.estimators, o.seeds))
    endure = commands.add_parser("endurance")
    endure.add_argument("--steps", type=int, default=360_000)
    endure.add_argument("--limit", type=float, default=math.inf, help="wall time after which to stop [s]")
    endure.set_defaults(command=lambda o: endurance(o.steps, o.limit))
    options = parser.parse_args()
    options.command(options)


def growth(estimators: Sequence[str], n_seeds: int, sizes: Mapping[str, Sequence[int]] = SIZES) -> None:
    """Vary each size alone, for each estimator; print and keep the costs."""
    rows: list[dict[str, object]] = []
    fits: list[str] = []
    with one_thread():
        for name in estimators:
            for what, values in sizes.items():
                if what == "observations" and name != "target":
                    values = [v for v in values if v <= MOST_SCALAR]
                of_size = [_row(name, what, Size()._replace(**{what: v}), n_seeds) for v in values]
                rows += of_size
                fits.append(f"{name}: {exponents(what, values, of_size)}")
    write("scaling", rows, "exponents of the median:\n" + "\n".join(fits))


def exponents(what: str, values: Sequence[int], rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the slope of log cost over log size, as text: fitted to all sizes, and between the last two."""
    x, y = np.log(values), np.log([r["ms"]["median"] for r in rows])
    if len(x) < 2:
        return f"{what}: one size only"
    return f"{what} {np.polyfit(x, y, 1)[0]:.2f}, {(y[-1] - y[-2]) / (x[-1] - x[-2]):.2f} at the end"


def _row(name: str, what: str, size: Size, n_seeds: int) -> dict[str, object]:
    """Return the cost of the last third of the evaluations, at most 60: those with about this many observations."""
    last = min(max(size.observations // 3, 1), 60)
    milliseconds: list[float] = []
    errors: list[float] = []
    for seed in range(n_seeds):
        retuner, samples, truth = synthetic(name, size, seed)
        estimate, held = None, np.ones(size.dimensions)
        for k, sample in enumerate(samples):
            begun = thread_time()
            proposal = retuner.step(sample.t, sample, 0.0, held)
            estimate = proposal.estimate or estimate  # between searches there is one where it is worth a write
            held = held if proposal.theta is None else proposal.theta
            if k >= len(samples) - last:
                milliseconds.append(1e3 * (thread_time() - begun))
        assert estimate is not None
        errors.append(float(np.max(np.abs(estimate.theta / truth - 1.0))))
    return {
        "estimator": name,
        "varied": what,
        **size._asdict(),
        "ms": spread(milliseconds),
        "error": spread(errors),
        "memory [KiB]": _memory(name, size),
    }


def _memory(name: str, size: Size) -> float:
    """Return the memory that Python holds after the evaluations, less that before them [KiB]."""
    tracemalloc.start()
    try:
        retuner, samples, _ = synthetic(name, size, 0)
        before, held = tracemalloc.get_traced_memory()[0], np.ones(size.dimensions)
        for sample in samples:
            proposal = retuner.step(sample.t, sample, 0.0, held)
            held = held if proposal.theta is None else proposal.theta
        return (tracemalloc.get_traced_memory()[0] - before) / 1024.0
    finally:
        tracemalloc.stop()


def synthetic(name: str, size: Size, seed: int) -> tuple[Retuner, list[Sample], np.ndarray]:
    """Return a loop that never idles, a sample for each evaluation, and the plant's theta (d,).

    xdot = Phi(x) tanh(log theta), a smooth model whose rows Phi differ from sample to sample: every theta is seen.
    """
    rng = np.random.default_rng(seed)
    d, c = size.dimensions, size.channels
    space = ParameterSpace(tuple(Parameter(f"p{i}", 0.2, 5.0, "1", "log") for i in range(d)))

    def model(x: Sequence[float], u: Sequence[float], **theta: float) -> list[float]:
        return (np.reshape(x, (c, d)) @ np.tanh(np.log([*theta.values()]))).tolist()

    truth = np.exp(rng.uniform(-0.7, 0.7, d))
    samples: list[Sample] = []
    for k in range(size.observations):
        x = tuple(rng.standard_normal(c * d).tolist())
        exact = model(x, (), **space.named(truth))
        samples.append(Sample(0.01 * k, x, (), tuple(y + SIGMA * e for y, e in zip(exact, rng.standard_normal(c)))))
    method = METHODS[name]
    settings = method.settings(**{k: v for k, v in method.defaults.items() if k in method.setting_names})
    search = method.estimator(space, np.ones(d), rng, settings)
    residual = DerivativeResidual(model, space, tuple(range(c)), (SIGMA if search.is_whitened else 1.0,) * c)
    window = ResidualWindow(residual, c, size.window)
    return Retuner(search, window, AlwaysTrigger(), Budget(math.inf)), samples, truth


def endurance(n_steps: int, limit: float = math.inf) -> None:
    """Run the pendulum; print and keep a row for each block of macro steps."""
    scenario = Scenario.load("pendulum", RECURRING | {"scenario.stop_time": repr(0.01 * n_steps)})
    watch = Watch(min(BLOCK, max(n_steps // 4, 1)), limit)
    with tempfile.TemporaryDirectory() as folder:
        try:
            result = run(scenario, "target", 0, Path(folder), watch)
            ended = f"{result.status}, {result.n_episodes} episodes, {result.n_evaluations} evaluations"
        except KeyboardInterrupt:
            ended = "stopped early"
    half = [row for row in watch.rows if row["steps"] > watch.rows[-1]["steps"] / 2] if watch.rows else []
    slopes = [
        f"{name}: {np.polyfit([r['steps'] for r in half], [1024 * r[name] for r in half], 1)[0] * 1e5:+.0f} KiB"
        for name in (PARENT, CHILDREN)
        if len(half) > 1
    ]
    write("endurance", watch.rows, f"{ended}; over the last half, per 100,000 steps: {', '.join(slopes) or '-'}")


PARENT, CHILDREN = "this process [MiB]", "the FMUs' [MiB]"


class Watch:
    """Progress of a run that takes the time of each macro step, and the memory after each block of them."""

    def __init__(self, block: int, limit: float) -> None:
        self.rows: list[dict[str, Any]] = []
        self._times = np.empty(block + 1)
        self._n = 0
        self._begun, self._limit = perf_counter(), limit

    def __call__(self, t: float, held: Mapping[str, float]) -> None:
        now = perf_counter()
        self._times[self._n] = now
        if self._n < len(self._times) - 1:
            self._n += 1
            return
        taken = 1e3 * np.diff(self._times)
        done = (self.rows[-1]["steps"] if self.rows else 0) + len(taken)
        self.rows.append({
            "steps": done, "t [s]": round(t, 2), PARENT: _resident(os.getpid()),
            CHILDREN: sum(map(_resident, _children())),
            "step, median [ms]": float(np.median(taken)), "step, mean [ms]": float(np.mean(taken)),
            "step, 99 % [ms]": float(np.quantile(taken, 0.99)),
        })  # fmt: skip
        if now - self._begun > self._limit:
            raise KeyboardInterrupt
        self._times[0], self._n = perf_counter(), 1


def _resident(process_id: int) -> float:
    """Return the resident memory of a process [MiB]."""
    pages = int(Path(f"/proc/{process_id}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def _children() -> list[int]:
    return [int(n) for f in Path("/proc/self/task").glob("*/children") for n in f.read_text(encoding="ascii").split()]


if __name__ == "__main__":
    main()
