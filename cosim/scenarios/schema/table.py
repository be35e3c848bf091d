"""What every table of a scenario file has in common."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, GetPydanticSchema
from pydantic_core import core_schema

from ...variable_name import VariableName

MOST = 1_000_000_000
"""Of whatever is counted, or waited for [s]: more is a slip, and what a machine cannot hold."""


Value = float | int | bool | str


_REFERENCE = GetPydanticSchema(
    lambda _, handler: core_schema.no_info_after_validator_function(VariableName, handler(str))
)
Reference = Annotated[VariableName, _REFERENCE]
"""A variable of a component, such as `plant.der(phi_dot)`."""


class Table(BaseModel):
    """A table of a scenario file: frozen, unknown keys refused, numbers finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @classmethod
    def known_keys(cls) -> set[str]:
        """What may stand in it."""
        return set(cls.model_fields)
