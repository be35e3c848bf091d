"""The result of a run: its series, its figures and its folder."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FolderError, NotResumableError
from ..files import sha256, to_json, write_json, write_text
from ..scenarios.scenario import Scenario
from ..ssv.document import ParameterValue, to_ssv
from ..system.plant import Plant
from ..units import Unit
from .checkpoint import read_checkpoint
from .final_estimate import FinalEstimate, final_estimate_from_json
from .lock import is_locked
from .manifest import Status, check_file, modules, read_json, read_manifest, scenario_of, versions, write_manifest
from .run_files import (
    CHECKPOINT,
    CSV,
    ESTIMATES,
    LATENCIES,
    MADE_AT_END,
    MANIFEST,
    REQUIRED,
    RESULT,
    SEALED,
    SERIES,
)
from .series import read_series, write_csv
from .signature import is_signed

Series = NDArray[np.float64]


@dataclass(frozen=True)
class Run:
    """A finished run. `run["plant.phi"]` is that variable's series."""

    scenario: Scenario
    """Scenario of the run."""
    plant: Plant
    """The component whose derivatives were sampled."""
    estimator: str
    """Name of the estimator."""
    seed: int
    """Seed of noise and search."""
    series: Mapping[str, Series]
    """Every recorded variable (n,), one value per communication point."""
    status: Status
    """Status at the end."""
    error: str | None
    """Reason of a fault, in one line."""
    n_evaluations: int
    """Candidates evaluated."""
    n_episodes: int
    """Episodes begun."""
    latencies: tuple[tuple[float, ...], ...]
    """Wall time of each evaluation [s], and of each sample taken between searches, a tuple for each such macro step."""
    wall: float
    """Wall time of the simulation, from starting the FMUs to the last step [s]."""
    folder: Path | None
    """Run folder, where there is one."""
    n_model_calls: int = 0
    """Samples at which a candidate was scored."""
    objective: str = ""
    """Objective by which candidates were scored, and why it was chosen."""
    guard: Mapping[str, Any] | None = None
    """Counts of writes that the guard passed, changed, vetoed and reverted; None without a guard."""
    observations: Mapping[str, Any] | None = None
    """Counts of samples that were kept out, by fault; None without a screen."""
    diagnosis: Mapping[str, Any] | None = None
    """Findings of the diagnosis: what the model leaves unexplained by channel, disturbances, failed searches."""
    final_estimate: FinalEstimate | None = None
    """Final estimate; None where nothing was estimated."""
    latency_steps: tuple[tuple[int, int], ...] = ()
    """Macro steps of the latencies: first and last number of each stretch without a gap; empty where unknown."""

    def __repr__(self) -> str:
        """Return one line: the series would fill pages."""
        name, end = self.scenario.scenario.name, f" at {self.time[-1]:g} s" if len(self.time) else ""
        figures = ", ".join(f"{error:.4g}" for error in self.mse)
        return f"<Run {name}, {self.estimator}, seed {self.seed}: {self.status}{end}, mse [{figures}]>"

    @property
    def time(self) -> Series:
        """Communication points [s] (n,)."""
        return self.series["time"]

    def __getitem__(self, name: str) -> Series:
        """Return the series (n,) of a variable, `component.variable`. Raises KeyError."""
        return self.series[name]

    @property
    def estimates(self) -> dict[str, Series]:
        """Values of each estimated parameter in the controller (n,), by parameter name."""
        return {p.name: self.series[self.scenario.held_column(p)] for p in self.scenario.estimation.parameters}

    @property
    def gains(self) -> dict[str, Series]:
        """Values of the controller's parameters that formulas give (n,), by name, `component.variable`."""
        return {name: self.series[name] for name in self.scenario.formulas}

    @property
    def true_parameters(self) -> dict[str, Series]:
        """True values of each estimated parameter (n,), by parameter name."""
        return {p.name: self.series[self.scenario.true_reference(p)] for p in self.scenario.estimation.parameters}

    @property
    def errors(self) -> dict[str, Series]:
        """Tracked output minus its reference (n,), by tracked output."""
        return {a: self.series[a] - self.series[b] for a, b in self.scenario.tracking.items()}

    @property
    def mse(self) -> list[float]:
        """Mean squared tracking error over the recorded points, one number per tracked output."""
        return [float(np.mean(e * e)) if len(e) else float("nan") for e in self.errors.values()]

    @property
    def max_error(self) -> float:
        """Largest absolute tracking error of any tracked output."""
        return max((float(np.max(np.abs(e))) for e in self.errors.values() if len(e)), default=float("nan"))

    @property
    def latency_times(self) -> Series | None:
        """Time [s] of each macro step of the latencies (n,); None where the record does not tell."""
        if sum(last + 1 - first for first, last in self.latency_steps) != len(self.latencies):
            return None
        time = self.scenario.scenario.time
        return np.array([time(k) for first, last in self.latency_steps for k in range(first, last + 1)])

    @property
    def diverged_at(self) -> float | None:
        """Time [s] at which a tracking error exceeded limits.divergence; None where none did."""
        return float(self.time[-1]) if self.status == "diverged" else None

    def parameters_at(self, t: float) -> list[dict[str, Any]]:
        """Return name, unit, true and estimated value of each parameter at the first communication point >= t [s]."""
        k = int(np.searchsorted(self.time, t - 1e-9))
        truth, estimates = self.true_parameters, self.estimates
        return [
            {"name": p.name, "unit": p.unit, "true": float(truth[p.name][k]), "estimated": float(estimates[p.name][k])}
            for p in self.scenario.estimation.parameters
            if k < len(self.time)
        ]

    def summary(self) -> dict[str, Any]:
        """Return the run's figures as JSON values; times ending in _ms are wall times in ms, others in s."""
        evaluations = np.array([1e3 * s for step in self.latencies for s in step])
        deadline = self.scenario.scenario.macro_step
        instants = self.scenario.estimation.instants
        return {
            "scenario": self.scenario.scenario.name,
            "estimator": self.estimator,
            "seed": self.seed,
            "mse": self.mse,
            "max_error": self.max_error,
            "parameters": self.parameters_at(float(self.time[-1])) if len(self.time) else [],
            "gains": {name: float(values[-1]) for name, values in self.gains.items() if len(values)},
            "final_estimate": self.final_estimate and self.final_estimate.to_json(),
            "instants": [{"t": t, "parameters": p} for t in instants if (p := self.parameters_at(t))],
            "evaluations": self.n_evaluations,
            "episodes": self.n_episodes,
            "model_calls": self.n_model_calls,
            "objective": self.objective or None,
            "guard": self.guard,
            "observations": self.observations,
            "diagnosis": self.diagnosis,
            "latency_ms": _quantiles(evaluations),
            "latency_steps": [list(stretch) for stretch in self.latency_steps],
            "deadline_ms": 1e3 * deadline,
            "missed_deadlines": sum(sum(step) > deadline for step in self.latencies),
            "wall_s": self.wall,
            "status": self.status,
            "diverged_at": self.diverged_at,
            "error": self.error,
            "run": str(self.folder) if self.folder else None,
        }

    def to_pandas(self) -> Any:
        """Return the series as a pandas DataFrame indexed by time. Raises ImportError without pandas."""
        try:
            import pandas as pd
        except ImportError as e:
            raise ImportError("to_pandas needs pandas: pip install 'fmu-retune[pandas]'") from e
        return pd.DataFrame(dict(self.series)).set_index("time")

    def to_xarray(self) -> Any:
        """Return the series as an xarray Dataset, with units and attributes. Raises ImportError without xarray."""
        return _built_on_runs("runs.dataset").to_dataset(self)

    def plot(self, *names: str, axes: Any = None) -> Any:
        """Draw columns, by default tracked outputs, inputs and parameters, a pair of Matplotlib axes each.

        axes: one or several to draw on, by default those of a new figure. Returns them in the form in which they were
        given. Raises KeyError for a column that there is not, ValueError for too few axes.
        """
        return _built_on_runs("plots.overlay").plot_run(self, names, axes)

    def _repr_html_(self) -> str:
        """Return the table that a notebook shows."""
        return _built_on_runs("pages.notebook").html_of(self)


def _built_on_runs(module: str) -> Any:
    """Return a module that is built on runs, loaded when it is needed: this one cannot import it."""
    return import_module(f"cosim.{module}")


def begin_folder(
    folder: Path, scenario: Scenario, estimator: str, seed: int, fmus: Mapping[str, Path], plant: Plant
) -> None:
    """Write the manifest of a run that starts or is resumed; remove files that an earlier end of it has left."""
    content = {
        "status": "running",
        "estimator": estimator,
        "seed": seed,
        "fmus": {name: {"file": str(path), "sha256": sha256(path)} for name, path in fmus.items()},
        "modules": modules(scenario.folder),
        "versions": versions(),
        "plant": asdict(plant),
        "folder": str(scenario.folder.resolve()),
        "scenario": scenario.model_dump(mode="json"),
    }
    write_manifest(folder, content, is_own=not scenario.origin.stranger)
    remove_half_written(folder)
    for name in MADE_AT_END:
        (folder / name).unlink(missing_ok=True)


def remove_half_written(folder: Path) -> None:
    """Remove the temporary files of a process that was killed while it replaced others."""
    for path in folder.glob(".*-????????"):
        if path.is_file():
            path.unlink(missing_ok=True)


def end_folder(run: Run, folder: Path, units: Mapping[str, Unit], unit_of: Mapping[str, str | None]) -> None:
    """Write result, estimates and, of a short one, CSV of a finished run, and close its manifest with the hashes.

    units: unit definitions of the FMUs, by name; unit_of: the unit of each parameter that a formula gives.
    """
    write_json(folder / RESULT, run.summary())
    write_text(folder / LATENCIES, to_json(run.latencies, is_compact=True) + "\n")
    if len(run.time):
        parameters = run.scenario.estimation.parameters
        unit_of = {**unit_of, **{name: p.unit for p in parameters if p.is_written_as_it_is for name in p.written}}
        held = [ParameterValue(name, float(run[name][-1]), unit_of.get(name)) for name in run.scenario.written]
        write_text(folder / ESTIMATES, to_ssv(run.scenario.scenario.name, held, units))
    if run.scenario.record.is_small(len(run.time) * len(run.series)):
        write_csv(folder / CSV, run.series)
    begun, manifest = read_manifest(folder), json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    hashes = {name: sha256(folder / name) for name in sorted(SEALED) if (folder / name).is_file()}
    content = manifest | {"status": run.status, "sha256": hashes}
    is_own = not run.scenario.origin.stranger and is_signed(begun.seal, begun.signature)  # it is still as it was begun
    write_manifest(folder, content, is_own)
    if run.status in ("done", "diverged"):
        (folder / CHECKPOINT).unlink(missing_ok=True)


def read_run(folder: Path | str) -> Run:
    """Return the run that a folder records.

    One in progress, or killed, is returned as far as it is written, with status `running` or `unfinished`.
    Raises FolderError for a folder that holds no run, or a damaged one.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    scenario = scenario_of(folder, manifest)
    if manifest.status == "running":
        status = "running" if is_locked(folder) else "unfinished"
        _check_begun(folder)
        result, latencies = _Result(), ()
    else:
        for name in SEALED:  # of what else is in the folder, such as pictures and notes, the user may dispose
            if name in REQUIRED or name in manifest.sha256:
                check_file(folder, name, manifest.sha256)
        status, result = manifest.status, read_json(folder, RESULT, _Result)
        latencies = read_json(folder, LATENCIES, tuple[tuple[float, ...], ...])
    series = read_series(folder)
    return Run(
        scenario, manifest.plant, manifest.estimator, manifest.seed, series, status, result.error, result.evaluations,
        result.episodes, latencies, result.wall_s, folder, result.model_calls,
        result.objective or "", result.guard, result.observations, result.diagnosis,
        final_estimate_from_json(result.final_estimate or result.belief), result.latency_steps,
    )  # fmt: skip


def _check_begun(folder: Path) -> None:
    """Raise FolderError where the series on the disk does not begin as it was at the last checkpoint."""
    try:
        is_whole = read_checkpoint(folder).place.series.digest_of(folder / SERIES) is not None
    except (NotResumableError, OSError):  # nothing to compare with; who reads the series says what is wrong with it
        return
    if not is_whole:
        raise FolderError(f"{folder} is damaged: {SERIES} is not as it was written.")


@dataclass(frozen=True)
class _Result:
    """The part of a result file that is read."""

    error: str | None = None
    evaluations: int = 0
    episodes: int = 0
    model_calls: int = 0
    objective: str | None = None
    guard: dict[str, Any] | None = None
    observations: dict[str, Any] | None = None
    diagnosis: dict[str, Any] | None = None
    wall_s: float = float("nan")
    latency_steps: tuple[tuple[int, int], ...] = ()
    final_estimate: dict[str, Any] | None = None
    belief: dict[str, Any] | None = None
    """Former name of final_estimate."""


def _quantiles(milliseconds: Series) -> dict[str, float | None]:
    if not len(milliseconds):
        return {"p50": None, "p99": None, "max": None}
    p50, p99 = np.percentile(milliseconds, [50, 99])
    return {"p50": float(p50), "p99": float(p99), "max": float(milliseconds.max())}
