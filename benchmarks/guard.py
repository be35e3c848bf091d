"""What the guard prevents and what it costs: each case with it, without it, and with the nominal controller.

    python -m benchmarks.guard [--pendulum 200] [--quadrotor 20] [--only CASE ...]    # goes on where it was stopped
    python -m benchmarks.guard --table                                               # what there is so far

Without it means guard and screen of the samples off. The FMUs run in this process and the scenarios are short, which
changes no bit of the values: pendulum 2 s with the change at 0.5 s, quadrotor 8 s. A run counts as lost when a tracked
error passes half a turn, or 20 m. Every run is kept in results/guard.json, so that an interrupted measurement goes on.
"""

import argparse
import json
import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from math import hypot
from typing import Any, Final

import numpy as np

from benchmarks.report import RESULTS, machine, table
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario
from fmu_models import quadrotor

PATH: Final = RESULTS / "guard.json"
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
"""The sensor that a single fault is of."""


def linear_pendulum(x: tuple[float, ...], u: tuple[float, ...], m: float, l: float) -> tuple[float, ...]:
    """A model of wrong structure: small angles, no friction."""
    return x[1], -9.81 / l * x[0] + u[0] / (m * l)


def draggy_quadrotor(x: tuple[float, ...], u: Any, **parameters: float) -> tuple[float, ...]:
    """A model of wrong structure: a drag of 0.3 /s, and 1 rad/s2 about the body's z, that are not there."""
    rates = list(quadrotor.derivative(x, u, **parameters))
    rates[3:6] = [rate - 0.3 * v for rate, v in zip(rates[3:6], x[3:6], strict=True)]
    return (*rates[:-1], rates[-1] + 1.0)


def _faults(kind: str, names: Mapping[str, tuple[str, ...]], scenario: str, rest: str = "") -> dict[str, str]:
    faults = [f'{{kind = "{kind}", sensor = "plant.{name}"{rest}}}' for name in names[scenario]]
    return {"sampling.faults": f"[{', '.join(faults)}]"}


def overrides(case: str, name: str) -> dict[str, str]:
    """What a case changes in a scenario, as for `--set`."""
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
    """The short scenario of a case; mode: one of MODES."""
    switched = {} if mode == "guarded" else {"guard.enabled": "false", "observations.enabled": "false"}
    chosen = _BASE[name] | overrides(case, name) | {"scenario.isolation": "none"} | switched
    scenario = Scenario.load(name, chosen)
    if case != "bounds":
        return scenario
    mass, *others = scenario.estimation.parameters
    narrow = mass.model_copy(update={"upper": 2.5 if name == "pendulum" else 1.5})
    estimation = scenario.estimation.model_copy(update={"parameters": (narrow, *others)})
    return scenario.model_copy(update={"estimation": estimation})


def measure(case: str, name: str, mode: str, seed: int) -> list[Any]:
    """Status, mean squared error (summed over the outputs), largest norm of the error, and the guard's counts."""
    estimator = "none" if mode == "none" else "paper" if case == "paper" else "target"
    result = run(scenario_of(case, name, mode), estimator, seed)
    norms = [hypot(*errors) for errors in zip(*result.errors.values(), strict=True)]
    guard = result.guard or {}
    counts = [guard.get(kind, 0) for kind in ("written", "vetoed", "reverted")]
    kept_out = (result.observations or {}).get("kept_out", 0)
    return [result.status, _short(sum(result.mse)), _short(max(norms)), *counts, kept_out]


def _measured(task: tuple[str, str, str, int]) -> list[Any]:
    name, case, mode, seed = task
    return measure(case, name, mode, seed)


def _short(value: float) -> float:
    return float(f"{value:.5g}")


def main() -> None:
    """Parse, measure what is missing, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pendulum", type=int, default=200, metavar="SEEDS")
    parser.add_argument("--quadrotor", type=int, default=20, metavar="SEEDS")
    parser.add_argument("--only", nargs="+", default=list(CASES), choices=list(CASES), metavar="CASE")
    parser.add_argument("--jobs", type=int, default=1, metavar="J", help="runs at a time; no number depends on it")
    parser.add_argument("--table", action="store_true", help="measure nothing")
    options = parser.parse_args()
    found: dict[str, list[Any]] = json.loads(PATH.read_text(encoding="utf-8"))["runs"] if PATH.exists() else {}
    if not options.table:
        todo = [
            k for k in _tasks(options.pendulum, options.quadrotor, options.only) if "/".join(map(str, k)) not in found
        ]
        with ProcessPoolExecutor(options.jobs) as pool:
            for n, (task, row) in enumerate(zip(todo, pool.map(_measured, todo), strict=True), 1):
                found["/".join(map(str, task))] = row
                if n % 5 == 0 or n == len(todo):
                    _write(found)
    print(table(rows(found)))


def _tasks(n_pendulum: int, n_quadrotor: int, cases: list[str]) -> Iterator[tuple[str, str, str, int]]:
    """All runs, in an order in which every case has about as many at any time. The nominal controller needs no seed
    but the first, as neither noise nor faults reach it."""
    for seed in range(max(n_pendulum, 10 * n_quadrotor)):
        for name, number in (("pendulum", seed), ("quadrotor", seed // 10)):
            if number >= (n_pendulum if name == "pendulum" else n_quadrotor) or (name == "quadrotor" and seed % 10):
                continue
            yield from ((name, case, mode, number) for case in cases for mode in MODES if mode != "none" or not number)


def _write(found: Mapping[str, list[Any]]) -> None:
    RESULTS.mkdir(exist_ok=True)
    content = {"benchmark": "guard", "machine": machine(), "columns": list(_COLUMNS), "runs": found}
    text = json.dumps(content, separators=(",", ":")).replace('"runs":{', '"runs":{\n').replace('],"', '],\n"')
    temporary = PATH.with_suffix(f".{os.getpid()}.tmp")
    temporary.write_text(text + "\n", encoding="utf-8")
    temporary.replace(PATH)


_COLUMNS: Final = ("status", "mse", "largest error", "written", "vetoed", "reverted", "samples kept out")


def rows(found: Mapping[str, list[Any]]) -> list[dict[str, object]]:
    """A row a scenario and case: runs, lost ones, median mean squared error and largest error of any run."""
    made: list[dict[str, object]] = []
    for name in _BASE:
        for case in CASES:
            of = {mode: [v for k, v in found.items() if k.startswith(f"{name}/{case}/{mode}/")] for mode in MODES}
            if not all(of.values()):
                continue
            row: dict[str, object] = {"scenario": name, "case": case, "runs": len(of["guarded"])}
            for mode in MODES:
                row[f"{mode}: lost"] = sum(v[0] != "done" for v in of[mode])
                row[f"{mode}: mse"] = float(np.median([v[1] for v in of[mode]]))
                row[f"{mode}: largest"] = max(v[2] for v in of[mode])
            row |= {"vetoed": _mean(of["guarded"], 4), "reverted": _mean(of["guarded"], 5)}
            row["kept out"] = _mean(of["guarded"], 6)
            made.append(row)
    return made


def _mean(runs: list[list[Any]], column: int) -> float:
    return float(np.mean([v[column] for v in runs]))


if __name__ == "__main__":
    main()
