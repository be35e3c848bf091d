"""Check of the declared noise against what an earlier run of the scenario found the model to explain."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from ..errors import CosimError
from ..findings import Finding
from ..runs.manifest import read_json, read_manifest, scenario_of
from ..runs.run_files import RESULT
from ..scenarios.scenario import Scenario

_NOTABLE: Final = 1.5
"""Ratio of the residuals' true size to the declared noise, or its inverse, that is worth a line."""


def check_noise(scenario: Scenario, runs: Path = Path("runs")) -> Iterator[Finding]:
    """Yield notes with the noise to declare, from the newest run in runs that has this scenario's name and sampling.

    Data are read, and nothing is run. A run on which parameters changed serves as well: only quiet samples count.
    """
    found = _newest_diagnosis(scenario, runs)
    if found is None:
        return
    folder, channels = found
    for name, channel in channels.items():
        ratio = max(channel["scale"], channel["noise_ratio"]) if channel["noise_ratio"] else channel["scale"]
        if 1.0 / _NOTABLE < ratio < _NOTABLE:
            continue
        yield Finding(*_advice(scenario, name, ratio, folder), is_error=False, is_note=True)


def _advice(scenario: Scenario, name: str, ratio: float, folder: Path) -> tuple[str, str]:
    """Return where the noise is declared, and what to declare."""
    sampling = scenario.sampling
    tables = {"derivatives": sampling.derivatives, "states": sampling.states, "outputs": sampling.outputs}
    for table, declared in tables.items():
        noise = next((n.noise for key, n in declared.items() if key == name and n.noise), None)
        if noise:
            where = f'sampling.{table}."{name}"'
            return where, f"{folder} explains it to {ratio:.2g} times this noise: noise = {noise * ratio:.2g}"
    return "sampling", f"{folder} explains {name} to {ratio:.2g} times its noise: multiply the states' by as much"


def _newest_diagnosis(scenario: Scenario, runs: Path) -> tuple[Path, Mapping[str, Any]] | None:
    """Return the newest finished run's folder and the findings of its diagnosis on each channel, or None."""
    folders = sorted(runs.glob(f"{scenario.scenario.name}-*"), key=lambda folder: (len(folder.name), folder.name))
    for folder in reversed(folders):
        with suppress(CosimError, OSError):
            manifest = read_manifest(folder)
            if manifest.status != "done" or scenario_of(folder, manifest).sampling != scenario.sampling:
                continue
            diagnosis = read_json(folder, RESULT, dict[str, Any]).get("diagnosis")
            if diagnosis:
                return folder, diagnosis["channels"]
    return None
