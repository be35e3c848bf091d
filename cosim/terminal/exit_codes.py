"""Exit codes of the commands."""

from typing import Final

DONE: Final = 0
UNFINISHED: Final = 1
"""The run faulted, or what it was to write could not be written."""
REFUSED: Final = 2
"""The input was refused."""
INTERRUPTED: Final = 130
