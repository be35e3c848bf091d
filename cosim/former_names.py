"""Names that users have written and that are others today: taken, with one line that gives the new one."""

import logging
from functools import cache
from typing import Final

LOG: Final = logging.getLogger(__name__)


@cache
def tell_new_name(former: str, now: str) -> None:
    """Log a warning, once a process, that what was called `former` is now called `now`."""
    LOG.warning("%s is now %s", former, now)
