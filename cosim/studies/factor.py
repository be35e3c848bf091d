"""A factor of a study: a quantity that is varied from run to run."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, Final, Self, cast

from pydantic import AfterValidator, Field, model_validator

from ..scenarios.schema.table import Table

Number = float | int
Span = tuple[Number, Number]
_MOST_VALUES: Final = 1_000_000
"""Largest number of values of a grid or a range."""
DISTRIBUTIONS: Final = ("uniform", "log_uniform", "normal")


def _finite(value: Any) -> Any:
    """Return a value without infinite numbers and NaN, which no setting has. Raises ValueError for one with them."""
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"must have finite numbers, got {value}")
    parts = value.values() if isinstance(value, Mapping) else value if isinstance(value, list | tuple) else ()
    for part in cast(Iterable[Any], parts):
        _finite(part)
    return value


Settings = Annotated[dict[str, Any], AfterValidator(_finite)]
"""Settings, as `--set` takes them."""


class Factor(Table):
    """A quantity that is varied from run to run: one or several settings, by a list, grid, range or distribution."""

    setting: str | dict[str, str] | None = Field(default=None, alias="set", min_length=1)
    """Key that `--set` takes; or several, each with its text, in which `{}` stands for the value. None for choices."""
    to: str = Field(default="{}", pattern=r"\{\}")
    """Text of the setting, in which `{}` stands for the value: `[[0.0, 1.75], [0.5, {}]]`."""
    values: Annotated[tuple[Any, ...], AfterValidator(_finite)] | None = Field(default=None, alias="list", min_length=1)
    """The values themselves."""
    choices: dict[str, Settings] | None = Field(default=None, min_length=1)
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
        n = self.n_given
        if not 0 < n <= _MOST_VALUES:
            found = "no values" if n <= 0 else f"{n:.3g} values, at most {_MOST_VALUES:g} are made"
            raise ValueError(f"{given[0]} has {found}, got {list(self.grid or self.span or ())}")
        for name, bounds, least in (("uniform", self.uniform, -math.inf), ("log-uniform", self.log_uniform, 0.0)):
            if bounds is not None and not least < bounds[0] < bounds[1]:
                above = "0 < " if least == 0.0 else ""
                raise ValueError(f"{name} must have {above}lower < upper, got {list(bounds)}")
        if self.normal and self.normal[1] <= 0.0:
            raise ValueError(f"normal must have a standard deviation above 0, got {self.normal[1]:g}")
        return self

    @property
    def n_given(self) -> float:
        """Number of values of a grid or a range, perhaps infinite; 1 for any other factor."""
        if self.grid is not None:
            return self.grid[2]
        if self.span is None:
            return 1
        first, last, step = self.span
        steps = (last - first) / step * (1 + 1e-12) + 1e-9 if step != 0 else -1.0
        return math.floor(steps) + 1 if math.isfinite(steps) else steps

    @property
    def keys(self) -> set[str]:
        """Keys that it sets."""
        if self.choices is not None:
            return {key for chosen in self.choices.values() for key in chosen}
        return set(self.setting) if isinstance(self.setting, dict) else {str(self.setting)}


def toml_text(value: Any) -> str:
    """Return a value in TOML, in one line."""
    if isinstance(value, Mapping):
        items = cast(Mapping[str, Any], value).items()
        return "{" + ", ".join(f"{json.dumps(k)} = {toml_text(v)}" for k, v in items) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml_text, cast(Sequence[Any], value))) + "]"
    return json.dumps(value, ensure_ascii=False, default=str)
