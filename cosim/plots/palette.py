"""Colours and line styles of all pictures: told apart by every kind of colour vision, and in print."""

from typing import Final, NamedTuple

# Okabe and Ito (2008).
BLACK: Final = "#000000"
GREY: Final = "#8c8c8c"
ORANGE: Final = "#E69F00"
SKY: Final = "#56B4E9"
GREEN: Final = "#009E73"
YELLOW: Final = "#F0E442"
BLUE: Final = "#0072B2"
VERMILION: Final = "#D55E00"
PURPLE: Final = "#CC79A7"


class Dashed(NamedTuple):
    """Colour of a curve with its dashes, which tell it from others where colours do not."""

    colour: str
    dashes: tuple[int, ...] = ()
    """Lengths of dash and gap in line widths; none for a solid line."""


RUNS: Final = (
    Dashed(BLUE), Dashed(ORANGE, (6, 2)), Dashed(PURPLE, (2, 1)), Dashed(SKY, (6, 2, 1, 2)), Dashed(BLACK, (1, 1)),
    Dashed(YELLOW, (8, 1)), Dashed(GREY, (4, 4)), Dashed(VERMILION, (3, 1, 1, 1)),
)  # fmt: skip
"""Of several runs that are laid over one another."""
BASELINES: Final = {
    "none": ("nominal", Dashed(VERMILION, (5, 1))),
    "true": ("true parameters", Dashed(GREEN, (1, 1))),
}
"""Text and style of the runs that a run is compared with, by estimator."""
