"""Files that are somebody else's."""

import errno
from pathlib import Path


def readable(path: Path) -> Path:
    """The path, where opening it waits for nobody. Raises OSError for a pipe, a socket or a device."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    return path
