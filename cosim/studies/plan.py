"""The runs of a study, each with the key that its result is kept under."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import ScenarioError
from ..files import sha256
from ..retuning.estimators import check_estimator
from ..scenarios.scenario import Scenario
from ..scenarios.trust import check_trust, with_own
from ..system.fmu_cache import component_path
from .definition import StudyDefinition
from .design import StudyPoint, points
from .parcels import files_of, is_built, own_modules, own_references, packed
from .recipe import Parcel
from .versions import all_versions


@dataclass(frozen=True)
class PlannedRun:
    """A run of a study."""

    key: str
    """SHA-256 of scenario, settings, seed, estimator, contents of FMUs and modules, and versions."""
    place: int
    """Number of scenario and point together."""
    source: int
    """Number of its scenario in the study."""
    point: StudyPoint
    """Values of the factors, and settings."""
    estimator: str
    """Name of the estimator."""
    seed: int
    """Seed of noise and search."""


@dataclass(frozen=True)
class Study:
    """A study: its definition, and its scenarios as they were read."""

    definition: StudyDefinition
    """Scenarios' names, estimators, seeds, factors."""
    sources: tuple[Scenario, ...]
    """Scenarios, before the settings of a point."""
    labels: tuple[str, ...]
    """Name, or file, of each scenario, as a command takes it."""
    contents: dict[Path, str] = field(default_factory=dict[Path, str], compare=False)
    """SHA-256 of files that were looked at."""
    modules_known: dict[tuple[Path | str, ...], dict[str, str]] = field(
        default_factory=dict[tuple[Path | str, ...], dict[str, str]], compare=False
    )
    """SHA-256 of the user's modules, by folder and references."""
    digests_known: dict[tuple[object, ...], list[str]] = field(
        default_factory=dict[tuple[object, ...], list[str]], compare=False
    )
    """SHA-256 of FMUs and tables, by folder and names."""

    def runs(self) -> Iterator[PlannedRun]:
        """Yield the runs in the order of the table: by scenario, point and seed, the estimators next to each other.

        Raises ScenarioError, with the point, for one that cannot be run.
        """
        our_versions = all_versions()
        for place, (k, point) in enumerate(self.places()):
            study = self.definition_of(k).study
            scenario = self.scenario_at(k, point)
            digests = self._digests(scenario)
            estimated = {name: self._checked(k, point, scenario, name) for name in study.estimators}
            dump = scenario.model_dump(mode="json")
            for seed in study.seed_numbers:
                for name in study.estimators_at(seed):
                    own = sorted(estimated[name].values())
                    key = _digest([dump, digests, own, name, seed, our_versions])
                    yield PlannedRun(key, place, k, point, name, seed)

    def places(self) -> Iterator[tuple[int, StudyPoint]]:
        """Yield the number of a scenario and a point, in the order of the table. Raises ScenarioError."""
        for k in range(len(self.sources)):
            for point in points(self.definition_of(k)):
                yield k, point

    def definition_of(self, source: int) -> StudyDefinition:
        """Return the definition as it is for one scenario."""
        return self.definition.at(self.definition.study.scenarios[source])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the scenarios in the table; where two are called the same, their files."""
        names = tuple(scenario.scenario.name for scenario in self.sources)
        return names if len(set(names)) == len(names) else self.labels

    def scenario_at(self, source: int, point: StudyPoint) -> Scenario:
        """Return a scenario with the settings of a point. Raises ScenarioError."""
        scenario = self.sources[source]
        if not point.settings:
            return scenario
        tables = scenario.model_dump(mode="json")
        label = Path(f"{self.labels[source]}{_told(point.values)}")
        origin = with_own(scenario, *self.definition_of(source).study.estimators).origin
        return Scenario.from_tables(tables, point.settings, scenario.folder, label, origin)

    def point_of(self, run: PlannedRun) -> dict[str, Any]:
        """Return what a run is: scenario, estimator, seed, and the values of the factors."""
        what = {"scenario": self.names[run.source], "point": run.place, "seed": run.seed, "estimator": run.estimator}
        return what | run.point.values

    def told(self, run: PlannedRun) -> str:
        """Return the scenario and the values of a run, for a message."""
        return f"{self.labels[run.source]}{_told(run.point.values)}"

    def packed(self, scenario: Scenario, estimator: str) -> tuple[Scenario, Parcel, dict[str, Path]]:
        """Return a scenario as it travels, its parcel, and the files in it by their paths there."""
        digests = {path: self.digest(path) for path in files_of(scenario)}
        return packed(scenario, self.modules(scenario, estimator), digests)

    def digest(self, path: Path) -> str:
        """Return the SHA-256 of a file, which is read once; of a built-in FMU its guid, which no build changes."""
        if is_built(path):
            return path.parent.name
        if path not in self.contents:
            self.contents[path] = sha256(path)
        return self.contents[path]

    def modules(self, scenario: Scenario, estimator: str) -> dict[str, str]:
        """Return the SHA-256, by file, of the modules of the user's that a run loads. Raises ScenarioError."""
        references = own_references(scenario, estimator)
        known = (scenario.folder, *references.values())
        if known not in self.modules_known:
            self.modules_known[known] = own_modules(scenario, references)
        return self.modules_known[known]

    def _digests(self, scenario: Scenario) -> list[str]:
        """Return the SHA-256 of all FMUs and tables of a scenario. Raises ScenarioError."""
        components, estimation = scenario.components.values(), scenario.estimation
        named = (
            scenario.folder,
            estimation.model,
            estimation.rollout.fmu,
            *((c.fmu, c.fmi, c.table) for c in components),
        )
        if named not in self.digests_known:
            paths = [component_path(c, scenario.folder) for c in components]
            self.digests_known[named] = [self.digest(path) for path in [*paths, *files_of(scenario)]]
        return self.digests_known[named]

    def _checked(self, source: int, point: StudyPoint, scenario: Scenario, estimator: str) -> dict[str, str]:
        """Return the modules of the user's that a run loads. Raises ScenarioError for what cannot be run."""
        try:
            check_trust(scenario)
            check_estimator(estimator, scenario)
            return self.modules(scenario, estimator)
        except ScenarioError as e:
            raise ScenarioError(f"{self.labels[source]}{_told(point.values)}: {e}") from e


def _told(values: Mapping[str, Any]) -> str:
    """Return the values of a point, for a message."""
    return f" ({', '.join(f'{name} {value}' for name, value in values.items())})" if values else ""


def _digest(content: object) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
