"""Run folders that a growing page shows: whether they have changed, and what is new in them."""

import hashlib
import threading
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import Any, Final, Protocol

from ..plots.palette import BASELINES
from ..runs.lock import is_locked
from ..runs.run_files import EVENTS, MANIFEST, RESULT, SERIES
from ..studies.ledger import LEDGER
from .list_page import ListedRun, list_html, list_news, listed
from .runs_page import PageOfRuns, read_page
from .study_page import study_html, study_news

_SHORTEST_MS: Final = 1000
"""Shortest time between two looks of a page [ms]."""
_PAUSE: Final = 4.0
"""Ratio of the pause after a look to the time that it took: the run is to have the processor."""


class GrowingPage(Protocol):
    """A page that grows: as it is, and what is new in it."""

    def html(self) -> str: ...
    def news(self, since: str) -> dict[str, Any]: ...


class WatchedRuns:
    """Runs laid over one another on a page that grows with them."""

    def __init__(self, folders: Sequence[Path]) -> None:
        self._folders, self._lock = folders, threading.Lock()
        self._is_final = False

    def html(self) -> str:
        """Return the page. Raises FolderError where a run cannot be read."""
        with self._lock:
            version, page = self._version(), self._page()
            return page.html(is_live=True, version=version)

    def news(self, since: str) -> dict[str, Any]:
        """Return what is new since a version, as JSON values. Raises FolderError."""
        with self._lock:
            begun, version = perf_counter(), self._version()
            found = {} if version == since else self._page().news()
            wait_ms = max(_SHORTEST_MS, round(_PAUSE * 1e3 * (perf_counter() - begun)))
            state = _ENDED if self._is_final else _GROWS if self._is_busy() else _WAITS
            return found | {"version": version, "wait_ms": wait_ms, "is_final": self._is_final, "state": state}

    def _page(self) -> PageOfRuns:
        is_busy, page = self._is_busy(), read_page(self._folders)
        self._is_final = page.is_final and not is_busy
        return page

    def _is_busy(self) -> bool:
        return any(map(is_locked, self._folders))

    def _version(self) -> str:
        places = [folder / name for folder in self._folders for name in ("", *BASELINES)]
        states = [_state(place / name) for place in places for name in (MANIFEST, SERIES, EVENTS, RESULT)]
        return hashlib.sha256(repr((self._is_busy(), states)).encode()).hexdigest()[:16]


_GROWS: Final = "The page grows with the run."
_WAITS: Final = "The run was stopped: the page goes on when the run is resumed."
_ENDED: Final = "The run has ended: the page is complete."


class WatchedList:
    """Many runs on a page whose table grows with them."""

    def __init__(self, title: str, folders: Sequence[Path]) -> None:
        self._title, self._folders, self._lock = title, folders, threading.Lock()
        self._rows: dict[Path, tuple[object, ListedRun]] = {}

    def html(self) -> str:
        """Return the page."""
        with self._lock:
            return list_html(self._title, self._read(), self._link, is_live=True)

    def news(self, since: str) -> dict[str, Any]:
        """Return what is new since a version, as JSON values."""
        with self._lock:
            begun, rows = perf_counter(), self._read()
            version = hashlib.sha256(repr(rows).encode()).hexdigest()[:16]
            wait_ms = max(_SHORTEST_MS, round(_PAUSE * 1e3 * (perf_counter() - begun)))
            told = {"version": version, "wait_ms": wait_ms, "is_final": False, "state": ""}
            return told if version == since else told | list_news(rows, self._link)

    def _read(self) -> list[ListedRun]:
        for folder in self._folders:
            state = (_state(folder / MANIFEST), _state(folder / RESULT))
            if self._rows.get(folder, (None,))[0] != state:
                self._rows[folder] = state, listed(folder)
        return [self._rows[folder][1] for folder in self._folders]

    def _link(self, folder: Path) -> str:
        return f"run/{self._folders.index(folder)}/"


class WatchedStudy:
    """A study on a page that grows with it: its summary, its pictures, and its runs, with links to those kept."""

    def __init__(self, folder: Path, kept: Sequence[Path]) -> None:
        self._folder, self._lock = folder, threading.Lock()
        self._places = {path.name: k for k, path in enumerate(kept)}

    def html(self) -> str:
        """Return the page. Raises FolderError where the study cannot be read."""
        with self._lock:
            return study_html(self._folder, self._link, is_live=True)

    def news(self, since: str) -> dict[str, Any]:
        """Return what is new since a version, as JSON values. Raises FolderError."""
        with self._lock:
            begun = perf_counter()
            states = [_state(self._folder / name) for name in (LEDGER, f"{LEDGER}-wal")]
            version = hashlib.sha256(repr(states).encode()).hexdigest()[:16]
            found = {} if version == since else study_news(self._folder, self._link)
            wait_ms = max(_SHORTEST_MS, round(_PAUSE * 1e3 * (perf_counter() - begun)))
            return found | {"version": version, "wait_ms": wait_ms, "is_final": False, "state": ""}

    def _link(self, folder: Path) -> str:
        return f"run/{self._places[folder.name]}/" if folder.name in self._places else "."


def _state(path: Path) -> tuple[int, int] | None:
    """Return size and time of change [ns] of a file; None where there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns
