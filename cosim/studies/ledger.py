"""The ledger of a study: one SQLite file that says how far each run is. It is the truth; all else follows.

A run is queued, leased (given to a worker), done (its row is committed), failed (the run itself diverged or faulted:
that is a result), refused (its scenario cannot be run) or lost (its worker died, several times). Each lease has a
number, so that what comes late from a worker that was given up is recognised and dropped.
"""

import json
import sqlite3
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from ..errors import FolderError, UnfinishedError, one_line
from ..files import to_json

LEDGER: Final = "ledger.sqlite"
"""File name, in the folder of the study."""
MOST_LOSSES: Final = 3
"""Number of times that a run is tried again after its worker has died."""
State = Literal["queued", "leased", "done", "failed", "refused", "lost"]
_RESULTS: Final = "('done', 'failed')"
_TABLES: Final = """
CREATE TABLE IF NOT EXISTS runs (
    key TEXT PRIMARY KEY, position INTEGER, point TEXT NOT NULL, state TEXT NOT NULL DEFAULT 'queued',
    lease INTEGER NOT NULL DEFAULT 0, losses INTEGER NOT NULL DEFAULT 0, result TEXT, record TEXT, why TEXT
) WITHOUT ROWID;
CREATE INDEX IF NOT EXISTS by_position ON runs (position);
"""


class LedgerEntry(NamedTuple):
    """A run as the ledger has it."""

    key: str
    """SHA-256 of all that the run follows from."""
    point: dict[str, Any]
    """Scenario, estimator, seed, and value of each factor."""
    state: State
    """How far it is."""
    result: dict[str, Any]
    """Columns of its row in the table of results; empty where there is no result."""
    why: str | None
    """Reason of a refusal or a loss, in one line."""
    lease: int
    """Number of its newest lease: how often a worker was given it."""


class Ledger:
    """The ledger of a study, open for the one process that leases its runs."""

    def __init__(self, path: Path | str, is_read_only: bool = False) -> None:
        """path: file, made where there is none, or `:memory:`. Raises FolderError."""
        self._path = path
        with self._reported():
            if is_read_only:
                self._database = sqlite3.connect(_address_to_read(Path(path)), uri=True)
                self._database.execute("PRAGMA trusted_schema = OFF")
                return
            self._database = sqlite3.connect(path, isolation_level=None)
            for pragma in ("journal_mode = WAL", "synchronous = FULL", "trusted_schema = OFF", "busy_timeout = 5000"):
                self._database.execute(f"PRAGMA {pragma}")
            self._database.executescript(_TABLES)

    def plan(self, runs: Iterable[tuple[str, dict[str, Any]]]) -> None:
        """Queue the runs that are new, by key and point, in the order of the table; others are left out of it.

        A run that was leased when the last process ended is queued again, and no loss is counted. Raises FolderError.
        """
        with self._transaction() as database:
            database.execute("UPDATE runs SET position = NULL")
            database.execute("UPDATE runs SET state = 'queued' WHERE state = 'leased'")
            database.executemany(
                "INSERT INTO runs (position, key, point) VALUES (?, ?, ?) "
                "ON CONFLICT (key) DO UPDATE SET position = excluded.position, point = excluded.point",
                ((position, key, to_json(point)) for position, (key, point) in enumerate(runs)),
            )

    def retry(self, *, at_once: bool = False) -> None:
        """Queue again what was refused or lost, if nothing else is left to be run, or at once. Raises FolderError."""
        if at_once or not self.counts()["queued"]:
            with self._transaction() as database:
                database.execute(
                    "UPDATE runs SET state = 'queued', losses = 0, why = NULL "
                    "WHERE state IN ('refused', 'lost') AND position IS NOT NULL"
                )

    def queued(self) -> list[str]:
        """Return the keys of the runs that are to be made, in the order of the table."""
        with self._reported():
            found = self._database.execute(
                "SELECT key FROM runs WHERE state = 'queued' AND position IS NOT NULL ORDER BY position"
            )
            return [key for (key,) in found]

    def keys(self) -> set[str]:
        """Return the keys of all runs, also of those that are left out of the table."""
        with self._reported():
            return {key for (key,) in self._database.execute("SELECT key FROM runs")}

    def lease(self, key: str) -> int:
        """Lease a queued run; return the lease's number. Raises FolderError."""
        with self._transaction() as database:
            found = database.execute(
                "UPDATE runs SET state = 'leased', lease = lease + 1 WHERE key = ? AND state = 'queued' "
                "RETURNING lease",
                (key,),
            ).fetchone()
        if found is None:
            raise FolderError(f"{self._path}: run {key[:12]} is not queued.")
        return int(found[0])

    def finish(
        self, key: str, lease: int, result: dict[str, Any], record: dict[str, Any] | None, is_done: bool
    ) -> bool:
        """Commit the result of a leased run; return False, changing nothing, where the lease is not in force."""
        state = "done" if is_done else "failed"
        return self._end(key, lease, state, (to_json(result), None if record is None else to_json(record), None))

    def refuse(self, key: str, lease: int, why: str) -> bool:
        """Commit that a leased run is refused; return False where the lease is not in force."""
        return self._end(key, lease, "refused", (None, None, one_line(why)))

    def give_back(self, key: str, lease: int) -> bool:
        """Queue a leased run again that was not begun, or not through its own doing; no loss is counted."""
        return self._end(key, lease, "queued", (None, None, None))

    def lose(self, key: str, lease: int, why: str) -> State | None:
        """Commit that the worker of a leased run died; return the state that follows, None for a lease not in force.

        Queued again, up to MOST_LOSSES times, then lost.
        """
        with self._transaction() as database:
            found = database.execute(
                "UPDATE runs SET losses = losses + 1, why = ?, "
                "state = CASE WHEN losses < ? THEN 'queued' ELSE 'lost' END "
                "WHERE key = ? AND lease = ? AND state = 'leased' RETURNING state",
                (one_line(why), MOST_LOSSES, key, lease),
            ).fetchone()
        return found and found[0]

    def counts(self) -> dict[State, int]:
        """Return the number of runs of the table in each state."""
        with self._reported():
            found = self._database.execute(
                "SELECT state, count(*) FROM runs WHERE position IS NOT NULL GROUP BY state"
            ).fetchall()
        states: tuple[State, ...] = ("queued", "leased", "done", "failed", "refused", "lost")
        return dict.fromkeys(states, 0) | dict(found)

    def reasons(self) -> list[tuple[str, int]]:
        """Return the reasons of refusals and losses with their numbers, the most frequent first."""
        with self._reported():
            return self._database.execute(
                "SELECT why, count(*) FROM runs WHERE why IS NOT NULL AND position IS NOT NULL "
                "GROUP BY why ORDER BY count(*) DESC LIMIT 10"
            ).fetchall()

    def has_results(self) -> bool:
        """Return whether any run has ended, one that is left out of the table included."""
        with self._reported():
            return bool(self._database.execute("SELECT 1 FROM runs WHERE state NOT IN ('queued', 'leased')").fetchone())

    def entries(self) -> Iterator[LedgerEntry]:
        """Yield the runs in the order of the table."""
        with self._reported():
            for key, point, state, result, why, lease in self._database.execute(
                "SELECT key, point, state, result, why, lease FROM runs WHERE position IS NOT NULL ORDER BY position"
            ):
                yield LedgerEntry(key, json.loads(point), state, json.loads(result) if result else {}, why, lease)

    def records(self) -> Iterator[dict[str, Any]]:
        """Yield the whole records of the runs that have a result, in the order of the table."""
        with self._reported():
            for (record,) in self._database.execute(
                f"SELECT record FROM runs WHERE position IS NOT NULL AND state IN {_RESULTS} ORDER BY position"
            ):
                yield json.loads(record)

    def close(self) -> None:
        """Close the file; idempotent."""
        self._database.close()

    def _end(self, key: str, lease: int, state: State, written: tuple[str | None, str | None, str | None]) -> bool:
        with self._transaction() as database:
            changed = database.execute(
                "UPDATE runs SET state = ?, result = ?, record = ?, why = ? "
                "WHERE key = ? AND lease = ? AND state = 'leased'",
                (state, *written, key, lease),
            )
            return changed.rowcount == 1

    @contextmanager
    def _transaction(self) -> Generator[sqlite3.Connection]:
        with self._reported():
            self._database.execute("BEGIN IMMEDIATE")
            try:
                yield self._database
                self._database.execute("COMMIT")
            except BaseException:
                if self._database.in_transaction:
                    self._database.execute("ROLLBACK")
                raise

    @contextmanager
    def _reported(self) -> Generator[None]:
        """Raise FolderError for what is no ledger, UnfinishedError for a disk that is full or fails."""
        try:
            yield
        except sqlite3.Error as e:
            is_of_disk = getattr(e, "sqlite_errorname", "").startswith(("SQLITE_FULL", "SQLITE_IOERR"))
            kind = UnfinishedError if is_of_disk else FolderError
            raise kind(f"cannot use {self._path}: {one_line(str(e))}.") from e


def _address_to_read(path: Path) -> str:
    """Return SQLite's address of a ledger that is only read: at rest nothing is made beside it."""
    is_at_rest = not path.with_name(f"{path.name}-wal").exists()
    return f"{path.resolve().as_uri()}?mode=ro{'&immutable=1' if is_at_rest else ''}"


@contextmanager
def open_ledger(path: Path | str, is_read_only: bool = False) -> Generator[Ledger]:
    """Yield a ledger, closed at the end; is_read_only: for looking, while another process may be at work on it.

    Raises FolderError where there is none to be read.
    """
    if is_read_only and not Path(path).is_file():
        raise FolderError(f"{Path(path).parent} is no study's folder: it has no {Path(path).name}.")
    ledger = Ledger(path, is_read_only)
    try:
        yield ledger
    finally:
        ledger.close()
