"""Names of variables in a co-simulation."""

from typing import Self


class VariableName(str):
    """A variable of a component, `COMPONENT.VARIABLE`, such as `plant.der(phi_dot)`; equal to its text."""

    __slots__ = ()

    def __new__(cls, text: str) -> Self:
        """Raise ValueError where the component or the variable is missing."""
        if not all(text.partition(".")[::2]):
            raise ValueError(f"'{text}' must be COMPONENT.VARIABLE")
        return super().__new__(cls, text)

    @property
    def parts(self) -> tuple[str, str]:
        """Component, which has no dot, and variable, which may have dots."""
        component, _, variable = self.partition(".")
        return component, variable

    @property
    def component(self) -> str:
        """Instance name of the component."""
        return self.parts[0]

    @property
    def variable(self) -> str:
        """Name of the variable in the component's FMU."""
        return self.parts[1]
