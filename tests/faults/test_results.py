"""Damaged run folders: each is told in one line with exit code 2 and left as it was, or is none the worse for it.

A row of the table is a fault, how it is injected, the command, and the expected outcome.
"""

import json
import os
import pickle
import random
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa
import pytest

from cosim import Scenario, run
from cosim.cli import main
from cosim.runs.manifest import write_manifest
from cosim.runs.run_files import CHECKPOINT, CSV, ESTIMATES, EVENTS, LATENCIES, LOCK, MANIFEST, RESULT, SERIES
from cosim.runs.series import read_series
from fmu_models.build import build

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(sys.platform != "linux", reason="looks for what is left in /proc"),
]
MODEL = "model_of_a_damaged_run"
SETTINGS = {
    "scenario.stop_time": "0.5",
    "scenario.checkpoint": "20",
    "scenario.isolation": "none",
    "estimation.model": f"{MODEL}:derivative",
    "components.plant.fmu": "Pendulum.fmu",
    'changes."plant.m"': "[[0.0, 1.75], [0.1, 4.271]]",
}


class Stopped(Exception):
    """The run is left where it is, as when it is killed."""


class Runs(NamedTuple):
    """Folders of runs of one scenario, and what that is made of."""

    scenario: Path
    done: Path
    left: Path


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> Iterator[Runs]:
    folder = tmp_path_factory.mktemp("runs")
    build("Pendulum", folder)
    (folder / f"{MODEL}.py").write_text("from fmu_models.pendulum import derivative as derivative\n")
    source = Path(main.__code__.co_filename).parent / "scenarios" / "pendulum.toml"
    shutil.copy(source, folder / "mine.toml")
    scenario = Scenario.load(folder / "mine.toml", SETTINGS)

    def stop(t, _):
        if t > 0.445:
            raise Stopped

    for name in ("done", "left"):
        (folder / name).mkdir()
    run(scenario, "target", 1, folder / "done")
    with pytest.raises(Stopped):
        run(scenario, "target", 1, folder / "left", stop)
    yield Runs(folder, folder / "done", folder / "left")
    sys.modules.pop(MODEL)


@pytest.fixture(autouse=True)
def restored(runs) -> Iterator[None]:
    """What the scenario is made of is put back after each row; so is what the command changes in this process."""
    kept = {path: path.read_bytes() for path in runs.scenario.iterdir() if path.is_file()}
    handler, environment = signal.getsignal(signal.SIGTERM), dict(os.environ)
    yield
    signal.signal(signal.SIGTERM, handler)
    os.environ.clear()
    os.environ.update(environment)
    for path, content in kept.items():
        path.write_bytes(content)


def flipped(name: str, at: float = 0.5):
    """One bit, at a share of the file."""

    def inject(folder: Path) -> None:
        content = bytearray((folder / name).read_bytes())
        content[int(at * (len(content) - 1))] ^= 1
        (folder / name).write_bytes(content)

    return inject


def cut(name: str, keep: Callable[[int], int]):
    def inject(folder: Path) -> None:
        content = (folder / name).read_bytes()
        (folder / name).write_bytes(content[: keep(len(content))])

    return inject


def grown(name: str, tail: bytes):
    def inject(folder: Path) -> None:
        (folder / name).write_bytes((folder / name).read_bytes() + tail)

    return inject


def filled(name: str, byte: bytes):
    return lambda folder: (folder / name).write_bytes(byte * (folder / name).stat().st_size)


def gone(name: str):
    return lambda folder: (folder / name).unlink()


def folder_instead(name: str):
    def inject(folder: Path) -> None:
        (folder / name).unlink(missing_ok=True)
        (folder / name).mkdir()

    return inject


def pipe_instead(name: str):
    def inject(folder: Path) -> None:
        (folder / name).unlink(missing_ok=True)
        os.mkfifo(folder / name)

    return inject


def link_instead(name: str):
    def inject(folder: Path) -> None:
        (folder / name).unlink(missing_ok=True)
        (folder / name).symlink_to(folder / MANIFEST)

    return inject


def edited(name: str, old: str, new: str):
    def inject(folder: Path) -> None:
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return inject


def resealed(**changes: object):
    """A manifest that another version might have written."""

    def inject(folder: Path) -> None:
        manifest = json.loads((folder / MANIFEST).read_text())
        for key, value in changes.items():
            manifest[key] = manifest[key] | value if isinstance(value, dict) else value
            if value is None:
                del manifest[key]
        write_manifest(folder, manifest, is_own=True)

    return inject


def beside(name: str, tail: bytes):
    """Something at the end of a file that the scenario needs."""
    return lambda folder: grown(name, tail)(Path(json.loads((folder / MANIFEST).read_text())["folder"]))


def swapped_rows(folder: Path) -> None:
    """A sound series, but of other numbers."""
    with open(folder / SERIES, "rb") as file:
        table = pa.ipc.open_stream(file).read_all()
    with pa.ipc.new_stream(folder / SERIES, table.schema) as writer:
        writer.write_table(table.slice(1))


class Malicious:
    """Once unpickled it has made a file beside the run folder."""

    def __init__(self, folder: Path) -> None:
        self.command = f"touch '{folder.parent / 'called'}'"

    def __reduce__(self):
        return os.system, (self.command,)


def seal(folder: Path, rest: bytes) -> None:
    """A checkpoint with the right hash, whatever is in it."""
    (folder / CHECKPOINT).write_bytes(sha256(rest).hexdigest().encode() + b"\n" + rest)


def pickled(folder: Path) -> None:
    """As earlier versions wrote them, by someone who means harm."""
    _, head, _ = (folder / CHECKPOINT).read_bytes().split(b"\n", 2)
    old = {"place": json.loads(head)["place"], "n_parts": 1, "reason": ""}
    seal(folder, json.dumps(old).encode() + b"\n" + pickle.dumps(("loop", Malicious(folder))))


def pickle_inside(folder: Path) -> None:
    """With the header of this version."""
    _, head, _ = (folder / CHECKPOINT).read_bytes().split(b"\n", 2)
    seal(folder, head + b"\n" + pickle.dumps(Malicious(folder)))


def restated(change: Callable[[dict], object]):
    """A checkpoint whose state has been changed."""

    def inject(folder: Path) -> None:
        _, head, text, block = (folder / CHECKPOINT).read_bytes().split(b"\n", 3)
        state = json.loads(text)
        change(state)
        seal(folder, b"\n".join([head, json.dumps(state).encode(), block]))

    return inject


def strange_class(state: dict) -> None:
    state["new"].append(["object", "subprocess:Popen", ["args", "true"]])


def late(state: dict) -> None:
    """A communication point after the end."""
    attributes = state["contents"][0][1][2]
    attributes[attributes.index("_k") + 1] = 10**6


OTHER = "is not as it was written"
DAMAGED = [
    # A run that is done, read by `retune replay`.
    ("a bit of the series", flipped(SERIES), "replay", f"series.arrow {OTHER}"),
    ("a bit of the series' last number", flipped(SERIES, 0.999), "replay", f"series.arrow {OTHER}"),
    ("a series cut by a byte", cut(SERIES, lambda n: n - 1), "replay", f"series.arrow {OTHER}"),
    ("half a series", cut(SERIES, lambda n: n // 2), "replay", f"series.arrow {OTHER}"),
    ("an empty series", cut(SERIES, lambda n: 0), "replay", f"series.arrow {OTHER}"),
    ("a series of zeros", filled(SERIES, b"\0"), "replay", f"series.arrow {OTHER}"),
    ("a longer series", grown(SERIES, b"\0" * 8), "replay", f"series.arrow {OTHER}"),
    ("another series", swapped_rows, "replay", f"series.arrow {OTHER}"),
    ("no series", gone(SERIES), "replay", "cannot read series.arrow: No such file"),
    ("a folder for a series", folder_instead(SERIES), "replay", "cannot read series.arrow: Is a directory"),
    ("a digit of the result", edited(RESULT, '"evaluations": 3', '"evaluations": 4'), "replay", f"result.json {OTHER}"),
    ("half a result", cut(RESULT, lambda n: n // 2), "replay", f"result.json {OTHER}"),
    ("no result", gone(RESULT), "replay", "cannot read result.json: No such file"),
    ("latencies cut short", cut(LATENCIES, lambda n: n - 2), "replay", f"latencies.json {OTHER}"),
    ("no latencies", gone(LATENCIES), "replay", "cannot read latencies.json: No such file"),
    *((f"no {name}", gone(name), "replay", f"cannot read {name}: No such file") for name in (EVENTS, CSV, ESTIMATES)),
    *((f"a bit of {name}", flipped(name), "replay", f"{name} {OTHER}") for name in (EVENTS, CSV, ESTIMATES)),
    *(
        (f"a folder for {name}", folder_instead(name), "replay", f"cannot read {name}: Is a directory")
        for name in (EVENTS, CSV, ESTIMATES)
    ),
    ("another estimate", edited(ESTIMATES, 'value="', 'value="9'), "replay", f"estimates.ssv {OTHER}"),
    ("a link to another file", link_instead(EVENTS), "replay", f"events.jsonl {OTHER}"),
    ("half a manifest", cut(MANIFEST, lambda n: n // 2), "replay", "manifest.json: Invalid JSON"),
    ("an empty manifest", cut(MANIFEST, lambda n: 0), "replay", "manifest.json: Invalid JSON"),
    ("a manifest of zeros", filled(MANIFEST, b"\0"), "replay", "manifest.json: Invalid JSON"),
    ("no manifest", gone(MANIFEST), "replay", "is no run folder: cannot read manifest.json"),
    ("a folder for a manifest", folder_instead(MANIFEST), "replay", "cannot read manifest.json: Is a directory"),
    ("another seed", edited(MANIFEST, '"seed": 1', '"seed": 2'), "replay", f"manifest.json {OTHER}"),
    ("another ending", edited(MANIFEST, '"done"', '"faulted"'), "replay", f"manifest.json {OTHER}"),
    ("another plant", edited(MANIFEST, '"u": 0.0', '"u": 1.0'), "replay", f"manifest.json {OTHER}"),
    # One that was left before its end.
    ("a bit of the series that the checkpoint vouches for", flipped(SERIES), "replay left", f"series.arrow {OTHER}"),
    ("a bit of the series, to go on with", flipped(SERIES), "resume", f"series.arrow {OTHER}"),
    ("a series shorter than the checkpoint's", cut(SERIES, lambda n: n // 3), "resume", f"series.arrow {OTHER}"),
    ("no series to go on with", gone(SERIES), "resume", "cannot read series.arrow: No such file"),
    ("a bit of the events", flipped(EVENTS), "resume", f"events.jsonl {OTHER}"),
    ("no events to go on with", gone(EVENTS), "resume", "cannot read events.jsonl: No such file"),
    ("a bit of the checkpoint", flipped(CHECKPOINT), "resume", f"checkpoint.bin {OTHER}"),
    ("a bit of its digest", flipped(CHECKPOINT, 0.0), "resume", f"checkpoint.bin {OTHER}"),
    ("half a checkpoint", cut(CHECKPOINT, lambda n: n // 2), "resume", f"checkpoint.bin {OTHER}"),
    ("an empty checkpoint", cut(CHECKPOINT, lambda n: 0), "resume", f"checkpoint.bin {OTHER}"),
    ("a folder for a checkpoint", folder_instead(CHECKPOINT), "resume", "cannot read checkpoint.bin: Is a directory"),
    (
        "a folder for a result",
        folder_instead(RESULT),
        "resume",
        "is damaged: result.json is not a file",
    ),
    ("a pipe for a lock", pipe_instead(LOCK), "resume", "cannot write in {folder}: lock is not a regular file."),
    ("a link for a lock", link_instead(LOCK), "resume", "cannot write in {folder}: lock is a symbolic link."),
    *(
        (f"a pipe for {name}", pipe_instead(name), how, f"cannot read {name}: it is not a regular file")
        for name, how in [
            *((name, "replay") for name in (SERIES, MANIFEST, EVENTS, CSV, ESTIMATES, RESULT, LATENCIES)),
            (EVENTS, "resume"),
            (CHECKPOINT, "resume"),
        ]
    ),
    ("no checkpoint", gone(CHECKPOINT), "resume", "cannot be resumed: it has no checkpoint"),
    ("a pickle for a checkpoint", pickled, "resume", "cannot be resumed: its checkpoint is of another version."),
    ("a pickle in a checkpoint", pickle_inside, "resume", "its checkpoint does not fit the run: "),
    ("a class of somebody else's", restated(strange_class), "resume", "ValueError: no objects of subprocess:Popen"),
    ("a checkpoint after the end", restated(late), "resume", "there is no communication point 1000000"),
    ("a half manifest to go on with", cut(MANIFEST, lambda n: n // 2), "resume", "manifest.json: Invalid JSON"),
    ("another seed to go on with", edited(MANIFEST, '"seed": 1', '"seed": 2'), "resume", f"manifest.json {OTHER}"),
    ("another NumPy", resealed(versions={"numpy": "1.0"}), "resume", "it was begun with numpy 1.0, and this is "),
    ("a scenario of another version", resealed(scenario={"new": 1}), "resume", "holds a scenario of another version"),
    ("another FMU", beside("Pendulum.fmu", b"\0"), "resume", "Pendulum.fmu has changed since it was begun"),
    ("another model", beside(f"{MODEL}.py", b"# new\n"), "resume", f"{MODEL}.py has changed since it was begun"),
    ("nothing left to do", lambda f: None, "resume done", "cannot be resumed: it is done"),
    ("no folder", shutil.rmtree, "resume", "is no run folder: cannot read manifest.json"),
]


def called(capfd, *arguments: object) -> tuple[int, str, str]:
    code = main([str(a) for a in arguments])
    printed = capfd.readouterr()
    return code, printed.out, printed.err


def command(name: str, folder: Path) -> list[object]:
    return ["resume", folder] if "resume" in name else ["replay", folder, "--estimator", "least-squares"]


@pytest.fixture
def copied(runs, tmp_path) -> Callable[[str], Path]:
    """A copy of a run to be spoilt: of the one that is done where the command says so."""

    def copy(name: str) -> Path:
        source = runs.done if name in ("replay", "resume done") else runs.left
        return Path(shutil.copytree(source, tmp_path / "run"))

    return copy


def contents(folder: Path) -> dict[Path, bytes | None]:
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("inject", "how", "outcome"), [d[1:] for d in DAMAGED], ids=[d[0] for d in DAMAGED])
def test_a_damaged_folder_is_told_in_one_line_and_left_as_it_is(copied, capfd, inject, how, outcome):
    folder = copied(how)
    inject(folder)
    before = contents(folder)
    code, out, err = called(capfd, *command(how, folder))
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert err.startswith("retune: ")
    assert str(folder) in err
    assert outcome.replace("{folder}", str(folder)) in err
    assert contents(folder) == before
    assert list(folder.parent.glob("called")) == []


POOL = [None, True, -1, 0, 3, 2**70, 1e308, 1e-308, "", "x", [], ["n", 0], ["n", 5], ["s", 0], ["s", 9],
        ["tuple", []], ["bytes", {"b": 3}], {"b": 0}, {"b": 8}]  # fmt: skip


def places_in(values, path=()):
    """The place of each JSON value that holds no others."""
    if isinstance(values, list) and values:
        return [p for i, value in enumerate(values) for p in places_in(value, (*path, i))]
    return [path]


@pytest.mark.parametrize("seed", range(40))
def test_whatever_a_checkpoint_holds_the_end_is_one_line(copied, capfd, seed):
    """A value or two of it are others, and its hash is right: it may fit, and lead to a run of other numbers."""
    folder, rng = copied("resume"), random.Random(seed)

    def change(state: dict) -> None:
        values = [state["contents"], state["new"], state["alive"]]
        for _ in range(rng.choice([1, 1, 2, 9])):
            *path, last = rng.choice(places_in(values))
            inner = values
            for i in path:
                inner = inner[i]
            inner[last] = rng.choice(POOL)

    restated(change)(folder)
    before = contents(folder)
    code, out, err = called(capfd, "resume", folder)
    assert code in (0, 1, 2)
    assert "Traceback" not in err
    if code:
        assert len(err.splitlines()) == 1
        assert err.startswith("retune: ")
    if code == 2:
        assert out == ""
        assert contents(folder) == before


def stale_lock(folder: Path) -> None:
    (folder / LOCK).write_text("process 1 on somewhere")


def torn(folder: Path) -> None:
    """What a killed process leaves: half a batch and half a line."""
    grown(SERIES, (folder / SERIES).read_bytes()[-100:])(folder)
    grown(EVENTS, b'{"t": 0.4, "ki')(folder)


HARMLESS = [
    ("somebody's file", lambda f: (f / "notes.txt").write_text("mine"), "replay"),
    ("a picture drawn anew", lambda f: (f / "tracking.png").write_bytes(b"new"), "replay"),
    ("an older version's, without hashes of all", resealed(sha256=None), "replay"),
    ("the lock of a dead process, read", stale_lock, "replay left"),
    ("a torn end, read", torn, "replay left"),
    ("no checkpoint, read", gone(CHECKPOINT), "replay left"),
    ("a torn end", torn, "resume"),
    ("the lock of a dead process", stale_lock, "resume"),
    ("a whole file that was half written", lambda f: (f / ".checkpoint.bin-ab3_x9zq").write_bytes(b"half"), "resume"),
    ("rows after the checkpoint", lambda f: None, "resume"),
]


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("inject", "how"), [h[1:] for h in HARMLESS], ids=[h[0] for h in HARMLESS])
def test_what_does_no_harm_is_passed_over(runs, copied, capfd, inject, how):
    folder = copied(how)
    inject(folder)
    code, out, err = called(capfd, *command(how, folder))
    assert (code, err) == (0, "")
    assert out
    if how == "resume":
        for name in (SERIES, EVENTS, "series.csv", "estimates.ssv"):
            assert (folder / name).read_bytes() == (runs.done / name).read_bytes(), name
        assert {p.name for p in folder.iterdir()} == {p.name for p in runs.done.iterdir()}


def test_a_run_recorded_without_checkpoints_says_so(runs, tmp_path, capfd, monkeypatch):
    monkeypatch.setattr("cosim.runs.record.ROWS_PER_BATCH", 50)
    scenario = Scenario.load(runs.scenario / "mine.toml", SETTINGS | {"scenario.checkpoint": "0"})

    def stop(t, _):
        if t > 0.495:
            raise Stopped

    (tmp_path / "run").mkdir()
    with pytest.raises(Stopped):
        run(scenario, "none", 1, tmp_path / "run", stop)
    assert len(read_series(tmp_path / "run")["time"]) == 50
    code, out, err = called(capfd, "resume", tmp_path / "run")
    assert (code, out, err) == (2, "", f"retune: {tmp_path / 'run'} cannot be resumed: it has no checkpoint.\n")
