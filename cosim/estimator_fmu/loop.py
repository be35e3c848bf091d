"""The re-tuning loop of an estimator FMU, made from its settings and parameters. Needs NumPy, SciPy and GPy."""

import importlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from math import nan
from typing import Any

import numpy as np

from estimator import DerivativeResidual, LinearForm, Parameter, ParameterSpace, Sample
from estimator.diagnosis.sample_diagnosis import Diagnosis
from estimator.diagnosis.settings import DiagnosisSettings
from estimator.methods import method_named
from estimator.retuning.factory import make_retuner
from estimator.retuning.search import Budget
from estimator.triggers import TRIGGERS

from ..scenarios.tuning_rule import TuningRule

try:
    from threadpoolctl import ThreadpoolController
except ImportError:
    _threads = None
else:
    _threads = ThreadpoolController()


class EstimatorLoop:
    """Re-tuning loop: takes a sample at each communication point, holds the estimate in force, its std and counts."""

    def __init__(self, settings: Mapping[str, Any], value: Callable[[str], float]) -> None:
        """settings: see `estimator_fmu`; value: the FMU's parameters by name. Raises ValueError for invalid ones."""
        names = [p["name"] for p in settings["parameters"]]
        space = ParameterSpace(
            tuple(
                Parameter(p["name"], value(f"{p['name']}_lower"), value(f"{p['name']}_upper"), p["unit"], p["scale"])
                for p in settings["parameters"]
            )
        )
        start = np.array([value(f"{name}_start") for name in names])
        for p, theta in zip(space, start.tolist(), strict=True):
            if not p.contains(theta):
                raise ValueError(f"{p.name}_start must be in [{p.lower:g}, {p.upper:g}] {p.unit}, got {theta:g}.")
        derivatives = settings["derivatives"]
        whitened = DerivativeResidual(
            _load(settings["model"], settings["ships"]),
            space,
            tuple(d["channel"] for d in derivatives),
            tuple(value(d["noise_name"]) for d in derivatives),
        )
        trigger = TRIGGERS[settings["trigger"]](**{p["name"]: value(p["name"]) for p in settings["trigger_parameters"]})
        method = method_named(settings["method"])
        # As `run` spawns them: the noise's stream, which is the sampling's here, and the search's.
        rng = np.random.default_rng(np.random.SeedSequence(int(value("seed"))).spawn(2)[1])
        rules = DiagnosisSettings(
            enabled=bool(value("diagnosis_enabled")), false_alarm=value("diagnosis_false_alarm"),
            rest=int(value("diagnosis_rest")), longest_rest=int(value("diagnosis_longest_rest")),
        )  # fmt: skip
        channels = [d["name"] for d in derivatives]
        diagnosis = Diagnosis(whitened, channels, rules, settings["may_lag"]) if rules.enabled else None
        self._retuner = make_retuner(
            method.estimator(space, start, rng, method.settings(**settings["settings"])),
            whitened,
            trigger,
            Budget(value("budget"), int(value("evaluations_per_step")), settings["commit"]),
            int(value("window")),
            LinearForm(space, *(_load(r, settings["ships"]) for r in settings["linear"]))
            if settings["linear"]
            else None,
            diagnosis=diagnosis,
        )
        self._settings, self._rule = settings, _rule(settings)
        self._values = self._rule(start)
        self._theta = start
        self._unknown = np.array([p.upper - p.lower for p in space]), (False,) * len(space)
        self._std, self._is_identifiable = self._unknown
        self._is_updated = False
        self._is_first = True

    def step(
        self, t: float, x: Sequence[float], u: Sequence[float], xdot: Sequence[float], tracking_error: float
    ) -> None:
        """Take the sample at t [s]; the first one is skipped as in `run`. tracking_error: its norm."""
        sample = Sample(t, tuple(x), tuple(u), tuple(xdot))
        with _one_thread():
            proposal = self._retuner.step(t, None if self._is_first else sample, tracking_error, self._theta)
        self._is_first = False
        theta, estimate = proposal.undo if proposal.theta is None else proposal.theta, proposal.estimate
        is_known = estimate is not None and np.allclose(estimate.theta, self._theta, rtol=1e-9, atol=0.0)
        if theta is not None and proposal.is_warranted:  # else it waits: it cannot predict
            with suppress(ValueError):  # the gains have no value there
                self._values = self._rule(theta)
                self._theta, self._is_updated = theta, True
                self._std, self._is_identifiable = self._unknown
                is_known = estimate is not None and proposal.theta is not None
        if is_known and estimate is not None:
            self._std, self._is_identifiable = estimate.std, estimate.is_identifiable

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the rule, whose formulas are functions."""
        return {name: value for name, value in self.__dict__.items() if name != "_rule"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._rule = _rule(self._settings)

    @property
    def outputs(self) -> list[float]:
        """Estimate in force, its standard deviations and flags, counts, update flag, and what the formulas give."""
        counts = (self._retuner.n_evaluations, self._retuner.n_episodes, self._is_updated)
        return [*self._theta.tolist(), *self._std.tolist(), *self._is_identifiable, *counts, *self._values]


def gains(settings: Mapping[str, Any], theta: Sequence[float]) -> list[float]:
    """Return what the formulas give for parameters (d,); NaN where they have no values."""
    try:
        return _rule(settings)(theta)
    except ValueError:
        return [nan] * len(settings["rule"])


def _rule(settings: Mapping[str, Any]) -> TuningRule:
    formulas = {r["name"]: r["formula"] for r in settings["rule"]}
    names = [p["name"] for p in settings["parameters"]]
    return TuningRule(names, formulas, lambda reference: _load(reference, settings["ships"]))


def _one_thread() -> AbstractContextManager[Any]:
    """Limit BLAS to one thread: their number changes the last bits of results, and a second one is slower."""
    return nullcontext() if _threads is None else _threads.limit(limits=1)


def module_of(reference: str, shipped: Sequence[str]) -> str:
    """Return the module in `module:name`; a shipped one has the suffix that this package's name has in the FMU."""
    module = reference.partition(":")[0]
    top, dot, rest = module.partition(".")
    return (
        f"{top}{(__package__ or '').partition('.')[0].removeprefix('cosim')}{dot}{rest}" if top in shipped else module
    )


def _load(reference: str, shipped: Sequence[str]) -> Callable[..., Any]:
    return getattr(importlib.import_module(module_of(reference, shipped)), reference.partition(":")[2])
