"""From a scenario to an estimator FMU: `estimator_slave` with the scenario's settings, and all that it imports."""

import ast
import re
from collections import Counter
from collections.abc import Collection, Mapping
from contextlib import ExitStack
from dataclasses import asdict
from modulefinder import ModuleFinder
from pathlib import Path
from pprint import pformat
from typing import Any

import numpy as np

import estimator
import fmu_models
from estimator import Sample, Vector
from fmu_models import documentation
from fmu_models.build import assemble, sources
from fmu_models.kernel.description import base_unit

from ..errors import ScenarioError
from ..fmi.archive import FmuFile
from ..fmi.component import read_component
from ..objectives.choice import chosen
from ..retuning.assembly import make_supervisor, try_model
from ..retuning.estimators import find_method
from ..scenarios.scenario import Scenario
from ..scenarios.schema.estimation import Innovation, Tracking
from ..system.fmu_cache import fmu_paths
from ..system.parameters import check_parameters, start_value
from ..system.plant import Plant, plant_of
from ..system.wiring import wire
from .slave import variable_table
from .theory import ICON, THEORY

_SHIPPED = (
    "estimator_fmu/__init__.py",
    "estimator_fmu/loop.py",
    "estimator_fmu/slave.py",
)
"""The modules of cosim that an estimator FMU imports: they need no more than `estimator` does."""
_INIT = b'"""What an estimator FMU has of cosim."""\n'
_OURS = ("cosim", "estimator", "fmu_models")


def build_estimator(scenario: Scenario, out_dir: Path, method: str = "target") -> Path:
    """Build the scenario's estimator as an FMU into `out_dir`; returns its path, QuadrotorEstimator.fmu of `quadrotor`.

    The same scenario and sources give the same bytes.
    Raises ScenarioError, ModelDescriptionError or WiringError for what `run` refuses, and for what cannot be shipped.
    """
    settings = estimator_settings(scenario, method)
    words = re.split(r"[-_]", scenario.scenario.name)
    name = "".join(word[:1].upper() + word[1:] for word in words) + "Estimator"
    if not name.isidentifier():
        raise ScenarioError(f"scenario.name '{scenario.scenario.name}' must begin with a letter to name an FMU.")
    repeated = [n for n, count in Counter(v.name for v in variable_table(settings)).items() if count > 1]
    if repeated:
        raise ScenarioError(f"{name}.fmu would have two variables '{repeated[0]}': rename one in the plant.")
    script = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower() + "_fmu"
    own = Path(__file__).parents[1]
    files = {
        "cosim/__init__.py": _INIT,
        **{f"cosim/{module}": (own / module).read_bytes() for module in _SHIPPED},
        **sources(Path(estimator.__path__[0])),
        **sources(Path(fmu_models.__path__[0])),
        **_user_sources(settings, scenario.folder),
    }
    tops = sorted({path.partition("/")[0].removesuffix(".py") for path in files})
    files["requirements.txt"] = "".join(f"{package}\n" for package in settings["requires"]).encode()
    files[f"{script}.py"] = _entry(name, scenario, settings | {"ships": tops}).encode()
    try:
        summary = f"Estimator of the scenario {scenario.scenario.name}: {method}"
        page = documentation.Page(name, summary, THEORY, variable_table(settings), ICON.read_bytes())
        return assemble(name, script, files, documentation.files(page, 2, ("pythonfmu",)), out_dir)
    except RuntimeError as e:  # the FMU is instantiated for its description
        raise ScenarioError(f"{e}.") from e


def estimator_settings(scenario: Scenario, method: str = "target") -> dict[str, Any]:
    """What the estimator FMU knows of the scenario, as JSON values. Raises what `build_estimator` does."""
    if ":" in method or method in ("none", "true"):
        raise ScenarioError(f"'{method}' cannot be built into an FMU; the estimators of the package can.")
    if scenario.sampling.filter is not None:
        raise ScenarioError("sampling.filter cannot be built into an FMU: its estimator takes measured derivatives.")
    how = find_method(method, scenario)
    if chosen(scenario).kind != "derivative":
        raise ScenarioError("estimation.objective: an estimator FMU takes derivatives; it cannot hold other FMUs.")
    fmus = {name: FmuFile(name, read_component(path).description) for name, path in fmu_paths(scenario).items()}
    plant = plant_of(scenario, fmus[scenario.plant])
    check_parameters(scenario, fmus)
    wire(scenario, fmus)
    theta = np.array([start_value(scenario, fmus, p.writes) for p in scenario.estimation.parameters])
    _try(scenario, method, plant, fmus, theta)
    loop, linear = scenario.estimation.loop(method), scenario.estimation.linear
    variables = _Variables(scenario, fmus, plant)
    trigger = loop.trigger
    return {
        "experiment": [scenario.scenario.start_time, scenario.scenario.stop_time, scenario.scenario.macro_step],
        "model": scenario.estimation.model,
        "linear": [linear.rows, linear.coefficients] if linear and how.needs_linear_form else None,
        "method": method,
        "settings": asdict(scenario.estimation.settings(method)),
        "requires": ["numpy", "scipy", "GPy", *([how.needs_package] if how.needs_package else [])],
        "parameters": [
            {
                "name": p.name, "lower": p.lower, "upper": p.upper, "unit": p.unit, "fmi_unit": _fmi_unit(p.unit),
                "scale": p.scale, "start": min(max(start, p.lower), p.upper),
            }
            for p, start in zip(scenario.estimation.parameters, theta.tolist(), strict=True)
        ],
        "states": [variables.of(f"{plant.name}.{name}") for name in plant.states],
        "inputs": [variables.of(f"{plant.name}.{name}") for name in plant.inputs],
        "held": [_suffixed(name, "_held") for name in plant.inputs],
        "derivatives": [
            variables.of(reference)
            | {"noise": noise.noise, "channel": channel, "noise_name": "noise_" + _word(reference.partition(".")[2])}
            for (reference, noise), channel in zip(scenario.sampling.derivatives.items(), plant.channels, strict=True)
        ],
        "watched": variables.watched,
        "tracking": [[variables.name_of(a), variables.name_of(b)] for a, b in scenario.tracking.items()],
        "tracking_unit": variables.of(next(iter(scenario.tracking)))["unit"],
        "trigger": trigger.kind,
        "commit": loop.commit,
        "loop": {
            "budget": loop.budget, "evaluations_per_step": loop.evaluations_per_step, "window": loop.window, "seed": 0,
            "threshold": trigger.threshold if isinstance(trigger, Tracking) else None,
            "false_alarm": trigger.false_alarm if isinstance(trigger, Innovation) else None,
        },
    }  # fmt: skip


class _Variables:
    """The estimator's inputs: those of the plant have its names, others theirs, with the component's where need be."""

    def __init__(self, scenario: Scenario, fmus: Mapping[str, FmuFile], plant: Plant) -> None:
        self._scenario, self._fmus = scenario, fmus
        own = {f"{plant.name}.{name}" for name in plant.states} | set(scenario.sampling.derivatives)
        taken = {reference.partition(".")[2] for reference in own}
        self._names: dict[str, str] = {}
        self.watched: list[dict[str, Any]] = []
        """What is tracked, and what it should be, as far as they are no states."""
        for reference in (r for pair in scenario.tracking.items() for r in pair if r not in own):
            if reference not in self._names:
                name = reference.partition(".")[2]
                self._names[reference] = reference if name in taken else name
                taken.add(self._names[reference])
                text = f"{reference.partition('.')[0]}: {self._declared(reference).description or name}"
                self.watched.append(self.of(reference) | {"text": text})

    def name_of(self, reference: str) -> str:
        return self._names.get(reference) or reference.partition(".")[2]

    def of(self, reference: str) -> dict[str, Any]:
        declared = self._declared(reference)
        has_start = declared.start is not None
        start = start_value(self._scenario, self._fmus, reference) if has_start else 0.0
        return {"name": self.name_of(reference), "unit": _fmi_unit(declared.unit or "1"), "start": start}

    def _declared(self, reference: str) -> Any:
        component, _, name = reference.partition(".")
        return next(v for v in self._fmus[component].description.modelVariables if v.name == name)


def _try(scenario: Scenario, method: str, plant: Plant, fmus: Mapping[str, FmuFile], theta: Vector) -> None:
    """Make what the FMU will make, and call the model once. Raises ScenarioError."""
    with ExitStack() as stack:
        make_supervisor(scenario, method, plant, theta, np.random.default_rng(0), stack)
    x = tuple(start_value(scenario, fmus, f"{plant.name}.{name}") for name in plant.states)
    first = Sample(0.0, x, tuple(plant.inputs.values()), (0.0,) * len(plant.channels))
    try_model(scenario, method, plant, theta, first)


def _user_sources(settings: Mapping[str, Any], folder: Path) -> dict[str, bytes]:
    """The user's modules that the model is in and imports, from where `run` looks for them. Raises ScenarioError."""
    places = [folder.resolve(), Path.cwd()]
    files: dict[str, bytes] = {}
    for reference in (settings["model"], *(settings["linear"] or ())):
        module = reference.partition(":")[0]
        if module.partition(".")[0] in _OURS:
            continue
        finder = ModuleFinder(path=[str(place) for place in places], excludes=list(_OURS))
        try:
            finder.import_hook(module)
        except ImportError as e:
            raise ScenarioError(
                f"estimation.model: '{module}' must be a Python file beside the scenario to be shipped in an FMU: {e}."
            ) from e
        modules: dict[str, Any] = dict(finder.modules)
        for name, found in sorted(modules.items()):
            path = Path(found.__file__ or "")
            if path.suffix != ".py":
                raise ScenarioError(f"estimation.model: {path or name} is no Python source and cannot be shipped.")
            target = name.replace(".", "/")
            files[f"{target}/__init__.py" if found.__path__ else f"{target}.py"] = path.read_bytes()
    for path, text in files.items():
        _check_imports(path, text, {name.partition("/")[0].removesuffix(".py") for name in files} | set(_OURS))
    return files


def _check_imports(path: str, source: bytes, shipped: Collection[str]) -> None:
    """Raises ScenarioError for a way to import modules that get other names in the FMU which `build` does not know."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import) and any(alias.name.partition(".")[0] in shipped for alias in node.names):
            (first, *others) = node.names
            if others or ("." in first.name and not first.asname):
                text = ast.unparse(node)
                raise ScenarioError(f"{path}: '{text}' cannot be shipped in an FMU; write 'from ... import ...'.")


def _entry(name: str, scenario: Scenario, settings: Mapping[str, Any]) -> str:
    names = ", ".join(p["name"] for p in settings["parameters"])
    literal = pformat(settings, width=110, sort_dicts=False).replace("\n", "\n    ")
    return f'''"""Entry script of {name}.fmu."""

from cosim.estimator_fmu.slave import EstimatorSlave


class {name}(EstimatorSlave):
    """Estimates {names} of the plant of scenario {scenario.scenario.name} by the method {settings["method"]}."""

    settings = {literal}
'''


def _fmi_unit(unit: str) -> str | None:
    """The unit, where its dimension is known; a wrong one would be worse than none."""
    try:
        base_unit(unit)
    except ValueError:
        return None
    return unit


def _suffixed(name: str, suffix: str) -> str:
    """`u_held`, and for an element of an array `u_held[1]`."""
    stem, bracket, index = name.partition("[")
    return stem + suffix + bracket + index


def _word(name: str) -> str:
    """`der(v_x)` as a part of a name: `der_v_x`."""
    return re.sub(r"\W+", "_", name).strip("_")
