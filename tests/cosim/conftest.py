"""Where FMUs are kept and unpacked while the co-simulation is tested, and the proof that nothing of a run is left."""

import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cosim.scenario import Scenario


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory) -> Iterator[Path]:
    """The built-in FMUs are built once a session, never into the user's cache."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FMU_RETUNE_CACHE", str(folder))
        yield folder


def children_of(process_id: int) -> set[int]:
    """Ids of the processes whose parent is process_id, dead and unburied ones included."""
    found = set()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == process_id:
            found.add(int(folder.name))
    return found


@pytest.fixture
def leaves_nothing(tmp_path, monkeypatch) -> Iterator[Path]:
    """Where this test and its child processes keep temporary files; afterwards it is empty and no child is left."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))
    before = children_of(os.getpid())
    yield folder
    assert list(folder.iterdir()) == []
    assert children_of(os.getpid()) <= before


@pytest.fixture
def pendulum() -> Callable[..., Scenario]:
    """The named pendulum scenario over 0.5 s, with further settings replaced."""

    def load(overrides: dict[str, str] | None = None, stop_time: float = 0.5) -> Scenario:
        return Scenario.load("pendulum", {"scenario.stop_time": repr(stop_time)} | (overrides or {}))

    return load
