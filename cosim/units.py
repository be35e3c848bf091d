"""Units as FMI and SSP define them: exponents of the SI base units, a factor and an offset.

FMI 2.0.4, sections 2.2.2 and 2.2.3; SSP 1.0, section 4.4: base value = factor * value + offset.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@dataclass(frozen=True)
class Linear:
    """A linear function, factor x + offset."""

    factor: float = 1.0
    offset: float = 0.0

    def __call__(self, x: float) -> float:
        """Return factor x + offset; for the identity x itself, bit for bit."""
        return x if self == IDENTITY else self.factor * x + self.offset

    def then(self, after: "Linear") -> "Linear":
        """Return the function after(self(x))."""
        return Linear(after.factor * self.factor, after.factor * self.offset + after.offset)


IDENTITY = Linear()


@dataclass(frozen=True)
class Unit:
    """A unit, and its definition where the file has one."""

    name: str
    """Name as written in the file."""
    exponents: tuple[int, ...] | None = None
    """Exponents of `BASE_UNITS`; None for a unit that is named but not defined."""
    factor: float = 1.0
    """Factor from this unit to the base unit."""
    offset: float = 0.0
    """Offset, in the base unit."""
    is_relative: bool = False
    """True for the unit of a difference, of temperatures say, which is converted without offsets."""

    @property
    def base(self) -> dict[str, int]:
        """Exponents other than zero, by base unit."""
        return {name: n for name, n in zip(BASE_UNITS, self.exponents or (), strict=False) if n}


def conversion(source: Unit | None, target: Unit | None) -> Linear:
    """Return the function that converts a number from one unit to another; the identity where either is None.

    The radian is dropped when dimensions are compared, as FMI allows. Raises ValueError for units of different
    dimensions, and where names differ and one is not defined.
    """
    if source is None or target is None:
        return IDENTITY
    if source.exponents is None or target.exponents is None:
        if source.name == target.name:
            return IDENTITY
        unknown = source if source.exponents is None else target
        raise ValueError(f"'{source.name}' cannot be converted to '{target.name}': '{unknown.name}' is not defined")
    if source.exponents[:-1] != target.exponents[:-1]:
        raise ValueError(f"'{source.name}' cannot be converted to '{target.name}': the dimensions differ")
    offset = 0.0 if source.is_relative or target.is_relative else source.offset - target.offset
    if source.factor == target.factor and not offset:
        return IDENTITY
    return Linear(source.factor / target.factor, offset / target.factor)


def defined_units(definitions: Iterable[Any]) -> dict[str, Unit]:
    """Return the units of FMPy's model description, by name."""
    return {u.name: make_unit(u.name, _attributes(u.baseUnit)) for u in definitions}


def make_unit(name: str, definition: Mapping[str, Any] | None) -> Unit:
    """Return a unit from the attributes of its BaseUnit element. Raises ValueError where one is not a number."""
    if definition is None:
        return Unit(name)
    factor, offset = float(definition.get("factor", 1.0)), float(definition.get("offset", 0.0))
    if factor == 0.0:
        raise ValueError(f"unit '{name}' has the factor 0")
    return Unit(name, tuple(int(definition.get(base, 0)) for base in BASE_UNITS), factor, offset)


def _attributes(base_unit: Any) -> Mapping[str, Any] | None:
    """Return exponents, factor and offset of FMPy's BaseUnit; None without one."""
    if base_unit is None:
        return None
    return {name: getattr(base_unit, name) for name in (*BASE_UNITS, "factor", "offset")}
