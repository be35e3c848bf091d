"""Where FMUs are kept and unpacked while the co-simulation is tested, and the proof that nothing of a run is left."""

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path

import pytest
from pythonfmu import FmuBuilder

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
def children() -> Callable[[], set[int]]:
    """Ids of this process's children at the time of the call."""
    return lambda: children_of(os.getpid())


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
def becomes_true() -> Callable[..., bool]:
    """Whether condition() is true at some time within a limit that only a failing test ever reaches."""

    def wait_for(condition: Callable[[], object], within_s: float = 60.0) -> bool:
        deadline = time.monotonic() + within_s
        while not condition():
            if time.monotonic() > deadline:
                return False
            time.sleep(0.02)
        return True

    return wait_for


@pytest.fixture
def pendulum() -> Callable[..., Scenario]:
    """The named pendulum scenario over 0.5 s, with further settings replaced."""

    def load(overrides: dict[str, str] | None = None, stop_time: float = 0.5) -> Scenario:
        return Scenario.load("pendulum", {"scenario.stop_time": repr(stop_time)} | (overrides or {}))

    return load


FAULTY_REFERENCE = """
from pythonfmu import *


class FaultyReference(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.phi_ref = self.phi_dot_ref = 0.0
        for name in ("phi_ref", "phi_dot_ref"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))

    def do_step(self, t, h):
        if t > 0.045:
            raise ValueError("boom\\nsecond line")
        return True
"""


@pytest.fixture(scope="session")
def faulty_reference(tmp_path_factory) -> Path:
    """An FMU that raises in its sixth step of 10 ms; it has none of PendulumReference's parameters."""
    folder = tmp_path_factory.mktemp("faulty")
    script = folder / "faulty_reference.py"
    script.write_text(FAULTY_REFERENCE)
    return FmuBuilder.build_FMU(script, dest=folder)


@pytest.fixture
def faulty_toml(faulty_reference, tmp_path) -> Path:
    """The pendulum scenario with this reference."""
    text = (files("cosim") / "scenarios" / "pendulum.toml").read_text(encoding="utf-8")
    old = next(line for line in text.splitlines() if line.startswith("reference = "))
    path = tmp_path / "faulty.toml"
    path.write_text(text.replace(old, f"reference = {{ fmu = '{faulty_reference}' }}"), encoding="utf-8")
    return path
