"""What holds for all tests, and what is built for them once a change."""

import hashlib
import os
import shutil
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path

import pytest
from filelock import FileLock

import fmu_models


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """One more than there are processors: many a test waits for processes."""
    return 1 + (os.cpu_count() or 1)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks as `full` the cases of a test with other seeds than its first, and what `full_but` and `sampled` say."""
    first_seeds, n_cases = dict[object, int](), Counter[object]()
    for item in items:
        params = item.callspec.params if hasattr(item, "callspec") else {}
        mark, seed = item.get_closest_marker("full_but"), params.get("seed")
        is_later = isinstance(seed, int) and seed != first_seeds.setdefault(item.function, seed)
        if (sampled := item.get_closest_marker("sampled")) is not None:
            is_later = n_cases[item.function] % sampled.args[0] > 0
            n_cases[item.function] += 1
        if is_later or (mark and item.callspec.id not in mark.args):
            item.add_marker("full")


@pytest.fixture(scope="session", autouse=True)
def interruptible():
    """A suite that was started in the background ignores SIGINT, and so would the programs that it starts."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session")
def made_once(pytestconfig) -> Callable[..., Path]:
    """made_once(make, *what): a folder that make(folder) filled, once as long as `what` stays the same.

    It is kept for the next session, and shared by the workers of pytest-xdist. what: all that the files follow from
    beside the builders' versions; of a path, the bytes of the file or of all in the folder count.
    """
    versions = [version(name) for name in ("fmpy", "pythonfmu", "pythonfmu3")]

    def made(make: Callable[[Path], object], *what: object) -> Path:
        key = hashlib.sha256(repr([versions, *map(_content, what)]).encode()).hexdigest()[:16]
        folder = pytestconfig.cache.mkdir("made") / key
        with FileLock(f"{folder}.lock"):
            if not folder.is_dir():
                unfinished = folder.with_suffix(".unfinished")
                shutil.rmtree(unfinished, ignore_errors=True)
                unfinished.mkdir()
                make(unfinished)
                unfinished.rename(folder)
        return folder

    return made


def _content(what: object) -> object:
    if not isinstance(what, Path):
        return what
    paths = sorted(p for p in what.rglob("*") if p.is_file() and p.suffix != ".pyc") if what.is_dir() else [what]
    return [(p.name, hashlib.sha256(p.read_bytes()).hexdigest()) for p in paths]


@pytest.fixture(scope="session", autouse=True)
def cache(made_once, tmp_path_factory) -> Iterator[Path]:
    """Where the built-in FMUs are kept: never the user's cache. What is unpacked there is a session's own, and so
    is the key of its runs."""
    folder = tmp_path_factory.mktemp("cache")
    built = made_once(lambda folder: None, "built-in FMUs", Path(fmu_models.__file__).parent)
    (folder / "fmus").symlink_to(built)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FMU_RETUNE_CACHE", str(folder))
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        yield folder
