"""What stands in a plant's folder beside its modules: a reference trajectory and a page for its reader."""

import csv

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmu_models import build
from fmu_models.kernel.arrays import arrays
from tests.fmu_models.reference_data import CASES, PACKAGE

PLANTS = {build.MODELS[name].__module__.split(".")[1]: name for name in build.PLANTS}
"""Name of the FMU by folder."""
STEP = 0.01
each_plant = pytest.mark.parametrize("folder", PLANTS)


def read_reference(folder):
    with (PACKAGE / folder / "reference.csv").open(encoding="utf-8", newline="") as file:
        names, *rows = csv.reader(file)
    return names, np.array(rows, dtype=float)


def script_of(names, rows, n_inputs):
    """The inputs of each row, set before the step that starts there."""
    return {
        str(round(row[0] / STEP)): dict(zip(names[1 : 1 + n_inputs], row[1 : 1 + n_inputs].tolist(), strict=True))
        for row in rows
    }


@pytest.fixture(scope="module")
def error_of(built, host):
    """error_of(folder, max_step): the largest difference between the FMU's states and its reference, in SI units."""

    def largest(folder, max_step):
        case, (names, rows) = CASES[folder], read_reference(folder)
        n_inputs = len(case.inputs)
        result = host(
            "simulate", fmu=built[2][PLANTS[folder]], n_steps=round(rows[-1, 0] / STEP),
            start=case.parameters | {"max_step": max_step}, script=script_of(names, rows, n_inputs),
        )  # fmt: skip
        columns = [result["names"].index(name) for name in case.states]
        found = np.array(result["rows"])[np.round(rows[:, 0] / STEP).astype(int)][:, columns]
        return np.abs(found - rows[:, 1 + n_inputs :]).max()

    return largest


@pytest.mark.fmu
@pytest.mark.parametrize(
    ("folder", "step", "bound"),
    [
        ("pendulum", 0.01, 1e-6),
        ("quadrotor", 0.01, 2e-9),
        ("rigid_body", 0.01, 1e-7),
        ("magnetic_levitation", 0.002, 1e-6),
    ],
)
def test_the_fmu_follows_its_reference_with_an_error_of_fourth_order(error_of, folder, step, bound):
    """RK4 on a motion of rate w is off by some w (w h)^4 / 120 of it a second, and by a sixteenth of that at h/2.

    At h = 10 ms: of the pendulum, 3.6 rad/s, by 5e-7 in ten seconds; the bodies turn slowly, at 0.3 and 1.4 rad/s.
    At 2 ms the ball's error, (37/s h)^4/120 of 10 mm or 3e-9 m, grows with exp(37/s t) while it is near the magnet.
    """
    errors = [error_of(folder, max_step) for max_step in (step, step / 2)]
    assert errors[0] < bound
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.1)


@pytest.mark.fmu
@pytest.mark.parametrize(("max_step", "bound"), [(0.005, 1e-2), (0.0005, 4e-3)])
def test_the_pendulum_with_stiction_follows_its_reference(error_of, max_step, bound):
    """Where slip ends inside a step, rad/s^2 times a part of the step is lost; from then on the order is the first."""
    assert error_of("friction_pendulum", max_step) < bound


@each_plant
def test_the_reference_is_what_the_independent_equations_give(folder):
    names, rows = read_reference(folder)
    case = CASES[folder]
    assert names == ["time", *case.inputs, *case.states]
    # Another SciPy may take other steps, of a relative error of 1e-12 each.
    assert_allclose(rows, case.rows(), rtol=1e-9, atol=1e-9)


@each_plant
def test_the_reference_starts_as_the_fmu_does(folder):
    names, rows = read_reference(folder)
    starts = {v.name: v.start for v in build.MODELS[PLANTS[folder]].variables}
    assert {name: rows[0, names.index(name)] for name in CASES[folder].states} == {
        name: starts[name] for name in CASES[folder].states
    }


@each_plant
def test_the_readme_has_the_fmu_s_variables(folder):
    text = (PACKAGE / folder / "README.md").read_text(encoding="utf-8")
    table = [line for line in text.splitlines() if line.startswith("| `")]
    kinds = {"parameter": "parameter", "input": "input", "output": "state"}
    given = [a for a in arrays(build.MODELS[PLANTS[folder]].variables) if a.members[0].start is not None]
    assert table == [
        f"| `{a.name}` | {v.unit} | {kinds[v.causality]} | {' '.join(f'{m.start:g}' for m in a.members)} "
        f"| {a.description} |"
        for a in given
        if (v := a.members[0]).name not in ("tau_u", "max_step")
    ]
