"""Units as people write them in the header of a log or a table: `deg`, `km/h`, `kg.m2`, `kN`, `1/s`."""

import re
from math import pi
from typing import Final

from .units import BASE_UNITS, Unit

_PREFIXES: Final = {"G": 1e9, "M": 1e6, "k": 1e3, "h": 1e2, "d": 1e-1, "c": 1e-2, "m": 1e-3, "u": 1e-6, "µ": 1e-6,
                    "μ": 1e-6, "n": 1e-9}  # fmt: skip


def _si(factor: float = 1.0, offset: float = 0.0, **exponents: int) -> tuple[tuple[int, ...], float, float]:
    return tuple(exponents.get(base, 0) for base in BASE_UNITS), factor, offset


_PREFIXED: Final = {
    "m": _si(m=1), "g": _si(1e-3, kg=1), "s": _si(s=1), "A": _si(A=1), "K": _si(K=1), "mol": _si(mol=1),
    "cd": _si(cd=1), "rad": _si(rad=1), "N": _si(kg=1, m=1, s=-2), "Pa": _si(kg=1, m=-1, s=-2),
    "bar": _si(1e5, kg=1, m=-1, s=-2), "J": _si(kg=1, m=2, s=-2), "W": _si(kg=1, m=2, s=-3), "C": _si(A=1, s=1),
    "V": _si(kg=1, m=2, s=-3, A=-1), "F": _si(kg=-1, m=-2, s=4, A=2), "Ohm": _si(kg=1, m=2, s=-3, A=-2),
    "H": _si(kg=1, m=2, s=-2, A=-2), "T": _si(kg=1, s=-2, A=-1), "Wb": _si(kg=1, m=2, s=-2, A=-1),
    "l": _si(1e-3, m=3), "L": _si(1e-3, m=3), "Wh": _si(3600.0, kg=1, m=2, s=-2), "Nm": _si(kg=1, m=2, s=-2),
}  # fmt: skip
_OTHERS: Final = {
    "1": _si(), "%": _si(0.01), "deg": _si(pi / 180.0, rad=1), "°": _si(pi / 180.0, rad=1),
    "rev": _si(2.0 * pi, rad=1), "rpm": _si(pi / 30.0, rad=1, s=-1), "min": _si(60.0, s=1), "h": _si(3600.0, s=1),
    "d": _si(86400.0, s=1), "t": _si(1000.0, kg=1), "degC": _si(1.0, 273.15, K=1), "°C": _si(1.0, 273.15, K=1),
    "degF": _si(5.0 / 9.0, 273.15 - 160.0 / 9.0, K=1),
}  # fmt: skip
_FACTOR: Final = re.compile(r"(1|%|°C|[^\W\d_]+|°)\^?(-?\d+)?")


def understood(text: str) -> Unit:
    """Return the unit that text names; without a definition where it is not understood.

    Factors are joined by `.`, `*` or a space, and those after a `/` divide; an offset counts for a unit alone. Not Hz:
    FMI drops the radian, and with it whether a cycle or a radian is meant.
    """
    exponents, factor, offset = [0] * len(BASE_UNITS), 1.0, 0.0
    parts = text.strip().split("/")
    atoms = [(atom, -1 if i else 1) for i, part in enumerate(parts) for atom in re.split(r"[.*·\s]+", part.strip())]
    for atom, sign in atoms:
        match = _FACTOR.fullmatch(atom.strip("()"))
        definition = _definition(match[1]) if match else None
        if match is None or definition is None:
            return Unit(text)
        power = sign * int(match[2] or 1)
        exponents = [total + power * n for total, n in zip(exponents, definition[0], strict=True)]
        factor *= definition[1] ** power
        offset = definition[2] if len(atoms) == 1 and power == 1 else 0.0
    return Unit(text, tuple(exponents), factor, offset)


def _definition(name: str) -> tuple[tuple[int, ...], float, float] | None:
    if name in _OTHERS or name in _PREFIXED:
        return _OTHERS.get(name) or _PREFIXED[name]
    scale, rest = _PREFIXES.get(name[:1]), _PREFIXED.get(name[1:])
    return (rest[0], rest[1] * scale, 0.0) if scale and rest else None
