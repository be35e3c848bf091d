"""The row of a run, against the run itself."""

import numpy as np
import pytest

from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario
from cosim.studies.definition import RESERVED
from cosim.studies.row import WALL_TIMES, record_of, row_of


@pytest.mark.full
@pytest.mark.fmu
def test_a_row_has_the_figures_of_its_run():
    changes = {
        'changes."plant.m"': "[[0.0, 1.75], [0.05, 4.0]]",
        "scenario.stop_time": "0.2",
        "scenario.isolation": "none",
    }
    made = run(Scenario.load("pendulum", changes), "target")
    row = row_of(made)
    error = made["plant.phi"] - made["reference.phi_ref"]
    assert row["mse"] == row["mse plant.phi"] == pytest.approx(np.mean(error**2))
    assert row["largest error"] == pytest.approx(np.abs(error).max())
    assert row["error m [kg]"] == made["controller.m"][-1] - 4.0
    assert (row["status"], row["end [s]"]) == ("done", pytest.approx(0.2))
    changed = np.flatnonzero(np.diff(made["controller.m"]) != 0.0)
    assert row["first write [s]"] == made.time[changed[0] + 1]
    assert row["writes"] >= 1
    assert row["triggers"] == made.n_episodes >= 1
    assert (row["vetoes"], row["reverts"], row["disturbances"]) == (0, 0, 0)
    assert set(WALL_TIMES) <= row.keys()
    own = {name for name in row if not name.startswith(("mse ", "error "))}
    assert own <= RESERVED  # no factor may be called so
    assert record_of(made)["end"] == row["end [s]"]
    still = row_of(run(Scenario.load("pendulum", changes), "none"))
    assert (still["writes"], still["first write [s]"], still["triggers"]) == (0, None, 0)
