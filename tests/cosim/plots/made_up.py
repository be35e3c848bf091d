"""Runs that are made up, for pictures of them."""

from pathlib import Path

import numpy as np

from cosim import Run, Scenario
from cosim.runs.final_estimate import FinalEstimate
from cosim.system.plant import Plant

GONE = {f"components.{name}.fmu": "gone.fmu" for name in ("plant", "controller", "reference")}
COLUMNS = (
    "plant.phi", "plant.phi_dot", "plant.der(phi)", "plant.der(phi_dot)", "held.plant.u", "controller.u",
    "reference.phi_ref", "plant.m", "plant.l", "controller.m", "controller.l", "sampled.plant.der(phi_dot)",
)  # fmt: skip

PLANT = Plant("plant", ("phi", "phi_dot"), {"u": 0.0}, (1,))


def made_up_run(
    folder: Path | None, n: int = 50, scenario: Scenario | None = None, estimator: str = "target",
    final_estimate: FinalEstimate | None = None, **columns: object,
) -> Run:  # fmt: skip
    """A run of the pendulum scenario whose series are random but for the columns given by `component_variable`."""
    rng = np.random.default_rng(0)
    series = {"time": 0.01 * np.arange(n)} | {name: rng.uniform(0.5, 2.0, n) for name in COLUMNS}
    given = {name: columns.get(name.replace(".", "_"), values) for name, values in series.items()}
    return Run(
        scenario=scenario or Scenario.load("pendulum", GONE), plant=PLANT, estimator=estimator, seed=0,
        series={name: np.broadcast_to(np.asarray(v, dtype=float), (n,)) for name, v in given.items()},
        status="done", error=None, n_evaluations=0, n_episodes=0, latencies=(), wall=0.0, folder=folder,
        final_estimate=final_estimate,
    )  # fmt: skip
