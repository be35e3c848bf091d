"""Cases of benchmarks.foreign: what happens to a plant that its controller's model does not know, as scenario files."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import tomli_w

from benchmarks.foreign_plants.plant import ForeignPlant
from cosim.files import write_text

Changes = Mapping[str, Any]
"""Changes of the plant, by its variable, in the form of a scenario file."""
_LATE: Final = 3
"""Time constant of the actuators that lag, in macro steps."""
_COLOURED: Final = (3.0, 0.9)
"""Coloured noise: its standard deviation over the declared one, and its correlation from one sample to the next."""
_CHANGE, _GUST, _BEFORE, _AFTER = 0.4, 0.4, 0.25, 0.6
"""When things happen, as shares of the run: the change, the gust or the constant, and the two of `constant-change`."""
_GUST_STEPS: Final = 60
"""Length of a gust in macro steps."""
_STUCK_STEPS, _NO_RATE = 20, 1e-9
"""Number of macro steps in which actuators are stuck; a rate at which they hardly move."""
_SHARE: Final = 0.7
"""Share of the inputs that weak actuators give."""
_RATES: Final = 4.0
"""Ratio of a limit of the actuators' rates that shows where parameters change to one that shows before."""
_WINDOW: Final = 20
"""Largest number of samples that a candidate is judged by."""
_POINTS, _ORDER = 9, 3
"""Points and order of the filter of Savitzky and Golay that makes derivatives of states."""
OBJECTIVES: Final = ("derivatives", "filtered", "roll-outs")
"""What candidates are compared with: measured derivatives, derivatives filtered from noisy states, or noisy states."""


@dataclass(frozen=True)
class Case:
    """What happens to a plant."""

    meaning: str
    changes: Callable[[ForeignPlant, int], Changes]
    """Changes of the plant, by plant and seed."""
    noise_ratio: float = 1.0
    """Noise over the declared one."""
    has_change: bool = False
    """True where the parameters change: a controller that is told them has the least error."""
    fault: Mapping[str, Any] | None = None
    """Fault of the sensor of the first derivative, from some time on; a `size` is in standard deviations."""
    loop: str = ""
    """Case in which a loop that is not re-tuned does the same, by whatever seed: the samples alone differ."""


def _nothing(plant: ForeignPlant, seed: int) -> Changes:
    return {}


def _changed(plant: ForeignPlant, when: float = _CHANGE) -> Changes:
    t = when * plant.n_steps * plant.step
    return {p.name: [[0.0, p.start], [t, p.changed]] for p in plant.parameters}


def _gust(plant: ForeignPlant, seed: int) -> Changes:
    start, length = round(_GUST * plant.n_steps) * plant.step, _GUST_STEPS * plant.step
    half_sine = f"{plant.gust * plant.unit_load()}*sin(pi*(t - {start})/{length})"
    return {"d": [[0.0, 0.0], [start, half_sine], [start + length, 0.0]]}


def _constant(plant: ForeignPlant, when: float = _GUST) -> Changes:
    return {"d": [[0.0, 0.0], [when * plant.n_steps * plant.step, plant.constant * plant.unit_load()]]}


def _sine(plant: ForeignPlant, seed: int) -> Changes:
    period = 15 * _WINDOW * plant.step
    return {"d": f"{0.7 * plant.constant * plant.unit_load()}*sin(2*pi*t/{period})"}


def _drift(plant: ForeignPlant, seed: int) -> Changes:
    first = plant.parameters[0]
    return {first.name: f"{first.start}*(1 + 0.3*t/{plant.n_steps * plant.step})"}


def _friction(variable: str) -> Callable[[ForeignPlant, int], Changes]:
    def changes(plant: ForeignPlant, seed: int) -> Changes:
        size = plant.friction * plant.unit_load()
        return {variable: size / plant.pace if variable == "b" else size}

    return changes


def _coloured(plant: ForeignPlant, seed: int) -> Changes:
    """Return errors of the measured derivatives; of measured states, `_sampled` has them."""
    ratio, correlation = _COLOURED
    rng = np.random.default_rng([seed, 17])
    found: dict[str, Any] = {}
    for name, sigma in plant.noise.items():
        errors = ratio * sigma * rng.standard_normal(plant.n_steps + 1)
        for k in range(1, len(errors)):
            errors[k] = correlation * errors[k - 1] + np.sqrt(1.0 - correlation**2) * errors[k]
        found[f"e_{name}"] = [[k * plant.step, float(e)] for k, e in enumerate(errors)]
    return found


def _faults(plant: ForeignPlant, fault: Mapping[str, Any] | None, objective: str) -> list[dict[str, Any]]:
    """Return the faults of a scenario file: of the first derivative's sensor, or of its state's."""
    if fault is None:
        return []
    name, sigma = next(iter(_noises(plant, objective).items()))
    size = {"size": fault["size"] * sigma} if "size" in fault else {}
    begun = {"sensor": _sensor(name, objective), "start": round(_CHANGE * plant.n_steps) * plant.step}
    return [{**fault, **size, **begun}]


def _noises(plant: ForeignPlant, objective: str) -> dict[str, float]:
    """Return the declared standard deviation of each noisy sensor, by its state; a state's is that of one step."""
    scale = 1.0 if objective == "derivatives" else plant.step
    return {name: scale * sigma for name, sigma in plant.noise.items()}


def _sensor(name: str, objective: str) -> str:
    return f"plant.der({name})" if objective == "derivatives" else f"plant.{name}"


def _sampled(plant: ForeignPlant, case: str, objective: str) -> dict[str, Any]:
    """Return the table `sampling`; the states without a sampled derivative are measured exactly."""
    noises = {_sensor(name, objective): {"noise": sigma} for name, sigma in _noises(plant, objective).items()}
    faults = _faults(plant, CASES[case].fault, objective)
    found: dict[str, Any] = {"noise_ratio": CASES[case].noise_ratio}
    if objective == "derivatives":
        return found | {"faults": faults, "derivatives": noises}
    if case.startswith("coloured"):
        ratio, correlation = _COLOURED
        faults += [
            {"kind": "noise", "sensor": sensor, "size": ratio * of["noise"], "correlation": correlation}
            for sensor, of in noises.items()
        ]
    if objective == "roll-outs":
        return found | {"faults": faults, "outputs": noises}
    filtered = {f"plant.der({name})": {"of": f"plant.{name}"} for name in plant.noise}
    kind = {"kind": "savitzky-golay", "points": _POINTS, "order": _ORDER}
    return found | {"faults": faults, "derivatives": filtered, "filter": kind, "states": noises}


def _stuck(plant: ForeignPlant, seed: int) -> Changes:
    start, length = round(_GUST * plant.n_steps) * plant.step, _STUCK_STEPS * plant.step
    return {"rate_u": [[0.0, 0.0], [start, _NO_RATE], [start + length, 0.0]]}


def _weak(plant: ForeignPlant, seed: int) -> Changes:
    return {"share_u": [[0.0, 1.0], [_CHANGE * plant.n_steps * plant.step, _SHARE]]}


def _lag(plant: ForeignPlant) -> Changes:
    return {"tau_u": _LATE * plant.step}


CASES: Final[Mapping[str, Case]] = {
    "none": Case("nothing at all", _nothing),
    "change": Case("the parameters jump", lambda p, _: _changed(p), has_change=True),
    "gust": Case("a disturbance for a short time, half a sine, and nothing else", _gust),
    "constant": Case("a constant disturbance from some time on, and nothing else", lambda p, _: _constant(p)),
    "constant-change": Case(
        "a constant disturbance, and later the parameters jump",
        lambda p, _: {**_constant(p, _BEFORE), **_changed(p, _AFTER)},
        has_change=True,
    ),
    "viscous": Case("viscous friction that the model lacks", _friction("b")),
    "dry": Case("dry friction that the model lacks", _friction("F_c")),
    "lag": Case("actuators with a lag of three macro steps", lambda p, _: _lag(p)),
    "lag-change": Case("the same, and the parameters jump", lambda p, _: {**_lag(p), **_changed(p)}, has_change=True),
    "lag-begins": Case(
        "the same lag begins as the parameters jump",
        lambda p, _: {"tau_u": [[0.0, 0.0], [_CHANGE * p.n_steps * p.step, _LATE * p.step]], **_changed(p)},
        has_change=True,
    ),
    "rate": Case("actuators with a limited rate", lambda p, _: {"rate_u": p.rate}),
    "rate-change": Case(
        "actuators with a limited rate that shows as the parameters jump",
        lambda p, _: {"rate_u": _RATES * p.rate, **_changed(p)},
        has_change=True,
    ),
    "limited": Case("the first actuator gives no more than a limit", lambda p, _: {"limit_u": p.limit}),
    "limited-change": Case(
        "the same, and the parameters jump", lambda p, _: {"limit_u": p.limit, **_changed(p)}, has_change=True
    ),
    "weak": Case("actuators that give 70 %, from some time on", _weak),
    "stuck": Case("actuators that are stuck for a short time", _stuck),
    "noise10": Case("noise ten times that declared", _nothing, 10.0, loop="none"),
    "noise10-change": Case(
        "the same, and the parameters jump", lambda p, _: _changed(p), 10.0, has_change=True, loop="change"
    ),
    "coloured": Case("coloured noise of three times the declared size is added", _coloured, loop="none"),
    "coloured-change": Case(
        "the same, and the parameters jump",
        lambda p, seed: {**_coloured(p, seed), **_changed(p)},
        has_change=True,
        loop="change",
    ),
    "bias": Case(
        "a derivative is sampled with a bias of ten standard deviations, from some time on",
        _nothing,
        fault={"kind": "bias", "size": 10.0},
        loop="none",
    ),
    "sign": Case(
        "a derivative is sampled with the wrong sign, from some time on", _nothing, fault={"kind": "sign"}, loop="none"
    ),
    "sine": Case("a slow sinusoidal disturbance", _sine),
    "drift": Case("the first parameter grows by 30 % over the run", _drift, has_change=True),
}


def tables(plant: ForeignPlant, case: str, seed: int, objective: str = OBJECTIVES[0]) -> dict[str, Any]:
    """Return the tables of the scenario file, with the FMUs and the reference in its folder."""
    errors = [f"e_{name}" for name in plant.noise]
    changes = dict.fromkeys(("d", *errors), 0.0) | dict(CASES[case].changes(plant, seed))
    if objective != "derivatives":
        changes |= dict.fromkeys(errors, 0.0)
    fed = {s.name: f"plant.{s.name}" for s in plant.states}
    fed |= {s.name: f"reference.{s.name}" for s in plant.references}
    return {
        "scenario": {
            "name": f"{plant.name}-{case}",
            "description": f"{plant.title}: {CASES[case].meaning}",
            "stop_time": plant.n_steps * plant.step,
            "macro_step": plant.step,
            "isolation": "none",
            "checkpoint": 0,
        },
        "components": {
            "plant": {"fmu": plant_fmu(plant), "start": {"max_step": min(plant.step, 1.0)}},
            "controller": {"fmu": controller_fmu(plant)},
            "reference": {"table": f"{plant.name}.csv"},
        },
        "connections": {
            **{f"controller.{name}": source for name, source in fed.items()},
            **{f"plant.{s.name}": f"controller.{s.name}" for s in plant.controls},
        },
        "changes": {f"plant.{name}": change for name, change in changes.items()},
        "tracking": {f"plant.{name}": f"reference.{ref}" for name, ref in plant.tracked.items()},
        "sampling": _sampled(plant, case, objective),
        "estimation": {
            **_compared(plant, objective),
            "trigger": {"kind": "innovation", "false_alarm": 1e-6},
            "budget": 30,
            "evaluations_per_step": 2,
            "window": _WINDOW,
            "parameters": [
                {
                    "name": p.name,
                    "lower": p.bounds[0],
                    "upper": p.bounds[1],
                    "unit": p.unit,
                    "scale": "log",
                    "writes": f"controller.{p.name}",
                }
                for p in plant.parameters
            ],
        },
        "limits": {"divergence": plant.divergence},
        "record": {"csv": 0.0},
    }


def _compared(plant: ForeignPlant, objective: str) -> dict[str, Any]:
    if objective == "roll-outs":
        return {"objective": "rollout", "rollout": {"jobs": 1}}
    return {"model": f"benchmarks.foreign_plants.{plant.name}:derivative"}


def write_scenario(plant: ForeignPlant, case: str, seed: int, objective: str, folder: Path) -> Path:
    """Write the scenario file of a case into the folder, and return it: one for all seeds, but for coloured noise."""
    suffix = f"-{seed}" if case.startswith("coloured") else ""
    path = folder / f"{plant.name}-{case}{suffix}.toml"
    write_text(path, tomli_w.dumps(tables(plant, case, seed, objective)))
    return path


def write_reference(plant: ForeignPlant, folder: Path) -> None:
    """Write the table of the reference, a row for each communication point, into the folder."""
    heads = [f"{s.name} [{s.unit}]" if s.unit else s.name for s in plant.references]
    times = (k * plant.step for k in range(plant.n_steps + 1))
    rows = (",".join(map(repr, (t, *map(float, plant.reference(t))))) for t in times)
    write_text(folder / f"{plant.name}.csv", "\n".join([",".join(["time [s]", *heads]), *rows]) + "\n")


def plant_fmu(plant: ForeignPlant) -> str:
    """Return the file name of the plant's FMU."""
    return f"{plant.name.capitalize()}.fmu"


def controller_fmu(plant: ForeignPlant) -> str:
    """Return the file name of the controller's FMU."""
    return f"{plant.name.capitalize()}Controller.fmu"
