"""Former names in users' files: accepted, with a one-line warning that gives the new name."""

import logging
from functools import cache
from typing import Final

LOG: Final = logging.getLogger(__name__)


@cache
def tell_new_name(former: str, now: str) -> None:
    """Log a warning, once per process, that the name `former` is now `now`."""
    LOG.warning("%s is now %s", former, now)
