"""Simulate the drive in FMPy, as an SSP package: first the gains of the start, then those of the estimator FMU."""

import os
import re
import sys
import zipfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from fmpy.ssp.simulation import simulate_ssp

INERTIA = 0.08  # kg m2: four times what the gains were made for
FMUS = ("Steps", "DriveEstimator", "SpeedController", "Drive")


def package(file: Path, structure: str) -> Path:
    """Write an SSP package of the FMUs; structure: its SystemStructure.ssd."""
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("SystemStructure.ssd", structure)
        for name in FMUS:
            archive.write(f"{name}.fmu", f"resources/{name}.fmu")
    return file


def simulate(file: Path):
    """Return the variables over time. FMPy takes start values as an object."""
    start = SimpleNamespace(parameters=[SimpleNamespace(name="plant.inertia.J", value=INERTIA)])
    return simulate_ssp(str(file), stop_time=6.0, step_size=0.01, parameter_set=start)


structure = Path("SystemStructure.ssd").read_text(encoding="utf-8")
gains = re.compile(r'"(k_in|Ti_in)"')  # the controller's inputs, without which it has the gains of the start
without = "".join(line for line in structure.splitlines(keepends=True) if not gains.search(line))
for name, text in (("nominal", without), ("retuned", structure)):
    found = simulate(package(Path(f"{name}.ssp"), text))
    late = found["time"] >= 3.0
    error = np.mean((found["plant.inertia.w"] - found["reference.w_ref"])[late] ** 2)
    held = ", ".join(f"{gain} {found[f'estimator.PI.{gain}'][-1]:.4g}" for gain in ("k", "Ti"))
    print(f"{name}.ssp: mean squared error {error:.3g} (rad/s)2 from 3 s on; J {found['estimator.J'][-1]:.4g}, {held}")
sys.stdout.flush()
os._exit(0)  # before the exit handler of pythonfmu, which made the estimator
