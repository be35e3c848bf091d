"""What every table of a scenario file has in common."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict

MOST = 1_000_000_000
"""Of whatever is counted, or waited for [s]: more is a slip, and what a machine cannot hold."""


Value = float | int | bool | str


def _is_reference(name: str) -> str:
    component, _, variable = name.partition(".")
    if not component or not variable:
        raise ValueError(f"'{name}' must be COMPONENT.VARIABLE")
    return name


Reference = Annotated[str, AfterValidator(_is_reference)]
"""A variable of a component, such as `plant.der(phi_dot)`."""


class Table(BaseModel):
    """A table of a scenario file: frozen, unknown keys refused, numbers finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @classmethod
    def known_keys(cls) -> set[str]:
        """What may stand in it."""
        return set(cls.model_fields)
