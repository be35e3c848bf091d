"""Comparison of estimators on the same plant, noise and seeds: a study of one scenario, and one table."""

from collections.abc import Sequence
from contextlib import nullcontext
from numbers import Integral
from pathlib import Path

from estimator import METHODS

from ..errors import ScenarioError
from ..retuning.estimators import check_estimator
from ..runs.lock import new_locked_folder
from ..scenarios.scenario import Scenario
from ..scenarios.trust import check_trust, with_own
from ..studies.conduct import conduct, enter, planned
from ..studies.definition import StudyDefinition, StudySettings
from ..studies.engines import jobs_here
from ..studies.folder import open_study
from ..studies.head import StudyError, StudyProgress
from ..studies.ledger import Ledger
from ..studies.plan import Study
from .comparison import Comparison


def compare(
    scenario: Scenario | Path | str,
    estimators: Sequence[str] | None = None,
    seeds: int | Sequence[int] = 10,
    jobs: int | None = None,
    out: Path | str | None = None,
    keep: bool = False,
    progress: StudyProgress | None = None,
    on: str | None = None,
    is_plain: bool = False,
) -> Comparison:
    """Run each of `none`, `true` and the estimators with each seed; a count of seeds means 0, 1, ..., seeds - 1.

    scenario: a Scenario, the name of one, or a TOML file. estimators: by default all that this scenario and the
    installed packages allow.

    Up to `jobs` runs (default: one per processor) are simulated at a time, each in a process of its own; their number
    affects wall times only. With `out`, an absent or empty folder, each run is in the ledger there as soon as it has
    ended, and the tables are written at the end; with `keep` each run has its folder there, too. Diverged and faulted
    runs count. A run whose process has died is made again. on: engine instead of processes here, as of `retune study
    --on`; is_plain: a Dask scheduler elsewhere may be talked to without TLS.
    Raises ValueError for seeds or jobs that make no sense, TypeError for a text in place of a list of estimators;
    CosimError for what `run` refuses.
    """
    out = None if out is None else Path(out)
    study = comparison_study(scenario, estimators, seeds, keep)
    if jobs is not None and jobs < 1:
        raise ValueError(f"jobs must be at least 1, got {jobs}.")
    if keep and out is None:
        raise ValueError("keep needs a folder: give out.")
    runs = planned(study)
    jobs = jobs_here(jobs, len(runs))
    with (
        new_locked_folder(study.definition.study.name, out) if out is not None else nullcontext(),
        open_study(out, study, "compare") as ledger,
    ):
        enter(study, runs, ledger)
        try:
            conduct(study, runs, ledger, out, "compare", jobs, on, is_plain, progress)
        except StudyError as e:
            n = sum(count for state, count in ledger.counts().items() if state not in ("queued", "leased"))
            if out is None or not n:
                raise
            raise type(e)(f"{e} {n} of {len(runs)} runs have ended; retune resume {out} goes on.") from e
        return compared(study, ledger, jobs, out)


def comparison_study(
    scenario: Scenario | Path | str, estimators: Sequence[str] | None, seeds: int | Sequence[int], keep: bool
) -> Study:
    """Return the study that a comparison is. Raises ValueError, TypeError, CosimError."""
    if isinstance(estimators, str):
        raise TypeError(f"estimators must be a list of names, got {estimators!r}.")
    scenario = with_own(scenario if isinstance(scenario, Scenario) else Scenario.load(scenario), *(estimators or ()))
    check_trust(scenario)
    names = tuple(dict.fromkeys(("none", "true", *(usable(scenario) if estimators is None else estimators))))
    for name in names:
        check_estimator(name, scenario)
    name = scenario.scenario.name
    settings = StudySettings(name=name, scenarios=(name,), estimators=names, seeds=_numbers(seeds), keep=keep)
    return Study(StudyDefinition(study=settings), (scenario,), (name,))


def compared(study: Study, ledger: Ledger, jobs: int, out: Path | None) -> Comparison:
    """Return the comparison of a study whose runs have all ended; write its tables. Raises FolderError."""
    settings = study.definition.study
    names, numbers = settings.estimators, settings.seed_numbers
    records = {(record["estimator"], record["seed"]): record for record in ledger.records()}
    ordered = tuple(records[name, seed] for name in names for seed in numbers)
    comparison = Comparison(study.sources[0], names, numbers, ordered, jobs, folder=out)
    if out is not None:
        comparison.write(out)
    return comparison


def usable(scenario: Scenario) -> list[str]:
    """Return the estimators of the package that this scenario and the installed packages allow."""

    def is_usable(name: str) -> bool:
        try:
            check_estimator(name, scenario)
        except ScenarioError:
            return False
        return True

    return [name for name in METHODS if is_usable(name)]


def _numbers(seeds: int | Sequence[int]) -> tuple[int, ...]:
    numbers = tuple(range(seeds)) if isinstance(seeds, int) else tuple(seeds)
    is_sound = all(isinstance(n, Integral) and 0 <= n < 2**63 for n in numbers)
    if not numbers or not is_sound or len(set(numbers)) < len(numbers):
        whole = "different whole numbers from 0 on, of 64 bits"
        raise ValueError(f"seeds must be a count from 1 on, or {whole}, got {seeds!r}.")
    return numbers
