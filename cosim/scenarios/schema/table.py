"""Base class of a scenario file's tables, and the types that they share."""

import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Final, cast

from pydantic import AfterValidator, BaseModel, ConfigDict, GetPydanticSchema, model_validator

from ...former_names import tell_new_name
from ...variable_name import VariableName
from .toml_types import check_types

FUNCTION: Final = re.compile(r"[\w.]+:\w+")
"""A function of the user's, `module:function`."""
MOST = 1_000_000_000
"""Largest count, or waiting time [s]: more is a mistake, or more than a machine can hold."""


Value = float | int | bool | str


def _as_a_double(value: Value) -> Value:
    try:
        if isinstance(value, int):
            float(value)
    except OverflowError as e:
        raise ValueError("must be a number that a double can hold, got a larger one") from e
    return value


StartValue = Annotated[Value, AfterValidator(_as_a_double)]
"""A start value of a variable: a number that a double can hold, a truth value or a text."""
_REFERENCE = GetPydanticSchema(lambda _, handler: handler(Annotated[str, AfterValidator(VariableName)]))
Reference = Annotated[VariableName, _REFERENCE]
"""A variable of a component, such as `plant.der(phi_dot)`."""


class Table(BaseModel):
    """A table of a scenario file: frozen, unknown keys refused, numbers finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    former_keys: ClassVar[Mapping[str, str]] = {}
    """Keys that had another name, former = present, each with its table: `guard.foresight` = `guard.lookahead`."""

    @classmethod
    def known_keys(cls) -> set[str]:
        """Return the keys that it may have."""
        return set(cls.model_fields)

    @model_validator(mode="before")
    @classmethod
    def _take_former_keys(cls, table: Any) -> Any:
        if not isinstance(table, dict):
            return table
        given = dict(cast(dict[str, Any], table))
        for former, now in cls.former_keys.items():
            old, new = former.rpartition(".")[2], now.rpartition(".")[2]
            if old in given:
                if new in given:
                    raise ValueError(f"'{old}' is now '{new}': leave out '{old}'")
                given[new] = given.pop(old)
                tell_new_name(former, now)
        check_types({key: field.annotation for key, field in cls.model_fields.items()}, given)
        return given
