"""Runs for the pages: one that is recorded, and some that are made up."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim import Scenario, run
from cosim.pages.runs_page import PageOfRuns
from cosim.pages.sketch import ShownRun
from cosim.plots.palette import RUNS
from cosim.runs.manifest import Manifest
from cosim.runs.result import Run
from cosim.system.plant import Plant

PLANT = Plant("plant", ("phi", "phi_dot"), {"u": 0.0}, (1,))
GONE = {f"components.{name}.fmu": "gone.fmu" for name in ("plant", "controller", "reference")}


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    """The folder of a short run of the pendulum whose mass changes, with the run of the nominal controller."""
    folder = tmp_path_factory.mktemp("recorded") / "run"
    scenario = Scenario.load(
        "pendulum", {"scenario.stop_time": "1.2", "changes": '{"plant.m" = [[0.0, 1.75], [0.05, 4.271]]}'}
    )
    run(scenario, "target", 0, folder)
    run(scenario, "none", 0, folder / "none")
    return folder


@pytest.fixture
def made_up():
    """made_up(n, about, events, **columns): a run without FMUs, whose mass jumps from 1 to 2 kg halfway."""

    def make(n=100, about="", events=(), **columns):
        t = 0.01 * np.arange(n)
        series = {
            "time": t, "plant.phi": np.sin(t), "reference.phi_ref": np.cos(t), "controller.u": t, "held.plant.u": t,
            "plant.m": np.where(np.arange(n) < n // 2, 1.0, 2.0), "plant.l": np.full(n, 0.75),
            "controller.m": np.where(np.arange(n) < n // 2 + 7, 1.0, 2.01), "controller.l": np.full(n, 0.75),
        } | {key.replace("_", ".", 1): np.asarray(values, dtype=float) for key, values in columns.items()}  # fmt: skip
        settings = {"scenario.description": json.dumps(about), "scenario.stop_time": f"{t[-1]}"}
        scenario = Scenario.load("pendulum", GONE | settings)
        made = Run(
            scenario, PLANT, "target", 0, series, "done", None, 0, 0, (),
            1.0, None,
        )  # fmt: skip
        return ShownRun("r0", "mine", made, list(events), RUNS[0])

    return make


@pytest.fixture
def page_of():
    """page_of(shown): the page of a run that is made up."""
    manifest = Manifest(
        "done", "target", 0, PLANT, Path(), {}, versions={"numpy": "9.9"}, sha256={"series.csv": "ab12"}
    )
    return lambda shown: PageOfRuns((shown,), {"r0": {}}, {"r0": manifest})


@pytest.fixture
def changed():
    """changed(shown, **fields): the same shown run with other fields of its run."""
    return lambda shown, **fields: shown._replace(run=replace(shown.run, **fields))
