"""The making of one run in a worker, whatever engine has brought its recipe there."""

import contextlib
import os
import threading
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ..errors import CosimError, is_refusal, one_line
from ..runs.simulation import run
from ..slaves.killed import KILLED
from .parcels import unpacked
from .processes import LocalProcesses
from .recipe import Answer, KilledFmuError, Recipe
from .row import record_of, row_of
from .versions import all_versions


def make_run(recipe: Recipe) -> Answer:
    """Make a run in this process, which makes no other at the same time. Raises KilledFmuError, MemoryError."""
    if recipe.parcel is None:
        return _made(recipe, recipe.folder)
    with TemporaryDirectory(prefix="fmu-retune-run-") as folder:
        place = f"{folder}/run" if recipe.is_kept else None
        answer = _made(recipe, place)
        if place is None or answer.kind != "result":
            return answer
        return replace(answer, files={p.name: p.read_bytes() for p in Path(place).iterdir() if p.is_file()})


def make_run_far_away(recipe: Recipe, files: Mapping[str, bytes] | None = None) -> Answer:
    """Make a run on a machine that shares nothing with the head, in a process of its own for each thread.

    files: contents of the parcel's files, where an earlier answer has said that they are missing here.
    """
    if why := _difference(recipe.versions):
        return Answer("unfit", why)
    assert recipe.parcel is not None
    try:
        folder = unpacked(recipe.parcel, files)
    except CosimError as e:
        return Answer("unfinished", str(e))
    if folder is None:
        return Answer("missing")
    processes: LocalProcesses | None = getattr(_OWN, "processes", None)
    if processes is None:
        processes = _OWN.processes = LocalProcesses(1)
    scenario = recipe.scenario.model_copy(update={"folder": folder / "scenario"})
    return processes.submit(_make_run_in, str(folder / "working"), replace(recipe, scenario=scenario)).result()


_OWN = threading.local()
"""The process of each thread of a worker: several runs in one process would share its imports and BLAS threads."""


def _make_run_in(working_folder: str, recipe: Recipe) -> Answer:
    os.chdir(working_folder)
    return make_run(recipe)


def _made(recipe: Recipe, folder: str | None) -> Answer:
    path = Path(folder) if folder else None
    try:
        if path is not None:
            path.mkdir(parents=True, exist_ok=True)
        made = run(recipe.scenario, recipe.estimator, recipe.seed, path)
        if KILLED in (made.error or ""):
            raise KilledFmuError((made.error or "").rstrip("."))
        record: dict[str, Any] | None = record_of(made) if recipe.is_recorded else None
        return Answer("result", row=row_of(made), record=record)
    except (MemoryError, KilledFmuError):
        raise
    except Exception as e:
        why = str(e) if isinstance(e, CosimError) else f"{type(e).__name__}: {one_line(str(e))}."
        is_of_disk = isinstance(e, CosimError | OSError) and not is_refusal(e)
        return Answer("unfinished" if is_of_disk else "refused", why)
    finally:
        if path is not None:
            with contextlib.suppress(OSError):
                path.rmdir()  # of a run that was refused or ended before it had begun


def _difference(wanted: Mapping[str, str]) -> str:
    """Return in one line how this worker's versions differ from the head's; empty where they do not."""
    here = all_versions()
    differ = [f"{name} {here.get(name)} instead of {v}" for name, v in wanted.items() if here.get(name) != v]
    return f"it has {', '.join(differ)}" if differ else ""
