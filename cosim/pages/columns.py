"""Columns of the pictures: shared by the curves of a run where they are whole, thinned where they are long."""

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource

from ..runs.result import Series
from .thinning import MOST_ROWS, kept_rows


class Columns:
    """Data sources of a page by name, so that a growing page can be given new ones."""

    def __init__(self) -> None:
        self.sources: dict[str, ColumnDataSource] = {}
        """Sources by name."""

    def curve(self, key: str, name: str, t: Series, *values: Series) -> tuple[ColumnDataSource, str, list[str]]:
        """Return source, column of the time and columns of the values (n,) of a curve.

        key: curves of one key have the same times t (n,).
        """
        if len(t) <= MOST_ROWS:
            source = self._source(key)
            source.data.setdefault("t", t)
        else:
            rows = kept_rows(*values)
            source, t, values = self._source(f"{key} {name}"), t[rows], tuple(y[rows] for y in values)
            source.data.update({"t": t})
        names = [f"{name} {i}" for i in range(len(values))]
        source.data.update(dict(zip(names, values, strict=True)))
        return source, "t", names

    def table(self, name: str, columns: Mapping[str, Sequence[Any] | Series]) -> ColumnDataSource:
        """Return the source of points with texts."""
        source = self._source(name)
        source.data.update(
            {key: values if isinstance(values, np.ndarray) else list(values) for key, values in columns.items()}
        )
        return source

    def to_json(self) -> dict[str, dict[str, Any]]:
        """Return the columns by the name of their source; numbers as base64 of little-endian doubles."""
        return {key: {str(name): _packed(c) for name, c in source.data.items()} for key, source in self.sources.items()}

    def _source(self, name: str) -> ColumnDataSource:
        return self.sources.setdefault(name, ColumnDataSource(name=name))


def _packed(column: Any) -> Any:
    if isinstance(column, np.ndarray):
        return {"f8": base64.b64encode(np.ascontiguousarray(column, dtype="<f8").tobytes()).decode()}
    return list(column)
