"""The TOML file of a study: scenarios, estimators, seeds and factors."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self, cast

from pydantic import AfterValidator, Field, ValidationError, model_validator

from ..errors import ScenarioError, one_line
from ..scenarios.scenario import read_tables
from ..scenarios.schema.table import MOST, Table
from ..scenarios.validation import first_error

Number = float | int
Span = tuple[Number, Number]
SeedCount = Annotated[int, Field(ge=1, le=MOST)]
DISTRIBUTIONS: Final = ("uniform", "log_uniform", "normal")


class Factor(Table):
    """A quantity that is varied from run to run: one or several settings, by a list, grid, range or distribution."""

    setting: str | dict[str, str] | None = Field(default=None, alias="set", min_length=1)
    """Key that `--set` takes; or several, each with its text, in which `{}` stands for the value. None for choices."""
    to: str = Field(default="{}", pattern=r"\{\}")
    """Text of the setting, in which `{}` stands for the value: `[[0.0, 1.75], [0.5, {}]]`."""
    values: tuple[Any, ...] | None = Field(default=None, alias="list", min_length=1)
    """The values themselves."""
    choices: dict[str, dict[str, Any]] | None = Field(default=None, min_length=1)
    """Settings by name, instead of values: `gust = { 'changes."plant.F_d"' = "5*sin(t)" }`."""
    grid: tuple[Number, Number, int] | None = None
    """First value, last value, and the number of values at equal distances."""
    span: tuple[Number, Number, Number] | None = Field(default=None, alias="range")
    """First value, last value, and the distance from one to the next."""
    uniform: Span | None = None
    """Least and largest value, all equally likely."""
    log_uniform: Span | None = Field(default=None, alias="log-uniform")
    """Least and largest value, whose logarithm is uniform."""
    normal: Span | None = None
    """Mean and standard deviation."""

    @classmethod
    def known_keys(cls) -> set[str]:
        """Return the keys that it may have."""
        return {field.alias or name for name, field in cls.model_fields.items()}

    @property
    def distribution(self) -> str | None:
        """Name of its distribution; None where its values are given."""
        return next((name for name in DISTRIBUTIONS if getattr(self, name) is not None), None)

    def settings_of(self, value: Any) -> dict[str, str]:
        """Return the settings, as for `--set`, of a value."""
        if self.choices is not None:
            return {key: toml_text(chosen) for key, chosen in self.choices[value].items()}
        forms = self.setting if isinstance(self.setting, dict) else {str(self.setting): self.to}
        return {key: form.replace("{}", toml_text(value)) for key, form in forms.items()}

    @model_validator(mode="after")
    def _has_values(self) -> Self:
        kinds = {"list": self.values, "choices": self.choices, "grid": self.grid, "range": self.span,
                 "uniform": self.uniform, "log-uniform": self.log_uniform, "normal": self.normal}  # fmt: skip
        given = [name for name, value in kinds.items() if value is not None]
        if len(given) != 1:
            raise ValueError(f"must have one of {', '.join(kinds)}, got {' and '.join(given) or 'none'}")
        if (self.setting is None) != (self.choices is not None):
            raise ValueError("must have 'set', and choices, which have their keys, none")
        if isinstance(self.setting, dict) and any("{}" not in form for form in self.setting.values()):
            raise ValueError("set: each text must have {} where the value stands")
        if (self.grid and self.grid[2] < 1) or (self.span and not self._reaches_its_end()):
            raise ValueError(f"{given[0]} has no values, got {list(self.grid or self.span or ())}")
        for name, bounds, least in (("uniform", self.uniform, -math.inf), ("log-uniform", self.log_uniform, 0.0)):
            if bounds is not None and not least < bounds[0] < bounds[1]:
                above = "0 < " if least == 0.0 else ""
                raise ValueError(f"{name} must have {above}lower < upper, got {list(bounds)}")
        if self.normal and self.normal[1] <= 0.0:
            raise ValueError(f"normal must have a standard deviation above 0, got {self.normal[1]:g}")
        return self

    def _reaches_its_end(self) -> bool:
        first, last, step = self.span or (0, 0, 0)
        return step != 0 and (last - first) / step >= 0 and (last - first) / step < 1e6


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
    seeds: SeedCount | tuple[Annotated[int, Field(ge=0)], ...] | dict[str, SeedCount] = 1
    """Number of seeds, from 0 on, or the seeds themselves; or their number by estimator."""
    combine: Literal["crossed", "paired"] = "crossed"
    """Crossed: every value of a factor with every one of the others. Paired: the first with the first, and so on."""
    sampling: Literal["sobol", "latin-hypercube", "random"] = "sobol"
    """Points of the factors that have a distribution, drawn together."""
    samples: int = Field(default=64, ge=1, le=MOST)
    """Number of those points."""
    sampling_seed: int = Field(default=0, ge=0)
    """Seed of those points."""
    settings: dict[str, Any] = {}
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
    """What holds for one scenario of a study alone: that of `[scenarios.NAME]`."""

    estimators: tuple[str, ...] | None = Field(default=None, min_length=1)
    """Estimators of this scenario, in place of those of the study."""
    settings: dict[str, Any] = {}
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

    def at(self, scenario: str) -> "StudyDefinition":
        """Return the study as it is for one scenario."""
        part = self.scenarios.get(scenario)
        if part is None:
            return self if not self.scenarios else self.model_copy(update={"scenarios": {}})
        settings, estimators = self.study.settings | part.settings, part.estimators or self.study.estimators
        study = self.study.model_copy(update={"settings": settings, "estimators": estimators})
        factors = {name: _joined(self.factors.get(name), factor) for name, factor in part.factors.items()}
        return self.model_copy(update={"study": study, "factors": self.factors | factors, "scenarios": {}})

    @model_validator(mode="after")
    def _parts_fit(self) -> Self:
        for name in self.scenarios:
            if name not in self.study.scenarios:
                known = ", ".join(self.study.scenarios)
                raise ValueError(f"scenarios: '{name}' is none of the study's scenarios, which are {known}")
        seeds, estimators = self.study.seeds, self.estimators
        if isinstance(seeds, dict) and set(seeds) != set(estimators):
            raise ValueError(f"study: seeds must be of {', '.join(estimators)}, got those of {', '.join(seeds)}")
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


def toml_text(value: Any) -> str:
    """Return a value in TOML, in one line."""
    if isinstance(value, Mapping):
        items = cast(Mapping[str, Any], value).items()
        return "{" + ", ".join(f"{json.dumps(k)} = {toml_text(v)}" for k, v in items) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_text, cast(Sequence[Any], value))) + "]"
    return json.dumps(value, ensure_ascii=False, default=str)
