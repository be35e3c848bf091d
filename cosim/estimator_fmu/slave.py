"""The estimator as an FMU: the loop of `loop.py` behind the FMI calls of `fmu_models.kernel.slave`.

It is shipped inside the FMU, and imports only the standard library and pythonfmu until it has checked that the other
packages are there. One communication point is one sample: inputs are the plant's outputs at that time.
"""

import importlib
import pickle
import platform
import sys
from collections.abc import Mapping
from math import hypot, nextafter
from typing import Any, ClassVar
from xml.etree.ElementTree import Element

from pythonfmu import DefaultExperiment

from fmu_models.kernel.description import VariableRow, input_variable, output, parameter
from fmu_models.kernel.slave import Slave

_LARGEST_INTEGER = 2**31 - 1


def variable_table(settings: Mapping[str, Any]) -> tuple[VariableRow, ...]:
    """Return the variables of an estimator FMU; settings: see `estimator_fmu`."""
    return (*_parameters(settings), *_inputs(settings), *_outputs(settings)) if settings else ()


def references(settings: Mapping[str, Any]) -> list[str]:
    """Return the Python functions `module:name` that an estimator FMU calls."""
    functions = dict.fromkeys(r["formula"] for r in settings["rule"] if ":" in r["formula"])
    return [settings["model"], *(settings["linear"] or ()), *functions]


class EstimatorSlave(Slave):
    """Estimates a plant's parameters from its sampled states, held inputs and derivatives."""

    has_feedthrough = False
    settings: ClassVar[Mapping[str, Any]] = {}
    """Settings of the estimation, made by `estimator_fmu`."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        cls.table = variable_table(cls.settings)
        cls.default_experiment = DefaultExperiment(*cls.settings["experiment"])
        super().__init_subclass__(**kwargs)
        cls._place = {v.name: i for i, v in enumerate(cls.variables)}
        derivatives = [d["name"] for d in cls.settings["derivatives"]]
        cls._x, cls._u, cls._xdot = (
            [cls._place[name] for name in names]
            for names in ([s["name"] for s in cls.settings["states"]], cls.settings["held"], derivatives)
        )
        cls._tracked = [(cls._place[a], cls._place[b]) for a, b in cls.settings["tracking"]]

    def _prepare(self) -> None:
        """Import what is needed. Raises RuntimeError, seen by a host as a failed instantiation and a log message."""
        for package in self.settings["requires"]:
            self._require(package)
        loop = importlib.import_module(".loop", __package__)
        for reference in references(self.settings):
            self._require(loop.module_of(reference, self.settings["ships"]))
        self._loop_type, self._gains = loop.EstimatorLoop, loop.gains

    def _enter(self, is_initialized: bool) -> None:
        super()._enter(is_initialized)
        if is_initialized:
            self._loop = self._loop_type(self.settings, lambda name: self._values[self._place[name]])

    def _refresh(self) -> None:
        if not self._is_initialized:
            start = [self._values[self._place[f"{p['name']}_start"]] for p in self.settings["parameters"]]
            widths = [
                self._values[self._place[f"{p['name']}_upper"]] - self._values[self._place[f"{p['name']}_lower"]]
                for p in self.settings["parameters"]
            ]
            self._values[self._outputs] = [
                *start, *widths, *(False for _ in start), 0, 0, False, *self._gains(self.settings, start),
            ]  # fmt: skip

    def _advance(self, step_size: float) -> None:
        values = self._values
        x, u, xdot = ([values[i] for i in places] for places in (self._x, self._u, self._xdot))
        if values[self._place["tracking_error_is_input"]]:
            error = abs(values[self._place["tracking_error"]])
        else:
            error = hypot(*(values[a] - values[b] for a, b in self._tracked))
        self._loop.step(self._time - step_size, x, u, xdot, error)
        values[self._outputs] = self._loop.outputs

    def _get_fmu_state(self) -> Any:
        """Return variables and search, for this process only: restoring a search from bytes would be running them."""
        loop = pickle.dumps(self._loop) if self._is_initialized else None
        return super()._get_fmu_state(), loop

    def _set_fmu_state(self, state: Any) -> None:
        variables, loop = state
        super()._set_fmu_state(variables)
        if loop is not None:
            self._loop = pickle.loads(loop)

    def to_xml(self, model_options: dict[str, str] | None = None) -> Element:
        """Return the model description."""
        return super().to_xml({"canSerializeFMUstate": "false"})

    def _require(self, module: str) -> None:
        try:
            importlib.import_module(module)
        except Exception as e:  # a broken installation raises anything
            packages = self.settings["requires"]
            where = f"Python {platform.python_version()} in {sys.prefix}"
            raise RuntimeError(
                f"{self.modelName} needs {', '.join(packages)} in the Python that loads it, {where}: "
                f"{module} cannot be imported, {type(e).__name__}: {e}. "
                f"Install them there: python -m pip install {' '.join(packages)}"
            ) from e


def _parameters(settings: Mapping[str, Any]) -> list[VariableRow]:
    loop = settings["loop"]
    table: list[VariableRow] = []
    for p in settings["parameters"]:
        name, unit = p["name"], p["fmi_unit"]
        table += [
            _fixed(f"{name}_lower", unit, p["lower"], f"Lower bound of {name}"),
            _fixed(f"{name}_upper", unit, p["upper"], f"Upper bound of {name}"),
            _fixed(f"{name}_start", unit, p["start"], f"Estimate of {name} before the first update"),
        ]
    for d in settings["derivatives"]:
        text = f"Standard deviation of the noise on {d['name']}, by which its residual is weighed"
        table.append(_fixed(d["noise_name"], d["unit"], d["noise"], text, min=sys.float_info.min))
    for p in settings["trigger_parameters"]:
        table.append(_fixed(p["name"], p["unit"], p["start"], p["text"], min=p["min"], max=p["max"]))
    known = settings["diagnosis"]
    text = "Give only estimates that explain the samples where nothing else does"
    table.append(_fixed("diagnosis_enabled", None, known["enabled"], text))
    text = "Probability that a sample seems to contradict the estimates although nothing has changed"
    table.append(_fixed(
        "diagnosis_false_alarm", "1", known["false_alarm"], text, min=sys.float_info.min, max=nextafter(1.0, 0.0)
    ))  # fmt: skip
    counts = (
        ("budget", "Evaluations an episode", 1),
        ("evaluations_per_step", "Evaluations a step", 1),
        ("window", "Most samples that a residual is taken over", 1),
        ("seed", "Seed of the search: the same inputs and seed give the same estimates", 0),
    )
    for name, text, least in counts:
        table.append(_fixed(name, None, loop[name], text, type="Integer", min=least, max=_LARGEST_INTEGER))
    for name, text in (("rest", "First rest after three failed searches"), ("longest_rest", "Longest rest")):
        options = {"type": "Integer", "min": 1, "max": _LARGEST_INTEGER}
        table.append(_fixed(f"diagnosis_{name}", None, known[name], f"{text}, in samples", **options))
    text = "Take the input tracking_error instead of the difference of tracked outputs and references"
    return [*table, _fixed("tracking_error_is_input", None, False, text)]


def _inputs(settings: Mapping[str, Any]) -> list[VariableRow]:
    return [
        *(input_variable(s["name"], s["unit"], s["start"], f"Sampled state {s['name']}") for s in settings["states"]),
        *(
            input_variable(held, i["unit"], i["start"], f"{i['name']} as held over the last step")
            for held, i in zip(settings["held"], settings["inputs"], strict=True)
        ),
        *(input_variable(d["name"], d["unit"], 0.0, "Sampled derivative") for d in settings["derivatives"]),
        *(input_variable(v["name"], v["unit"], v["start"], v["text"]) for v in settings["watched"]),
        input_variable(
            "tracking_error", settings["tracking_unit"], 0.0,
            "Norm of the tracking error, where tracking_error_is_input",
        ),
    ]  # fmt: skip


def _outputs(settings: Mapping[str, Any]) -> list[VariableRow]:
    parameters = [(p["name"], p["fmi_unit"]) for p in settings["parameters"]]
    starts = [f"{name}_start" for name, _ in parameters]

    def real(name: str, unit: str, text: str, *depends: str) -> VariableRow:
        return output(name, unit, text, depends=depends, variability="discrete")

    def counted(name: str, text: str) -> VariableRow:
        return output(name, None, f"{text} so far", depends=(), type="Integer")

    def flag(name: str, text: str) -> VariableRow:
        return output(name, None, text, depends=(), type="Boolean")

    return [
        *(real(name, unit, f"Estimate of {name}, the latest update", f"{name}_start") for name, unit in parameters),
        *(
            real(f"{name}_std", unit, f"Standard deviation of {name}", f"{name}_lower", f"{name}_upper")
            for name, unit in parameters
        ),
        *(flag(f"{name}_identifiable", f"Whether the data fix {name}") for name, _ in parameters),
        counted("n_evaluations", "Evaluations"),
        counted("n_episodes", "Episodes of estimation"),
        flag("update_ready", "Whether the estimates have been updated since the start"),
        *(real(r["name"], r["unit"], f"{r['of']}: {r['formula']}", *starts) for r in settings["rule"]),
    ]


def _fixed(name: str, unit: str | None, start: float | bool, text: str, **options: Any) -> VariableRow:
    return parameter(name, unit, start, text, variability="fixed", **options)
