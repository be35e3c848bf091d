"""Signatures of manifests, by which a run of this user's is told from one that somebody else has made.

A manifest names Python modules and the folder where they are. Neither that place nor their hashes prove that the user
has ever run them: a stranger can write any. So a manifest is signed (HMAC-SHA256, RFC 2104) with a key that is in the
user's folder of state and nowhere else; where there can be none, nothing is signed or taken for the user's.
"""

import hmac
import os
import secrets
import stat
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Final

from platformdirs import user_state_path

_SIZE: Final = 32


def signature_of(seal: str) -> str:
    """Return the signature of a manifest's SHA-256, by this user's key; empty where there can be none."""
    key = _key()
    return "" if key is None else hmac.new(key, seal.encode(), "sha256").hexdigest()


def is_signed(seal: str, signature: str) -> bool:
    """Return whether a signature was made by this user."""
    return bool(signature) and hmac.compare_digest(signature_of(seal).encode(), signature.encode())


def _key() -> bytes | None:
    """Return the user's key, made where there is none; None where it cannot be kept, or others may know it."""
    path = user_state_path("fmu-retune") / "key"
    try:
        if not path.exists():
            _make(path)
        return _private_content(path)
    except OSError:
        return None


def _make(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    handle, name = tempfile.mkstemp(dir=path.parent)  # for this user alone
    try:
        with open(handle, "wb") as file:
            file.write(secrets.token_bytes(_SIZE))
        with suppress(FileExistsError):  # another process was faster
            os.link(name, path)
    finally:
        os.unlink(name)


def _private_content(path: Path) -> bytes | None:
    with open(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)), "rb") as file:
        status = os.fstat(file.fileno())
        is_private = sys.platform == "win32" or (status.st_uid == os.getuid() and not status.st_mode & 0o077)
        content = file.read(_SIZE + 1) if stat.S_ISREG(status.st_mode) and is_private else b""
    return content if len(content) == _SIZE else None
