"""The measurement of the guard: cases are what they are called, and a row counts what its runs say."""

import numpy as np
import pytest

from benchmarks import guard
from fmu_models import pendulum


@pytest.mark.parametrize("name", ["pendulum", "quadrotor"])
@pytest.mark.parametrize("case", guard.CASES)
def test_every_case_is_a_scenario(case, name):
    guarded, bare = (guard.scenario_of(case, name, mode) for mode in ("guarded", "unguarded"))
    assert (guarded.guard.enabled, guarded.observations.enabled) == (True, True)
    assert (bare.guard.enabled, bare.observations.enabled) == (False, False)
    assert guarded.model_dump(exclude={"guard", "observations"}) == bare.model_dump(exclude={"guard", "observations"})
    is_disturbed = guarded.model_dump() != guard.scenario_of("undisturbed", name, "guarded").model_dump()
    assert is_disturbed == (case not in ("undisturbed", "paper"))


def test_the_model_of_wrong_structure_is_right_where_the_angle_is_small_and_nowhere_else():
    wrong, right = (
        np.array(f((0.01, 0.0), (1.0,), m=1.0, l=1.0)) for f in (guard.linear_pendulum, pendulum.derivative)
    )
    np.testing.assert_allclose(wrong, right, atol=1e-5)
    wrong, right = (f((1.0, 0.0), (1.0,), m=1.0, l=1.0) for f in (guard.linear_pendulum, pendulum.derivative))
    assert abs(wrong[1] - right[1]) > 1.0


def test_a_row_has_lost_runs_the_median_and_the_worst():
    def came_to(mode, status, mse, largest):
        labels = {"scenario": "pendulum", "case": "bias", "mode": mode, "status": status}
        return labels | {"mse": mse, "largest": largest, "vetoed": 2, "reverted": 3, "kept out": 4}

    runs = [came_to(mode, "done", float(s), 0.1 * s) for mode in guard.MODES for s in range(3)]
    runs.append(came_to("unguarded", "diverged", 9.0, 3.2))
    (row,) = guard.rows(runs)
    assert (row["guarded: lost"], row["unguarded: lost"], row["runs"]) == (0, 1, 3)
    assert (row["guarded: mse"], row["unguarded: mse"], row["unguarded: largest"]) == (1.0, 1.5, 3.2)
    assert (row["vetoed"], row["reverted"], row["kept out"]) == (2.0, 3.0, 4.0)


def test_an_interrupted_measurement_has_every_case_about_as_often():
    tasks = list(guard.tasks(4, 1, ["bias", "sign"]))
    assert len(tasks) == len(set(tasks)) == 2 * (2 * 4 + 1) + 2 * 3
    counts = [sum(t[:3] == ("pendulum", case, "guarded") for t in tasks[:12]) for case in ("bias", "sign")]
    assert abs(counts[0] - counts[1]) <= 1
