"""Benefit and cost of the guard: each case with it, without it, and with the nominal controller.

    python -m benchmarks.guard [--pendulum 200] [--quadrotor 20] [--only CASE ...]
    python -m benchmarks.guard --table

Without the guard means without the screen of the samples, too. The FMUs run in this process, which changes no bit of
the values, and the scenarios are short: pendulum 2 s with the change at 0.5 s, quadrotor 8 s. A run counts as lost when
a tracking error passes half a turn, or 20 m. Every run is kept in raw/guard.json, from where an interrupted measurement
goes on; results/guard.json has a row for each case, which `--table` prints.
"""

import argparse
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from math import hypot
from typing import Final

import numpy as np

from benchmarks import report
from benchmarks.report import Row
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario
from fmu_models import quadrotor

Task = tuple[str, str, str, int]
"""Scenario, case, mode and seed of a run."""
MODES: Final = ("none", "unguarded", "guarded")
_BASE: Final[Mapping[str, dict[str, str]]] = {
    "pendulum": {
        "scenario.stop_time": "2.0",
        'changes."plant.m"': "[[0.0, 1.75], [0.5, 4.271]]",
        'changes."plant.l"': "[[0.0, 0.75], [0.5, 0.981]]",
        "limits.divergence": "3.14159265",
    },
    "quadrotor": {"scenario.stop_time": "8.0", "limits.divergence": "20.0"},
}
_CHANNELS: Final = {
    "pendulum": ("der(phi_dot)",),
    "quadrotor": tuple(f"der({v}_{a})" for v in ("v", "Omega") for a in "xyz"),
}
_LAST: Final = {"pendulum": ("der(phi_dot)",), "quadrotor": ("der(v_z)",)}
"""Derivatives that fail alone."""


def linear_pendulum(x: tuple[float, ...], u: tuple[float, ...], m: float, l: float) -> tuple[float, ...]:
    """Return the time derivative of a pendulum of wrong structure: small angles, no friction."""
    return x[1], -9.81 / l * x[0] + u[0] / (m * l)


def draggy_quadrotor(
    x: tuple[float, ...], u: tuple[float, float, float, float], **parameters: float
) -> tuple[float, ...]:
    """Return the derivative of a quadrotor of wrong structure: drag of 0.3 /s, and 1 rad/s2 about the body's z axis."""
    rates = list(quadrotor.derivative(x, u, **parameters))
    rates[3:6] = [rate - 0.3 * v for rate, v in zip(rates[3:6], x[3:6], strict=True)]
    return (*rates[:-1], rates[-1] + 1.0)


def _faults(kind: str, names: Mapping[str, tuple[str, ...]], scenario: str, rest: str = "") -> dict[str, str]:
    faults = [f'{{kind = "{kind}", sensor = "plant.{name}"{rest}}}' for name in names[scenario]]
    return {"sampling.faults": f"[{', '.join(faults)}]"}


def overrides(case: str, name: str) -> dict[str, str]:
    """Return the changes that a case makes to a scenario, as for `--set`."""
    is_pendulum = name == "pendulum"
    match case:
        case "noise":
            return _faults("noise", _CHANNELS, name, f", size = {1e-2 if is_pendulum else 1.3e-2}")
        case "dropout":
            return _faults("dropout", _CHANNELS, name, ", probability = 0.3")
        case "bias":
            return _faults("bias", _LAST, name, ", size = 1.0")
        case "spikes":
            return _faults("spikes", _LAST, name, ", size = 20.0, probability = 0.05")
        case "delay":
            return _faults("delay", _CHANNELS, name, ", steps = 10")
        case "sign":
            return _faults("sign", _CHANNELS, name)
        case "jump":
            if not is_pendulum:
                return {'changes."plant.m"': "[[0.0, 1.25], [3.0, 1.85], [3.05, 2.6]]"}
            return {
                'changes."plant.m"': "[[0.0, 1.75], [0.5, 4.271], [0.75, 1.0]]",
                'changes."plant.l"': "[[0.0, 0.75], [0.5, 0.981], [0.75, 1.2]]",
            }
        case "structure":
            return {"estimation.model": f"benchmarks.guard:{'linear_pendulum' if is_pendulum else 'draggy_quadrotor'}"}
        case _:
            return {}


CASES: Final = {
    "undisturbed": "nothing but what the scenario does",
    "paper": "`paper`, which writes every candidate",
    "bounds": "the mass's upper bound below the truth: 2.5 kg, 1.5 kg",
    "noise": "10 times the declared noise",
    "dropout": "30 % of the derivatives not a number",
    "bias": "1 rad/s2, 1 m/s2 on one derivative",
    "spikes": "+-20 on one derivative, in 5 % of the samples",
    "delay": "derivatives 10 samples old, with a fresh time stamp",
    "sign": "derivatives multiplied by -1",
    "jump": "a second change of the plant inside the episode",
    "structure": "a model of wrong structure",
}


def scenario_of(case: str, name: str, mode: str) -> Scenario:
    """Return the short scenario of a case; mode: one of MODES."""
    switched = {} if mode == "guarded" else {"guard.enabled": "false", "observations.enabled": "false"}
    chosen = _BASE[name] | overrides(case, name) | {"scenario.isolation": "none"} | switched
    scenario = Scenario.load(name, chosen)
    if case != "bounds":
        return scenario
    mass, *others = scenario.estimation.parameters
    narrow = mass.model_copy(update={"upper": 2.5 if name == "pendulum" else 1.5})
    estimation = scenario.estimation.model_copy(update={"parameters": (narrow, *others)})
    return scenario.model_copy(update={"estimation": estimation})


def measure(task: Task) -> Row:
    """Return a run's mean squared error (summed over the outputs), its largest error (norm) and the guard's counts."""
    name, case, mode, seed = task
    estimator = "none" if mode == "none" else "paper" if case == "paper" else "target"
    result = run(scenario_of(case, name, mode), estimator, seed)
    largest = max(hypot(*errors) for errors in zip(*result.errors.values(), strict=True))
    return {
        **_labels(task), "status": result.status, "mse": _short(sum(result.mse)), "largest": _short(largest),
        **{kind: (result.guard or {}).get(kind, 0) for kind in ("written", "vetoed", "reverted")},
        "kept out": (result.observations or {}).get("kept_out", 0),
    }  # fmt: skip


def _labels(task: Task) -> Row:
    return dict(zip(("scenario", "case", "mode", "seed"), task, strict=True))


def _short(value: float) -> float:
    return float(f"{value:.5g}")


def main() -> None:
    """Measure what is missing, keep and print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pendulum", type=int, default=200, metavar="SEEDS")
    parser.add_argument("--quadrotor", type=int, default=20, metavar="SEEDS")
    parser.add_argument("--only", nargs="+", default=list(CASES), choices=list(CASES), metavar="CASE")
    parser.add_argument("--jobs", type=int, default=1, metavar="J", help="runs at a time; no number depends on it")
    parser.add_argument("--table", action="store_true", help="measure nothing")
    options = parser.parse_args()
    if options.table:
        print(report.table(report.stored(report.RESULTS, "guard")))
        return
    runs = with_missing(tasks(options.pendulum, options.quadrotor, options.only), options.jobs)
    report.write("guard", report.updated("guard", rows(runs), "scenario", "case"))


def with_missing(wanted: Iterable[Task], jobs: int) -> list[Row]:
    """Return all runs that there are after running those of the wanted ones that are missing."""
    runs = report.stored(report.RAW, "guard")
    known = {(r["scenario"], r["case"], r["mode"], r["seed"]) for r in runs}
    missing = [task for task in wanted if task not in known]
    with ProcessPoolExecutor(jobs) as pool:
        for n, row in enumerate(pool.map(measure, missing), 1):
            runs.append(row)
            if n % 5 == 0 or n == len(missing):
                report.keep(report.RAW, "guard", runs)
    return runs


def tasks(n_pendulum: int, n_quadrotor: int, cases: list[str]) -> Iterator[Task]:
    """Yield all runs, in an order in which every case has been run about as often at any time.

    The nominal controller needs no seed but the first, as neither noise nor faults reach it.
    """
    for seed in range(max(n_pendulum, 10 * n_quadrotor)):
        seeds = {"pendulum": seed} if seed < n_pendulum else {}
        if seed % 10 == 0 and seed // 10 < n_quadrotor:
            seeds["quadrotor"] = seed // 10
        for name, number in seeds.items():
            yield from ((name, case, mode, number) for case in cases for mode in MODES if mode != "none" or not number)


def rows(runs: Iterable[Row]) -> list[Row]:
    """Return a row for each scenario and case: runs, lost ones, median mean squared error, largest error of any run."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in runs:
        groups.setdefault((row["scenario"], row["case"], row["mode"]), []).append(row)
    made: list[Row] = []
    for name, case in product(_BASE, CASES):
        by_mode = {mode: groups.get((name, case, mode), []) for mode in MODES}
        if all(by_mode.values()):
            made.append({"scenario": name, "case": case} | _figures(by_mode))
    return made


def _figures(by_mode: Mapping[str, list[Row]]) -> Row:
    guarded = by_mode["guarded"]
    row: Row = {"runs": len(guarded)}
    for mode, of_mode in by_mode.items():
        row[f"{mode}: lost"] = sum(r["status"] != "done" for r in of_mode)
        row[f"{mode}: mse"] = float(np.median([r["mse"] for r in of_mode]))
        row[f"{mode}: largest"] = max(r["largest"] for r in of_mode)
    return row | {count: float(np.mean([r[count] for r in guarded])) for count in ("vetoed", "reverted", "kept out")}


if __name__ == "__main__":
    main()
