"""Every FMU, and both closed loops, in the importers of others: what they make of them against our own master.

Each importer simulates all its jobs in a process of its own; importers/jobs.py says what a job is. Those whose pinned
dependencies are not ours live in environments of their own, which `make interop` makes.
"""

import json
import os
import subprocess
import sys
from contextlib import ExitStack
from dataclasses import asdict, replace
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import NamedTuple

import fmpy
import numpy as np
import pytest

from cosim import Scenario, open_slave, run
from cosim.system.fmu_cache import find_fmu
from cosim.system.master import Master, Wiring
from fmu_models.build import NAMES

pytestmark = [pytest.mark.full, pytest.mark.interop, pytest.mark.fmu]

ROOT = Path(__file__).parents[2]
SCRIPTS = Path(__file__).with_name("importers")
VENVS = ROOT / ".venv-interop"
N_STEPS = 200

_spec = spec_from_file_location("jobs", SCRIPTS / "jobs.py")
jobs = module_from_spec(_spec)
sys.modules["jobs"] = jobs  # a dataclass looks its module up
_spec.loader.exec_module(jobs)

SEQUENTIAL = [["controller"], ["plant", "reference"]]
PARALLEL = [["plant", "controller", "reference"]]
REFERENCE_FIRST = [["reference"], ["plant", "controller"]]


class Case(NamedTuple):
    """An importer with one of its exchange orders."""

    importer: str
    order: str
    """As docs/interop.md calls it."""
    groups: list[list[str]]
    """In which groups our master steps the FMUs to do the same."""
    options: dict = {}
    """The importer's own settings."""
    start: str = "consistent"
    """`consistent`: inputs are given the start values of what they are connected to. `propagated`: the importer has to
    find these. `model`: `consistent`, but the plant's states start at the FMU's own values, not the scenario's."""


def one_by_one(*names):
    return [[name] for name in names]


def ordered(*names, **options):
    return options | {"order": list(names)}


CASES = (
    Case("fmpy", "written by hand", SEQUENTIAL, ordered("controller", "plant", "reference")),
    Case("libcosim", "fixed step", PARALLEL, {}, "propagated"),
    Case("ecos", "fixed step", PARALLEL, {}, "propagated"),
    Case("pathsim", "controller, plant", SEQUENTIAL, ordered("controller", "plant", "reference")),
    Case(
        "pathsim", "plant, controller", one_by_one("plant", "controller", "reference"),
        ordered("plant", "controller", "reference"),
    ),
    Case("cofmupy", "jacobi", REFERENCE_FIRST),
    Case(
        "cofmupy", "gauss_seidel: controller, plant", one_by_one("reference", "controller", "plant"),
        ordered(["reference"], ["controller", "plant"], cosim_method="gauss_seidel"),
    ),
    Case(
        "cofmupy", "gauss_seidel: plant, controller", one_by_one("reference", "plant", "controller"),
        ordered(["reference"], ["plant", "controller"], cosim_method="gauss_seidel"),
    ),
    Case("gemseo", "MDAJacobi", REFERENCE_FIRST, {"mda_name": "MDAJacobi"}, "model"),
    Case(
        "gemseo", "MDAGaussSeidel: controller, plant", one_by_one("reference", "controller", "plant"),
        ordered("controller", "plant", "reference", mda_name="MDAGaussSeidel"), "model",
    ),
    Case(
        "gemseo", "MDAGaussSeidel: plant, controller", one_by_one("reference", "plant", "controller"),
        ordered("plant", "controller", "reference", mda_name="MDAGaussSeidel", is_function=True), "model",
    ),
)  # fmt: skip
IMPORTERS = tuple(dict.fromkeys(case.importer for case in CASES))
REALS_ONLY = ("pathsim", "cofmupy")
READS_FMI_3 = ("ecos", "pathsim")
LOOPS = ("pendulum", "quadrotor")
TRACKED = {"pendulum": ["plant.phi"], "quadrotor": ["plant.r_x", "plant.r_y", "plant.r_z"]}
CHANGES = {
    "pendulum": {"m": 4.271, "l": 0.981},
    "quadrotor": {"m": 1.85, "J_x": 6.0195, "J_y": 6.0195, "J_z": 9.3195},
}
START = {"pendulum": {"reference.phi_initial": 0.8, "reference.step_time": 0.305}, "quadrotor": {}}
each_importer = pytest.mark.parametrize("importer", IMPORTERS)
each_case = pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.importer}-{case.order}")
each_loop = pytest.mark.parametrize("loop", LOOPS)


# -- jobs ---------------------------------------------------------------------------------------------------------


def variables_of(path):
    return fmpy.read_model_description(path).modelVariables


def alone(name):
    """One FMU whose inputs and tunable parameters all change in mid-run."""
    path = find_fmu(name, Path())
    reals = [v for v in variables_of(path) if v.type == "Real"]
    settable = [v for v in reals if v.causality == "input" or v.variability == "tunable"]
    start = {f"model.{v.name}": float(v.start) for v in settable}
    change = {f"model.{v.name}": 1.05 * float(v.start) + 0.1 * is_free(v) for v in settable}
    outputs = [f"model.{v.name}" for v in reals if v.causality == "output"]
    return jobs.Job(0.01, 40, {"model": str(path)}, start, {}, {"15": change}, outputs, {})


def is_free(v):
    """Whether it is an input that may be larger than its start by 0.1."""
    return v.causality == "input" and (v.max is None or float(v.max) > 1.05 * float(v.start) + 0.1)


def has_boolean_input(name):
    return any(v.causality == "input" and v.type == "Boolean" for v in variables_of(find_fmu(name, Path())))


@cache
def closed_loop(name, start="consistent", at=50):
    """A named scenario's FMUs and connections; plant and controller change at t_50."""
    scenario = Scenario.load(name)
    fmus = {c: str(find_fmu(component.fmu, Path())) for c, component in scenario.components.items()}
    given = {f"{c}.{v}": float(x) for c, component in scenario.components.items() for v, x in component.start.items()}
    given |= START[name]
    states = {f"plant.{v.derivative.name}" for v in variables_of(fmus["plant"]) if v.derivative is not None}
    change = {f"{c}.{v}": value for c in ("plant", "controller") for v, value in CHANGES[name].items()}
    if start == "model":
        given = {v: x for v, x in given.items() if v not in states}
        starts = {f"{c}.{v.name}": v.start for c, path in fmus.items() for v in variables_of(path)}
        given |= {v: float(starts[v]) for v in change}
    outputs = sorted({*states, *(f"{v}_held" for v in scenario.connections if v.startswith("plant."))})
    job = jobs.Job(scenario.scenario.macro_step, N_STEPS, fmus, given, dict(scenario.connections), {}, outputs, {})
    for _ in range(0 if start == "propagated" else 2):  # outputs of the plant, then of the controller
        _, initial = ours(replace(job, n_steps=1), PARALLEL)
        job = replace(job, start=job.start | {v: initial[source] for v, source in job.connections.items()})
    return replace(job, changes={str(at): change})


def ours(job, groups):
    """Rows of our master at t_1 .. t_n, and the outputs at t_0."""
    with ExitStack() as stack:
        slaves = {name: stack.enter_context(open_slave(Path(path), name)) for name, path in job.fmus.items()}
        tunables = {name: list(job.of(name, dict.fromkeys(sorted(job.changed())))) for name in job.fmus}
        wiring = {
            name: Wiring(
                job.of(name, job.connections), tuple(tunables[name]),
                tuple(v.name for v in variables_of(path) if v.causality == "output"), job.of(name, job.start),
            ) for name, path in job.fmus.items()
        }  # fmt: skip
        master, h = Master(slaves, wiring, groups), job.macro_step
        master.initialize(0.0, job.n_steps * h)
        initial, rows = dict(zip(master.names, master.values, strict=True)), []
        for k in range(job.n_steps):
            values = {name: job.of(name, job.changes_at(k)) for name in job.fmus}
            now = {name: [v[p] for p in tunables[name]] for name, v in values.items() if v}
            master.begin(k * h, h, now)
            master.finish(k * h, h, now)
            rows.append([master.values[master.names.index(name)] for name in job.outputs])
        return np.array(rows), initial


def ours_alone(job):
    ((name, path),) = job.fmus.items()
    settable = {v.name: v.causality for v in variables_of(path) if f"model.{v.name}" in job.changed()}
    inputs = [v for v, causality in settable.items() if causality == "input"]
    tunables = [v for v in settable if v not in inputs]
    values, rows = job.of(name, job.start), []
    with open_slave(Path(path), name) as slave:
        slave.bind(inputs, tunables, list(job.of(name, dict.fromkeys(job.outputs))))
        slave.initialize(values, 0.0, None)
        for k in range(job.n_steps):
            values |= job.of(name, job.changes_at(k))
            changed = [values[v] for v in tunables] if job.changes_at(k) else None
            rows.append(slave.step([values[v] for v in inputs], k * job.macro_step, job.macro_step, changed))
    return np.array(rows)


# -- importers ----------------------------------------------------------------------------------------------------


def python_of(importer):
    """The interpreter that has it; skips the test where there is none."""
    if importer == "fmpy":
        return sys.executable
    if (sys.platform, os.uname().machine if hasattr(os, "uname") else "") != ("linux", "x86_64"):
        pytest.skip("its package has binaries for Linux on x86_64 only, or was never tried elsewhere")
    if importer in ("cofmupy", "gemseo"):
        python = VENVS / importer / "bin" / "python"
        if not python.exists():
            pytest.skip(f"no {python.relative_to(ROOT)}: run `make interop`")
        return python
    return sys.executable


def jobs_of(importer):
    mine = {name: alone(name) for name in NAMES if not (importer in REALS_ONLY and has_boolean_input(name))}
    for case in CASES:
        for loop in LOOPS if case.importer == importer else ():
            mine[f"{case.order} {loop}"] = replace(closed_loop(loop, case.start), options=case.options)
    if importer in READS_FMI_3:
        case = next(case for case in CASES if case.importer == importer)
        fmus = {name: str(find_fmu(c.fmu, Path(), 3)) for name, c in Scenario.load("pendulum").components.items()}
        mine["FMI 3"] = replace(closed_loop("pendulum", case.start), fmus=fmus, options=case.options)
    if importer == "gemseo":
        mine["time series"] = replace(alone("Pendulum"), options={"lag": 0.0})
    return mine


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """The rows of all an importer's jobs, by job: simulated once."""
    folder = tmp_path_factory.mktemp("importers")

    @cache
    def simulate(importer):
        there, back = folder / f"{importer}.json", folder / f"{importer}-rows.json"
        there.write_text(json.dumps({name: asdict(job) for name, job in jobs_of(importer).items()}), encoding="utf-8")
        # As docs/commands.md advises: pythonfmu's library touches freed memory when its process ends.
        environment = os.environ | {"GLIBC_TUNABLES": "glibc.malloc.tcache_count=65535", "PYTHONPATH": ""}
        done = subprocess.run(
            [python_of(importer), SCRIPTS / f"run_{importer}.py", there, back],
            capture_output=True, text=True, env=environment, cwd=folder, timeout=600,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr[-3000:]
        return {name: np.array(rows) for name, rows in json.loads(back.read_text(encoding="utf-8")).items()}

    return lambda importer: python_of(importer) and simulate(importer)


@cache
def expected(loop, start, groups):
    """Our rows; groups as text, to be hashable."""
    return ours(closed_loop(loop, "consistent" if start == "propagated" else start), json.loads(groups))[0]


@each_importer
@pytest.mark.parametrize("name", NAMES)
def test_an_fmu_alone_gives_the_same_outputs(simulated, importer, name):
    """Its inputs and tunable parameters change at t_15."""
    if importer in REALS_ONLY and has_boolean_input(name):
        pytest.skip(f"{importer} sets every input as a Real")
    np.testing.assert_allclose(simulated(importer)[name], ours_alone(alone(name)), rtol=0.0, atol=1e-9)


@each_case
@each_loop
def test_the_closed_loop_gives_our_trajectory_in_the_importer_s_order(simulated, case, loop):
    """States of the plant and the inputs that it held; plant and controller change at t_50."""
    rows = simulated(case.importer)[f"{case.order} {loop}"]
    np.testing.assert_allclose(rows, expected(loop, case.start, json.dumps(case.groups)), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("importer", READS_FMI_3)
def test_the_closed_loop_of_fmi_3_fmus_gives_the_same(simulated, importer):
    case = next(case for case in CASES if case.importer == importer)
    ours = expected("pendulum", case.start, json.dumps(case.groups))  # of FMI 2.0 FMUs
    np.testing.assert_allclose(simulated(importer)["FMI 3"], ours, rtol=0.0, atol=1e-9)


def test_a_time_series_of_gemseo_acts_one_macro_step_early(simulated):
    job = alone("Pendulum")
    early = replace(job, changes={"14": job.changes["15"]})
    np.testing.assert_allclose(simulated("gemseo")["time series"], ours_alone(early), rtol=0.0, atol=1e-9)


@each_loop
def test_a_change_in_mid_run_matters(loop):
    """Without it the comparison above could not see whether an importer sets parameters."""
    job = closed_loop(loop)
    (change,) = job.changes.values()
    for component in ("plant", "controller"):
        part = {name: value for name, value in change.items() if name.startswith(component)}
        rows, _ = ours(replace(job, changes={"50": part}), SEQUENTIAL)
        difference = np.abs(rows - expected(loop, "consistent", json.dumps(SEQUENTIAL)))
        assert difference[:50].max() == 0.0
        assert difference[50:].max() > 1e-3


@each_loop
@pytest.mark.parametrize(("coupling", "groups"), [("sequential", SEQUENTIAL), ("parallel", PARALLEL)])
def test_our_master_is_that_of_a_run(loop, coupling, groups):
    """A run of the scenario in which `true` writes into the controller what happens to the plant."""
    job = closed_loop(loop)
    settings = {f"components.{name.replace('.', '.start.', 1)}": repr(value) for name, value in job.start.items()}
    settings |= {"scenario.coupling": coupling, "scenario.stop_time": repr(N_STEPS * job.macro_step)}
    values = {v.name: v.start for v in variables_of(job.fmus["plant"])}
    for name, value in CHANGES[loop].items():
        settings[f'changes."plant.{name}"'] = f"[[0.0, {values[name]}], [{50 * job.macro_step}, {value}]]"
    result = run(Scenario.load(loop, settings), "true")
    rows = np.stack([result[name][1:] for name in job.outputs], axis=1)
    assert np.array_equal(rows, expected(loop, "consistent", json.dumps(groups)))


# -- docs/interop.md ----------------------------------------------------------------------------------------------


def table():
    """Cells of the table of orders in the document, by importer and order."""
    text = (ROOT / "docs" / "interop.md").read_text(encoding="utf-8")
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("| `")
    ]
    return {(row[0].strip("`"), row[1]): row[2:] for row in rows if len(row) == 6}


def test_the_document_has_every_order():
    assert list(table()) == [(case.importer, case.order) for case in CASES]


@each_case
@each_loop
def test_the_document_tells_the_difference_from_our_coupling(simulated, case, loop):
    """Largest difference of a tracked state in 2 s from a run of ours with the coupling that the document names."""
    groups, coupling, *differences = table()[case.importer, case.order]
    assert groups == " ".join(f"[{', '.join(group)}]" for group in case.groups)
    near = {"sequential": SEQUENTIAL, "parallel": PARALLEL}[coupling]
    columns = [closed_loop(loop).outputs.index(name) for name in TRACKED[loop]]
    rows = simulated(case.importer)[f"{case.order} {loop}"]
    measured = np.abs(rows - expected(loop, case.start, json.dumps(near)))[:, columns].max()
    told = differences[LOOPS.index(loop)]
    assert measured < 1e-9 if told == "0" else measured == pytest.approx(float(told), rel=0.02), measured
