"""Size of the set points in a reference's table, by which limits of the tracking error are judged."""

from ..errors import CosimError
from ..fmi.component import Component
from ..fmi.table import is_table, read_table


def size_of(reference: Component, column: str) -> float | None:
    """Return the range of a table's column, or its magnitude where it is constant; None where that is 0 or unknown."""
    if not is_table(reference.fmu):
        return None
    try:
        table = read_table(reference.fmu)
    except CosimError:
        return None
    if column not in table.units:
        return None
    place = list(table.units).index(column)
    values = [row[place] for row in table.rows]
    return (max(values) - min(values)) or max(map(abs, values)) or None
