"""The head of a study: it leases runs to workers, and commits what comes back."""

import shutil
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from ..errors import CosimError, ScenarioError, UnfinishedError
from .engines import Engine, reason_of
from .ledger import MOST_LOSSES, Ledger
from .plan import PlannedRun, Study
from .recipe import Answer, Recipe
from .versions import all_versions
from .worker import make_run, make_run_far_away

POLL_S: Final = 0.5
"""Longest time between two looks for Ctrl-C, which Windows takes between waits only."""
UNCOMMITTED: Final = ".lease-"
"""Beginning of the name of a run folder that is not committed."""

StudyProgress = Callable[[Mapping[str, Any], int, int], None]
"""Callback after each run: its point and row, or the record of a comparison's run; the number of runs that have ended,
and the number of all runs."""


@dataclass(frozen=True)
class _Leased:
    """A run that a worker has."""

    run: PlannedRun
    lease: int
    recipe: Recipe
    files: Mapping[str, Path]
    """Files of the parcel, on this machine."""


class StudyError(CosimError):
    """Error for a run that was refused, in a comparison of which all runs are wanted."""


class UnfinishedStudyError(StudyError, UnfinishedError):
    """Error for a study that can go on later: the disk is full, or the engine has gone."""


class Head:
    """The head of a study: the one process that writes its ledger.

    1. make     leases queued runs to the engine's workers, and commits what comes back, until nothing is queued
    2.          gives back what is leased, when it is interrupted or cannot go on
    """

    def __init__(
        self,
        study: Study,
        ledger: Ledger,
        engine: Engine,
        folder_of: Callable[[PlannedRun], Path] | None = None,
        is_compared: bool = False,
    ) -> None:
        """folder_of: the run folder of a run, where it is kept. is_compared: the study is a comparison, which needs
        whole records, and ends with the first run that is refused."""
        self._study, self._ledger, self._engine = study, ledger, engine
        self._folder_of, self._is_compared = folder_of, is_compared
        self._versions = all_versions()
        self._waiting: deque[PlannedRun] = deque()
        self._running: dict[Future[Answer], _Leased] = {}

    def make(self, runs: Mapping[str, PlannedRun], progress: StudyProgress | None = None) -> None:
        """Make the runs that are queued, of all runs by key. Raises CosimError where the study cannot go on.

        Seed by seed: a study that is stopped has every point about as often.
        """
        self._waiting.extend(sorted((runs[key] for key in self._ledger.queued()), key=lambda run: run.seed))
        n_ended, n_runs = len(runs) - len(self._waiting), len(runs)
        try:
            while self._waiting or self._running:
                while self._waiting and len(self._running) < self._engine.width():
                    self._begin(self._waiting.popleft())
                for future in wait(self._running, POLL_S, FIRST_COMPLETED)[0]:
                    leased = self._running.pop(future)
                    if (row := self._ended(leased, future)) is not None:
                        n_ended += 1
                        if progress is not None:
                            progress(row, n_ended, n_runs)
                if not self._engine.is_alive():
                    raise UnfinishedStudyError(f"{self._engine.name} has gone.")
        finally:
            self._give_back()

    def _begin(self, run: PlannedRun) -> None:
        """Lease a run, and send its recipe."""
        study, files = self._study, dict[str, Path]()
        lease = self._ledger.lease(run.key)
        recipe = Recipe(
            study.scenario_at(run.source, run.point), run.estimator, run.seed, self._versions,
            is_kept=self._folder_of is not None, is_recorded=self._is_compared,
        )  # fmt: skip
        if not self._engine.is_here:
            scenario, parcel, files = study.packed(recipe.scenario, run.estimator)
            recipe = replace(recipe, scenario=scenario, parcel=parcel)
        elif self._folder_of is not None:
            recipe = replace(recipe, folder=str(self._place(run, lease)))
        self._send(_Leased(run, lease, recipe, files))

    def _send(self, leased: _Leased, content: Mapping[str, bytes] | None = None) -> None:
        """Submit a run; content: that of the files which the worker lacked."""
        executor = self._engine.executor
        try:
            if leased.recipe.parcel is None:
                future = executor.submit(make_run, leased.recipe)
            else:
                future = executor.submit(make_run_far_away, leased.recipe, content)
        except BaseException:
            self._ledger.give_back(leased.run.key, leased.lease)
            raise
        self._running[future] = leased

    def _ended(self, leased: _Leased, future: "Future[Answer]") -> dict[str, Any] | None:
        """Commit what has become of a run; return its row, or None where it has not ended yet."""
        key, lease = leased.run.key, leased.lease
        try:
            answer = future.result()
        except self._engine.losses as e:
            return self._lost(leased, reason_of(e))
        except self._engine.ends as e:
            self._ledger.give_back(key, lease)
            raise UnfinishedStudyError(f"{self._engine.name} has gone: {reason_of(e)}.") from e
        except Exception as e:  # what a worker that lacks this package raises, for one
            self._ledger.give_back(key, lease)
            raise UnfinishedStudyError(f"{self._engine.name}: a worker cannot make a run: {reason_of(e)}.") from e
        match answer.kind:
            case "result":
                return self._commit(leased, answer)
            case "missing":
                self._send(leased, {name: path.read_bytes() for name, path in leased.files.items()})
                return None
            case "refused":
                return self._refused(leased, answer.why)
            case "unfit":
                self._ledger.give_back(key, lease)
                raise ScenarioError(f"{self._engine.name}: a worker is refused: {answer.why}.")
            case "unfinished":
                self._ledger.give_back(key, lease)
                raise UnfinishedStudyError(f"{self._told(leased.run)}: {answer.why}")

    def _commit(self, leased: _Leased, answer: Answer) -> dict[str, Any]:
        """Commit a result: its folder by rename, then its row."""
        run, record, row = leased.run, answer.record, dict(answer.row)
        if self._folder_of is not None:
            place, folder = self._place(run, leased.lease), self._folder_of(run)
            try:
                if answer.files is not None:
                    place.mkdir(parents=True, exist_ok=True)
                    for name, content in answer.files.items():
                        (place / name).write_bytes(content)
                shutil.rmtree(folder, ignore_errors=True)  # of a head that was killed before it wrote the row
                place.rename(folder)
            except OSError as e:
                self._ledger.give_back(run.key, leased.lease)
                raise UnfinishedStudyError(f"cannot write {folder}: {e.strerror or e}.") from e
            row |= {"run": folder.name}
            record = record and record | {"run": str(folder)}
        self._ledger.finish(run.key, leased.lease, row, record, row["status"] == "done")
        return record or self._study.point_of(run) | row

    def _refused(self, leased: _Leased, why: str) -> dict[str, Any]:
        if self._is_compared:
            self._ledger.give_back(leased.run.key, leased.lease)
            raise StudyError(f"{self._told(leased.run)}: {why}")
        self._ledger.refuse(leased.run.key, leased.lease, why)
        return self._study.point_of(leased.run) | {"status": "refused"}

    def _lost(self, leased: _Leased, why: str) -> dict[str, Any] | None:
        if self._folder_of is not None:
            shutil.rmtree(self._place(leased.run, leased.lease), ignore_errors=True)
        if self._ledger.lose(leased.run.key, leased.lease, why) == "queued":
            self._waiting.append(leased.run)
            return None
        if self._is_compared:
            raise UnfinishedStudyError(f"{self._told(leased.run)}: {why}, {1 + MOST_LOSSES} times.")
        return self._study.point_of(leased.run) | {"status": "lost"}

    def _give_back(self) -> None:
        """Queue what is leased again: nobody is going to wait for it."""
        for future, leased in self._running.items():
            future.cancel()
            with suppress(CosimError):  # what is said of the first error is more to the point
                self._ledger.give_back(leased.run.key, leased.lease)
        self._running.clear()

    def _place(self, run: PlannedRun, lease: int) -> Path:
        """Return the run folder until it is committed: each lease has its own."""
        assert self._folder_of is not None
        folder = self._folder_of(run)
        return folder.with_name(f"{UNCOMMITTED}{folder.name}-{lease}")

    def _told(self, run: PlannedRun) -> str:
        values = "".join(f", {name} {value}" for name, value in run.point.values.items())
        name = self._study.sources[run.source].scenario.name
        return f"{name}{values}, estimator {run.estimator}, seed {run.seed}"


def remove_uncommitted(folder: Path) -> None:
    """Remove the run folders that nobody has committed, in the folder of a study's runs."""
    for path in folder.glob(f"{UNCOMMITTED}*"):
        shutil.rmtree(path, ignore_errors=True)
