"""The TOML file of a study: scenarios, estimators, seeds and factors."""

from itertools import product
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import AfterValidator, Field, ValidationError, model_validator

from ..errors import ScenarioError, one_line
from ..scenarios.overrides import key_path
from ..scenarios.scenario import read_tables
from ..scenarios.schema.table import MOST, Table
from ..scenarios.validation import first_error
from .factor import Factor, Settings

SeedCount = Annotated[int, Field(ge=1, le=MOST)]
Seeds = SeedCount | tuple[Annotated[int, Field(ge=0, lt=2**63)], ...] | dict[str, SeedCount]


def _is_name(name: str) -> str:
    if not name or any(c in name for c in "/\\\0"):
        raise ValueError(f"must be a name without slashes, got '{name}'")
    return name


class StudySettings(Table):
    """The table `study`: what is run, and how factors are combined."""

    name: Annotated[str, AfterValidator(_is_name)]
    """Name of the study, and of its folder."""
    scenarios: tuple[str, ...] = Field(min_length=1)
    """Names of scenarios, or paths of TOML files and SSP packages, relative to this file."""
    estimators: tuple[str, ...] = Field(default=("none", "true", "target"), min_length=1)
    """Estimators that are run in each scenario, `none` (the nominal controller) among them to compare with."""
    seeds: Seeds = 1
    """Number of seeds, from 0 on, or the seeds themselves; or their number by estimator."""
    combine: Literal["crossed", "paired"] = "crossed"
    """Crossed: every value of a factor with every one of the others. Paired: the first with the first, and so on."""
    sampling: Literal["sobol", "latin-hypercube", "random"] = "sobol"
    """Points of the factors that have a distribution, drawn together."""
    samples: int = Field(default=64, ge=1, le=MOST)
    """Number of those points."""
    sampling_seed: int = Field(default=0, ge=0)
    """Seed of those points."""
    settings: Settings = {}
    """Settings of all runs, as `--set` takes them: `"scenario.stop_time" = 2.0`."""
    keep: bool = False
    """Keep a run folder for each run."""

    @model_validator(mode="after")
    def _differ(self) -> Self:
        for name, found in (("scenarios", self.scenarios), ("estimators", self.estimators), ("seeds", self.seeds)):
            if not isinstance(found, int) and (not found or len(set(found)) < len(found)):
                raise ValueError(f"{name} must be different ones, got {list(found)}")
        return self

    @property
    def seed_numbers(self) -> tuple[int, ...]:
        """The seeds themselves, of all estimators."""
        seeds = max(self.seeds.values()) if isinstance(self.seeds, dict) else self.seeds
        return tuple(range(seeds)) if isinstance(seeds, int) else seeds

    def estimators_at(self, seed: int) -> tuple[str, ...]:
        """Return the estimators that are run with a seed."""
        seeds = self.seeds
        return self.estimators if not isinstance(seeds, dict) else tuple(e for e in self.estimators if seed < seeds[e])


Factors = dict[Annotated[str, AfterValidator(_is_name)], Factor]


class ScenarioPart(Table):
    """Part of a study that holds for one scenario alone: the table `[scenarios.NAME]`."""

    estimators: tuple[str, ...] | None = Field(default=None, min_length=1)
    """Estimators of this scenario, in place of those of the study."""
    seeds: Seeds | None = None
    """Seeds of this scenario, in place of those of the study."""
    settings: Settings = {}
    """Settings of its runs, beside those of the study."""
    factors: Factors = {}
    """Factors of this scenario, in place of those of the study; choices are added to those of the study."""


class StudyDefinition(Table):
    """A study as its file has it."""

    study: StudySettings
    """What is run."""
    factors: Factors = {}
    """What is varied, by name."""
    scenarios: dict[str, ScenarioPart] = {}
    """What differs from scenario to scenario, by their names in `study.scenarios`."""

    @property
    def factor_names(self) -> tuple[str, ...]:
        """Names of the factors of all scenarios."""
        parts = self.scenarios.values()
        return tuple(dict.fromkeys([*self.factors, *(name for part in parts for name in part.factors)]))

    @property
    def estimators(self) -> tuple[str, ...]:
        """Estimators of all scenarios."""
        parts = [self.at(name).study.estimators for name in self.study.scenarios]
        return tuple(dict.fromkeys(name for part in parts for name in part))

    @property
    def seed_numbers(self) -> tuple[int, ...]:
        """Seeds of all scenarios."""
        parts = [self.at(name).study.seed_numbers for name in self.study.scenarios]
        return tuple(dict.fromkeys(seed for part in parts for seed in part))

    def at(self, scenario: str) -> "StudyDefinition":
        """Return the study as it is for one scenario."""
        part = self.scenarios.get(scenario)
        if part is None:
            return self if not self.scenarios else self.model_copy(update={"scenarios": {}})
        given = {"estimators": part.estimators, "seeds": part.seeds, "settings": self.study.settings | part.settings}
        study = self.study.model_copy(update={key: value for key, value in given.items() if value is not None})
        factors = {name: _joined(self.factors.get(name), factor) for name, factor in part.factors.items()}
        return self.model_copy(update={"study": study, "factors": self.factors | factors, "scenarios": {}})

    @model_validator(mode="after")
    def _parts_fit(self) -> Self:
        for name in self.scenarios:
            if name not in self.study.scenarios:
                known = ", ".join(self.study.scenarios)
                raise ValueError(f"scenarios: '{name}' is none of the study's scenarios, which are {known}")
        for name in self.study.scenarios:
            study = self.at(name).study
            if isinstance(study.seeds, dict) and not set(study.estimators) <= set(study.seeds) <= set(self.estimators):
                wanted = ", ".join(study.estimators)
                raise ValueError(f"seeds of {name} must be those of {wanted}, got those of {', '.join(study.seeds)}")
        return self

    @model_validator(mode="after")
    def _factors_differ(self) -> Self:
        for scenario in self.study.scenarios:
            setters: dict[tuple[str, ...], tuple[str, str]] = {}
            for name, factor in self.at(scenario).factors.items():
                own = {_path_of(key): (name, key) for key in sorted(factor.keys)}
                for path, other in product(own, setters):
                    if path[: len(other)] == other[: len(path)]:
                        raise ValueError(f"factors: {_both(setters[other], own[path], path == other)}")
                setters |= own
        return self

    @model_validator(mode="after")
    def _factors_fit(self) -> Self:
        for name in (n for n in self.factor_names if n in RESERVED or n.startswith(("mse ", "error "))):
            raise ValueError(f"factors: '{name}' is a column of the table already: give it another name")
        factors = [*self.factors.values(), *(f for part in self.scenarios.values() for f in part.factors.values())]
        n, is_drawn = self.study.samples, any(f.distribution for f in factors)
        if is_drawn and self.study.sampling == "sobol" and n & (n - 1):
            raise ValueError(f"study: samples must be a power of two for sobol, such as {1 << n.bit_length()}, got {n}")
        return self


def _path_of(key: str) -> tuple[str, ...]:
    """Return the names of a key; one that is not valid, which its scenario tells, is a name itself."""
    try:
        return tuple(key_path(key))
    except ScenarioError:
        return (key,)


def _both(one: tuple[str, str], other: tuple[str, str], is_same: bool) -> str:
    """Return that two factors, each with its key, set the same, or one of them a table that holds the other's key."""
    (name, key), (second, its) = one, other
    if is_same:
        return f"'{name}' and '{second}' both set {its}: make them one"
    return f"'{name}' sets {key} and '{second}' sets {its}, one in the other: set the table's entries one by one"


def _joined(factor: Factor | None, own: Factor) -> Factor:
    """Return a scenario's own factor, with the choices of the study's."""
    if factor is None or factor.choices is None or own.choices is None:
        return own
    return own.model_copy(update={"choices": factor.choices | own.choices})


RESERVED: Final = frozenset(
    (
        "scenario", "point", "estimator", "seed", "status", "error", "end [s]", "mse", "largest error", "evaluations",
        "triggers", "first write [s]", "writes", "vetoes", "reverts", "disturbances", "unexplained", "rests",
        "latency p50 [ms]", "latency p99 [ms]", "latency max [ms]", "missed deadlines", "wall time [s]", "run", "key",
    )
)  # fmt: skip
"""Columns of the table of results, beside `mse OUTPUT` and `error PARAMETER`: no factor can be named after one."""


def read_definition(path: Path) -> StudyDefinition:
    """Read the file of a study. Raises ScenarioError, one line with file, key and rule."""
    return checked_definition(read_tables(path), str(path))


def checked_definition(tables: Any, label: str) -> StudyDefinition:
    """Return the study of a file's tables; label: names it in messages. Raises ScenarioError."""
    try:
        return StudyDefinition.model_validate(tables)
    except ValidationError as e:
        raise ScenarioError(f"{label}: {one_line(first_error(e, StudyDefinition))}") from e
