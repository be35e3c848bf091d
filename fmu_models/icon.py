"""The models' icons: a few strokes each, drawn without any library, the same bytes every time."""

import zlib
from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from math import cos, hypot, pi, sin
from struct import pack
from typing import NamedTuple

SIZE = 96
"""Pixels of a side."""

_DARK, _BLUE, _ORANGE, _GREY = (38, 50, 56), (21, 101, 192), (239, 108, 0), (144, 164, 174)
Colour = tuple[int, int, int]
Point = tuple[float, float]


class Stroke(NamedTuple):
    """A line with round ends; a disc where both ends are one."""

    start: Point
    """x to the right, y down, from 0 to 1."""
    end: Point
    """The same."""
    width: float
    """Full width, in sides of the icon."""
    colour: Colour
    """Red, green, blue."""


@cache
def png(name: str) -> bytes:
    """The icon of the model of that name, SIZE x SIZE, with a transparent ground."""
    rows = _rasterized(_strokes(name))
    header = pack(">2I5B", SIZE, SIZE, 8, 6, 0, 0, 0)  # eight bits a channel; red, green, blue, alpha
    data = zlib.compress(b"".join(b"\0" + row for row in rows), 9)
    chunks = ((b"IHDR", header), (b"IDAT", data), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        pack(">I", len(body)) + kind + body + pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )


def _strokes(name: str) -> list[Stroke]:
    plant = _pendulum() if "Pendulum" in name else _quadrotor() if "Quadrotor" in name else _body()
    if name.endswith("Controller"):
        return [*_frame(), *_loop(), *_scaled(plant)]
    if name.endswith(("Reference", "Sine")):
        return [*_frame(), *_wave(), *_scaled(plant)]
    return [*_frame(), *plant]


def _path(points: Sequence[Point], width: float, colour: Colour) -> list[Stroke]:
    return [Stroke(a, b, width, colour) for a, b in pairwise(points)]


def _frame() -> list[Stroke]:
    return _path([(0.04, 0.04), (0.96, 0.04), (0.96, 0.96), (0.04, 0.96), (0.04, 0.04)], 0.02, _GREY)


def _pendulum() -> list[Stroke]:
    return [
        *_path([(0.25, 0.16), (0.75, 0.16)], 0.04, _DARK),
        *_path([(0.5, 0.16), (0.7, 0.72)], 0.04, _DARK),
        Stroke((0.7, 0.72), (0.7, 0.72), 0.26, _BLUE),
    ]


def _quadrotor() -> list[Stroke]:
    arms = [_path([(0.5, 0.5), (0.5 + dx, 0.5 + dy)], 0.05, _DARK) for dx in (-0.24, 0.24) for dy in (-0.24, 0.24)]
    rotors = [_circle((0.5 + dx, 0.5 + dy), 0.14, _BLUE) for dx in (-0.24, 0.24) for dy in (-0.24, 0.24)]
    return [stroke for part in (*arms, *rotors) for stroke in part] + [Stroke((0.5, 0.5), (0.5, 0.5), 0.16, _DARK)]


def _body() -> list[Stroke]:
    front, shift = [(0.18, 0.38), (0.6, 0.38), (0.6, 0.8), (0.18, 0.8), (0.18, 0.38)], 0.2
    back = [(0.18, 0.38), (0.18 + shift, 0.18), (0.6 + shift, 0.18), (0.6 + shift, 0.6), (0.6, 0.8)]
    edge = [(0.6, 0.38), (0.6 + shift, 0.18)]
    return [
        *_path(front, 0.04, _DARK), *_path(back, 0.04, _DARK), *_path(edge, 0.04, _DARK),
        Stroke((0.47, 0.52), (0.47, 0.52), 0.12, _BLUE),
    ]  # fmt: skip


def _loop() -> list[Stroke]:
    """An arrow that comes back to where it starts, lower left."""
    arc = _circle((0.32, 0.68), 0.18, _ORANGE, turns=0.8)
    x, y = arc[-1].end
    return [*arc, *_path([(x - 0.09, y - 0.02), (x, y), (x + 0.02, y - 0.1)], 0.045, _ORANGE)]


def _wave() -> list[Stroke]:
    points = [(0.12 + 0.5 * k / 24, 0.7 - 0.14 * sin(2.0 * pi * k / 24)) for k in range(25)]
    return [*_path(points, 0.05, _ORANGE), *_path([(0.12, 0.9), (0.12, 0.48)], 0.025, _DARK)]


def _circle(centre: Point, radius: float, colour: Colour, turns: float = 1.0) -> list[Stroke]:
    angles = [2.0 * pi * turns * k / 24 for k in range(25)]
    return _path([(centre[0] + radius * cos(a), centre[1] - radius * sin(a)) for a in angles], 0.045, colour)


def _scaled(strokes: Sequence[Stroke]) -> list[Stroke]:
    """The picture at half its size, upper right."""

    def move(p: Point) -> Point:
        return (0.47 + 0.5 * p[0], 0.03 + 0.5 * p[1])

    return [Stroke(move(s.start), move(s.end), 0.5 * s.width, s.colour) for s in strokes]


def _rasterized(strokes: Sequence[Stroke]) -> list[bytearray]:
    """Rows of pixels, four bytes each. An edge is one pixel soft."""
    rows = [bytearray(4 * SIZE) for _ in range(SIZE)]
    for s in strokes:
        reach = s.width / 2.0 + 1.0 / SIZE
        columns, lines = (_span(a, b, reach) for a, b in zip(s.start, s.end))
        for j in lines:
            for i in columns:
                coverage = 0.5 + SIZE * (s.width / 2.0 - _distance(((i + 0.5) / SIZE, (j + 0.5) / SIZE), s))
                if coverage > 0.0:
                    _blend(rows[j], 4 * i, s.colour, min(coverage, 1.0))
    return rows


def _span(a: float, b: float, reach: float) -> range:
    return range(max(0, int((min(a, b) - reach) * SIZE)), min(SIZE, int((max(a, b) + reach) * SIZE) + 1))


def _distance(p: Point, s: Stroke) -> float:
    dx, dy = s.end[0] - s.start[0], s.end[1] - s.start[1]
    x, y = p[0] - s.start[0], p[1] - s.start[1]
    along = min(max((x * dx + y * dy) / ((dx * dx + dy * dy) or 1.0), 0.0), 1.0)
    return hypot(x - along * dx, y - along * dy)


def _blend(row: bytearray, at: int, colour: Colour, alpha: float) -> None:
    """The colour over what is there. Porter and Duff (1984)."""
    below = row[at + 3] / 255.0 * (1.0 - alpha)
    total = alpha + below
    for c in range(3):
        row[at + c] = round((colour[c] * alpha + row[at + c] * below) / total)
    row[at + 3] = round(255.0 * total)
