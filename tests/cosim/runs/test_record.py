"""Run folders: every prefix of a series is readable, whole files appear at once, nothing is overwritten."""

import csv
import errno
import json
import os
import signal
import sys
import threading
import tracemalloc

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.errors import FolderError, UnfinishedError
from cosim.files import sha256, to_json, write_json, write_text
from cosim.runs.record import ROWS_PER_BATCH, Recorder, recording, uninterrupted
from cosim.runs.run_files import EVENTS, SERIES, new_run_folder
from cosim.runs.series import read_series, write_csv

N_ROWS = 3 * ROWS_PER_BATCH + 7
COLUMNS = ("time", "plant.phi", "sampled.plant.der(phi_dot)")


def rows(n=N_ROWS):
    return [(0.01 * k, float(np.sin(k)), -1.0 / (k + 1)) for k in range(n)]


def recorded(folder, n=N_ROWS):
    recorder = Recorder(folder, COLUMNS)
    for row in rows(n):
        recorder.row(row)
    return recorder


def assert_prefix(series, n):
    table = np.array(rows()).T
    assert tuple(series) == COLUMNS
    for column, expected in zip(series.values(), table, strict=True):
        np.testing.assert_array_equal(column, expected[:n])


def test_a_series_is_read_back_as_it_was_recorded(tmp_path):
    returned = recorded(tmp_path).close()
    assert_prefix(returned, N_ROWS)
    assert_prefix(read_series(tmp_path), N_ROWS)


def test_a_recorder_without_a_folder_remembers_the_rows():
    assert_prefix(recorded(None).close(), N_ROWS)


def test_a_recorder_with_a_folder_remembers_of_a_long_record_only_what_is_not_written(tmp_path, monkeypatch):
    monkeypatch.setattr("cosim.runs.record._MOST_KEPT", 5 * ROWS_PER_BATCH * len(COLUMNS))
    recorder = Recorder(tmp_path, COLUMNS)
    tracemalloc.start()
    sizes = []
    for n in range(20 * ROWS_PER_BATCH):
        recorder.row((0.01 * n, 1.0, 2.0))
        if n % ROWS_PER_BATCH == ROWS_PER_BATCH // 2:
            sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert len(recorder.close()["time"]) == 20 * ROWS_PER_BATCH
    assert sizes[-1] - sizes[9] < 10 * ROWS_PER_BATCH * 8  # ten batches more; one column of them would be as much


def test_a_run_without_a_row_has_empty_series(tmp_path):
    assert_prefix(recorded(tmp_path, 0).close(), 0)
    assert_prefix(read_series(tmp_path), 0)


def test_full_batches_are_on_disk_while_the_run_goes_on(tmp_path):
    recorder = recorded(tmp_path)
    assert_prefix(read_series(tmp_path), 3 * ROWS_PER_BATCH)
    recorder.flush()
    assert_prefix(read_series(tmp_path), N_ROWS)
    recorder.close()


@pytest.mark.full
def test_a_series_cut_at_any_byte_is_a_prefix_or_refused(tmp_path):
    recorded(tmp_path).close()
    whole = (tmp_path / SERIES).read_bytes()
    lengths = []
    for size in range(len(whole) + 1):
        (tmp_path / SERIES).write_bytes(whole[:size])
        try:
            series = read_series(tmp_path)
        except FolderError as refused:
            assert len(str(refused).splitlines()) == 1
            assert not lengths  # refused only until the columns are told
            continue
        lengths.append(len(series["time"]))
        assert_prefix(series, lengths[-1])
    assert lengths == sorted(lengths)
    # every full batch can be had, and no half of one
    assert set(lengths) == {0, ROWS_PER_BATCH, 2 * ROWS_PER_BATCH, 3 * ROWS_PER_BATCH, N_ROWS}


@pytest.mark.parametrize(
    "content",
    [None, b"", b"no arrow at all", b"\0" * 4096, b"\xff" * 4096],
    ids=["none", "empty", "text", "zeros", "ones"],
)
def test_a_folder_without_a_readable_series_is_told(tmp_path, content):
    if content is not None:
        (tmp_path / SERIES).write_bytes(content)
    with pytest.raises(FolderError, match=SERIES):
        read_series(tmp_path)


def test_the_series_is_a_plain_arrow_stream_for_other_tools(tmp_path):
    recorded(tmp_path).close()
    with pa.ipc.open_stream((tmp_path / SERIES).read_bytes()) as reader:
        table = reader.read_all()
    assert table.column_names == list(COLUMNS)
    assert table.num_rows == N_ROWS


def test_a_series_is_compressed_and_one_that_is_not_is_read_too(tmp_path):
    recorder = Recorder(tmp_path, COLUMNS)
    for k in range(N_ROWS):
        recorder.row((0.01 * k, 1.0, 2.0))  # two of three columns are constant
    series = recorder.close()
    assert (tmp_path / SERIES).stat().st_size < N_ROWS * 8 * 2
    table = pa.table({name: pa.array(column) for name, column in series.items()})
    with pa.ipc.new_stream(tmp_path / SERIES, table.schema) as writer:
        writer.write_table(table)
    assert (tmp_path / SERIES).stat().st_size > N_ROWS * 8 * 3
    np.testing.assert_equal(read_series(tmp_path), series)


def test_events_are_json_lines_with_time_and_kind_first(tmp_path):
    recorder = Recorder(tmp_path, ["time"])
    recorder.event(0.5, "write", {"theta": [1.0, float("nan")], "reason": "two\nlines"})
    recorder.event(0.6, "end", {})
    recorder.close()
    lines = (tmp_path / EVENTS).read_text(encoding="utf-8").splitlines()
    assert [json.loads(line) for line in lines] == [
        {"t": 0.5, "kind": "write", "theta": [1.0, None], "reason": "two\nlines"},
        {"t": 0.6, "kind": "end"},
    ]
    assert list(json.loads(lines[0]))[:2] == ["t", "kind"]


def test_a_recorder_that_cannot_write_says_so(tmp_path):
    (tmp_path / SERIES).mkdir()
    with pytest.raises(FolderError, match=f"cannot write in {tmp_path}: "):
        Recorder(tmp_path, ["time"])


# Whole files.


def test_a_whole_file_replaces_the_old_one(tmp_path):
    path = tmp_path / "manifest.json"
    write_text(path, "old")
    write_text(path, "new é\r\n")
    assert path.read_bytes() == "new é\r\n".encode()
    assert [p.name for p in tmp_path.iterdir()] == ["manifest.json"]
    assert path.stat().st_mode & 0o777 == 0o644


@pytest.mark.parametrize("function", ["replace", "fsync", "chmod"])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()], ids=["full", "Ctrl-C"])
def test_a_whole_file_that_cannot_be_finished_leaves_the_old_one_alone(tmp_path, monkeypatch, function, error):
    path = tmp_path / "manifest.json"
    write_text(path, "old")

    def fail(*_):
        raise error

    monkeypatch.setattr(os, function, fail)
    with pytest.raises(FolderError if isinstance(error, OSError) else KeyboardInterrupt):
        write_text(path, "new")
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["manifest.json"]


def test_a_whole_file_for_a_folder_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(FolderError, match=r"cannot write .*result\.json: No such file"):
        write_json(tmp_path / "gone" / "result.json", {})


def test_what_is_not_finite_becomes_null_in_json():
    value = {
        "nan": float("nan"), "inf": [float("inf"), (-float("inf"), 1.5)], "np": np.float64("nan"),
        "array": np.array([[1.0, np.nan], [np.inf, 2.0]]), 3: True, "n": np.int64(4), "none": None,
    }  # fmt: skip
    assert json.loads(to_json(value)) == {
        "nan": None, "inf": [None, [None, 1.5]], "np": None,
        "array": [[1.0, None], [None, 2.0]], "3": True, "n": 4, "none": None,
    }  # fmt: skip


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(), max_size=20))
def test_json_and_back_keeps_every_finite_bit(values):
    for a, b in zip(values, json.loads(to_json(values)), strict=True):
        assert b is None if not np.isfinite(a) else a.hex() == b.hex()


def test_csv_keeps_every_digit(tmp_path):
    series = {"time": np.array([0.1, 0.2]), "plant.der(phi_dot)": np.array([1.0 / 3.0, -2e-300])}
    write_csv(tmp_path / "series.csv", series)
    with open(tmp_path / "series.csv", newline="", encoding="utf-8") as file:
        header, *lines = list(csv.reader(file))
    assert header == list(series)
    assert [[float(x) for x in line] for line in lines] == [[0.1, 1.0 / 3.0], [0.2, -2e-300]]


def test_a_file_has_the_sha_256_of_the_standard(tmp_path):
    (tmp_path / "abc").write_bytes(b"abc")
    # FIPS 180-2, appendix B.1
    assert sha256(tmp_path / "abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


# Interrupts.


@pytest.fixture
def sigterm_interrupts():
    """As the command has it."""

    def interrupt(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    yield interrupt
    signal.signal(signal.SIGTERM, before)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda n: n.name)
def test_an_interrupt_is_put_off_until_the_end_and_then_raised_once(sigterm_interrupts, number):
    handlers, done = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)], []

    @uninterrupted()
    def work():
        for k in range(3):
            signal.raise_signal(number)
            done.append(k)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == [0, 1, 2]
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == handlers
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(number)


@pytest.mark.skipif(sys.platform == "win32", reason="has no SIGHUP")
def test_a_terminal_that_is_closed_is_put_off_too(sigterm_interrupts):
    before, done = signal.signal(signal.SIGHUP, sigterm_interrupts), []

    @uninterrupted()
    def work():
        signal.raise_signal(signal.SIGHUP)
        done.append("all")

    with pytest.raises(KeyboardInterrupt):
        work()
    signal.signal(signal.SIGHUP, before)
    assert done == ["all"]


def test_an_error_inside_goes_to_the_caller_and_the_handlers_are_put_back(sigterm_interrupts):
    before, inside = signal.getsignal(signal.SIGINT), []

    @uninterrupted()
    def work():
        inside.append(signal.getsignal(signal.SIGINT))
        raise FolderError("full")

    with pytest.raises(FolderError, match="full"):
        work()
    assert inside != [before]
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == (before, sigterm_interrupts)


def test_signals_that_python_does_not_handle_are_left_to_the_system():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN), signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        with uninterrupted():
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
            assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGINT, before[0])
        signal.signal(signal.SIGTERM, before[1])


def test_in_another_thread_nothing_is_put_off():
    seen = []

    def work():
        with uninterrupted():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.getsignal(signal.SIGINT)]


# Run folders.


def test_run_folders_are_numbered_from_one_and_take_the_first_free_number(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made = [str(new_run_folder("pendulum", None)) for _ in range(2)]
    (tmp_path / "runs" / "pendulum-3").write_text("a file is in the way too")
    made += [str(new_run_folder("pendulum", None)), str(new_run_folder("quadrotor", None))]
    assert made == ["runs/pendulum-1", "runs/pendulum-2", "runs/pendulum-4", "runs/quadrotor-1"]


def test_a_run_folder_may_be_given_absent_deep_or_empty(tmp_path):
    (tmp_path / "empty").mkdir()
    for out in (tmp_path / "absent", tmp_path / "a" / "b", tmp_path / "empty"):
        assert new_run_folder("pendulum", out) == out
        assert list(out.iterdir()) == []


def test_a_run_folder_that_holds_anything_is_refused_and_left_alone(tmp_path):
    (tmp_path / "mine").write_text("precious")
    with pytest.raises(FolderError, match=f"{tmp_path} is not empty"):
        new_run_folder("pendulum", tmp_path)
    assert [p.read_text() for p in tmp_path.iterdir()] == ["precious"]


@pytest.mark.parametrize("out", ["file", "file/below"])
def test_a_run_folder_with_a_file_in_its_way_is_refused(tmp_path, out):
    (tmp_path / "file").write_text("")
    with pytest.raises(FolderError, match=f"cannot make the run folder {tmp_path / out}: "):
        new_run_folder("pendulum", tmp_path / out)


def test_a_file_called_runs_is_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").write_text("")
    with pytest.raises(FolderError, match="cannot make the run folder runs: "):
        new_run_folder("pendulum", None)


@pytest.mark.parametrize(("manifest", "is_advised"), [({"estimator": "target"}, True), ({"system": "loop"}, False)])
def test_who_has_no_room_is_advised_to_resume_what_can_be_resumed(tmp_path, manifest, is_advised):
    (tmp_path / "lock").touch()
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(UnfinishedError) as told, recording(tmp_path):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert ("retune resume" in str(told.value)) == is_advised
