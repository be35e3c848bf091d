"""Our estimators and other people's Bayesian optimisers on the same frozen windows: time of a whole search, and errors.

    python -m benchmarks.estimators                                       # all: 15 minutes
    python -m benchmarks.estimators --only target bo-scalar paper pybads --problems pendulum

A repetition is a draw of the samples' noise. All methods search it one after the other, each in a process of its own
that has imported its packages and made one short search before any clock starts; one BLAS and torch thread each. The
time is that of building the optimiser and of all its evaluations; `over target` is its median divided by that of
`target` in the same measurement. Errors are those of the best evaluation (ours: of the estimate), in norm over the
parameters of one unit. The rows take the place of older ones of the same problem and method in
benchmarks/results/estimators.json.
"""

import argparse
import multiprocessing
import os
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from multiprocessing.connection import Connection
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.estimator_peers import PEERS, UnitObjective
from benchmarks.frozen import noisy_samples, places_by_unit, residual_window, solve, truth_at
from cosim.runs.result import Run
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario

OURS = ("target", "bo-scalar", "paper")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_WARM_UP = 8
"""Evaluations of the search that is not timed: the initial places and three that a surrogate has chosen."""
_OTHER_NOISE = 1000
"""Repetition of that search; no timed one has its noise."""
_ERRORS = ("m error [kg]", "J error [kg.m2]", "l error [m]")
"""Columns of the errors, by the parameters' unit."""


@dataclass(frozen=True)
class Problem:
    """A frozen window of a scenario's run with the nominal controller."""

    scenario: str
    """Its name."""
    at: tuple[float, ...]
    """Times of the newest sample [s], taken in turn by the repetitions; the parameters were constant before it."""
    window: int
    """Samples."""
    stride: int
    """Macro steps between them."""


PROBLEMS = {
    "quadrotor-sample": Problem("quadrotor", (5.0, 11.0), 1, 1),
    "quadrotor-window": Problem("quadrotor", (5.0, 11.0), 10, 5),
    "pendulum": Problem("pendulum", (4.0,), 30, 1),
}


@dataclass(frozen=True)
class Search:
    """Result of one method in one repetition."""

    seconds: float
    """Wall time of the whole search."""
    errors: dict[str, float]
    """Norm of estimated minus true, by column of the table."""
    n_evaluations: int
    """Number of evaluations."""


def main(arguments: list[str] | None = None) -> None:
    """Measure the methods asked for, keep and print the rows."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.evaluations < _WARM_UP or options.repetitions < 1:
        parser.error(f"--evaluations must be at least {_WARM_UP}, and --repetitions 1.")
    if options.list:
        for name in (*OURS, *PEERS):
            print(f"{name:22} {_version(name) or 'absent: ' + _install()}")
        return
    rows = [row for problem in options.problems for row in measure(problem, options)]
    report.write("estimators", _with_earlier(rows), _notes(options))


def measure(problem: str, options: argparse.Namespace) -> Iterator[report.Row]:
    """Yield a row for each method, all measured in turns."""
    recorded = run(Scenario.load(PROBLEMS[problem].scenario), "none")
    searches: dict[str, list[Search]] = {name: [] for name in options.only}
    failed = {name: f"absent: {_install()}" for name in options.only if not _version(name)}
    with ExitStack() as stack:
        ask = {
            name: stack.enter_context(_worker(name, problem, recorded, options.limit))
            for name in options.only
            if name not in failed
        }
        warm_up = (_WARM_UP, _OTHER_NOISE)
        for job in [warm_up, *((options.evaluations, repetition) for repetition in range(options.repetitions))]:
            for name in ask:
                if name in failed or sum(s.seconds for s in searches[name]) > options.patience:
                    continue
                done = ask[name](*job)
                if isinstance(done, str):
                    failed[name] = done
                elif job != warm_up:
                    searches[name].append(done)
                    print(f"{problem} {job[1]} {name}: {done.seconds:.3f} s", file=sys.stderr)
    target = np.median([s.seconds for s in searches.get("target", [])] or [np.nan])
    for name in options.only:
        yield _row(problem, name, searches[name], float(target), failed.get(name, ""))


def _row(problem: str, name: str, searches: list[Search], target: float, failure: str) -> report.Row:
    time = report.spread(1e3 * s.seconds for s in searches)
    errors = {c: report.spread(s.errors[c] for s in searches if c in s.errors) for c in _ERRORS}
    return {
        "problem": problem,
        "method": name,
        "version": _version(name) or "",
        "time [ms]": time,
        "over target": time["median"] / (1e3 * target),
        **{column: error if error["n"] else None for column, error in errors.items()},
        "evaluations": max((s.n_evaluations for s in searches), default=0),
        "repetitions": len(searches),
        "failure": failure,
    }


def _with_earlier(rows: list[report.Row]) -> list[report.Row]:
    """Return the rows and those of earlier measurements, in the order of problems and methods.

    A method that failed now keeps the row of a measurement that succeeded.
    """
    measured = {(r["problem"], r["method"]) for r in report.stored(report.RESULTS, "estimators") if r["repetitions"]}
    new = [row for row in rows if row["repetitions"] or (row["problem"], row["method"]) not in measured]
    names = (*OURS, *PEERS)
    known = [r for r in report.updated("estimators", new, "problem", "method") if r["method"] in names]
    return sorted(known, key=lambda r: (list(PROBLEMS).index(r["problem"]), names.index(r["method"])))


@contextmanager
def _worker(name: str, problem: str, recorded: Run, limit: float) -> Generator[Callable[[int, int], Search | str]]:
    """Yield ask(n_evaluations, repetition), which returns a search in its own process, or the reason of its failure."""
    context = multiprocessing.get_context("spawn")  # a fresh interpreter: no import of one peer meets another's
    ours, theirs = context.Pipe()
    os.environ.update(dict.fromkeys(_THREADS, "1"))  # read when NumPy and torch are imported, there
    process = context.Process(target=_work, args=(theirs, name, problem, recorded), daemon=True)
    process.start()
    theirs.close()

    def ask(n_evaluations: int, repetition: int) -> Search | str:
        try:
            ours.send((n_evaluations, repetition))
            if ours.poll(limit):
                return ours.recv()
        except (EOFError, OSError):
            process.join()
            return f"its process ended with exit code {process.exitcode}"
        process.terminate()
        return f"no answer after {limit:.0f} s"

    try:
        yield ask
    finally:
        process.terminate()
        process.join()


def _work(pipe: Connection, name: str, problem: str, recorded: Run) -> None:
    """Make the searches asked for through the pipe, until the process is ended."""
    with open(os.devnull, "w") as nowhere:  # peers print
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
    search = _ours if name in OURS else _theirs
    while True:
        job = pipe.recv()
        try:
            pipe.send(search(name, problem, recorded, *job))
        except Exception as e:  # whatever a peer raises
            pipe.send(f"{type(e).__name__}: {' '.join(str(e).split())[:200]}")


def _ours(name: str, problem: str, recorded: Run, n_evaluations: int, repetition: int) -> Search:
    at, samples = _samples(problem, recorded, repetition)
    theta, seconds = solve(recorded, samples, name, n_evaluations, np.random.default_rng([repetition, 2]))
    return Search(seconds, _errors(recorded, theta - truth_at(recorded, at)), n_evaluations)


def _theirs(name: str, problem: str, recorded: Run, n_evaluations: int, repetition: int) -> Search:
    at, samples = _samples(problem, recorded, repetition)
    objective = UnitObjective(recorded.scenario.estimation.space, residual_window(recorded, samples, False))
    begun = perf_counter()
    PEERS[name].search(objective, n_evaluations, repetition)
    seconds = perf_counter() - begun
    return Search(seconds, _errors(recorded, objective.theta - truth_at(recorded, at)), objective.n_evaluations)


def _samples(problem: str, recorded: Run, repetition: int) -> tuple[float, list[Any]]:
    chosen = PROBLEMS[problem]
    at = chosen.at[repetition % len(chosen.at)]
    rng = np.random.default_rng([repetition, 1])
    return at, noisy_samples(recorded, at, chosen.window, chosen.stride, rng)


def _errors(recorded: Run, error: np.ndarray) -> dict[str, float]:
    """Return the norm of the error (d,) over the parameters of each unit, by column."""
    space = recorded.scenario.estimation.space
    return {
        f"{space.names[places[0]].split('_')[0]} error [{unit}]": float(np.linalg.norm(error[places]))
        for unit, places in places_by_unit(space).items()
    }


def _version(name: str) -> str | None:
    """Return the version of a method's package; None if it is not installed."""
    if name in OURS:
        return version("fmu-retune")
    peer = PEERS[name]
    return version(peer.package) if find_spec(peer.module) else None


def _install() -> str:
    return "pip install '.[peers]'"


def _notes(options: argparse.Namespace) -> str:
    return (
        f"N = {options.evaluations} evaluations. Median [quartiles]. `over target`: by target's time in the same "
        f"measurement. A method that has spent {options.patience:.0f} s on a problem gets no further repetition."
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.estimators",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    names = (*OURS, *PEERS)
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=names, default=names, help=", ".join(names))
    parser.add_argument("--problems", nargs="+", choices=PROBLEMS, default=tuple(PROBLEMS))
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--evaluations", type=int, default=30, help="of one search; at least 8")
    parser.add_argument("--patience", type=float, default=60.0, help="seconds after which a method is not repeated")
    parser.add_argument("--limit", type=float, default=300.0, help="seconds after which a search is given up")
    parser.add_argument("--list", action="store_true", help="name the methods and what is installed, and end")
    return parser


if __name__ == "__main__":
    main()
