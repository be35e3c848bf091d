"""Growing files: whole pieces or none, and a digest of what is there."""

import errno
import hashlib
import resource
import signal

import pytest

from cosim.runs.append_file import EMPTY, AppendFile, Prefix


def prefix_of(content: bytes) -> Prefix:
    return Prefix(len(content), hashlib.sha256(content).hexdigest())


def test_a_prefix_is_that_of_the_bytes_written(tmp_path):
    file = AppendFile(tmp_path / "f")
    assert file.sync() == EMPTY
    file.append(b"abc")
    # FIPS 180-2, appendix B.1
    assert file.sync() == Prefix(3, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad")
    file.append(b"d" * 3_000_000)
    assert file.sync() == prefix_of(b"abc" + b"d" * 3_000_000)
    file.close()


def test_a_file_that_is_there_is_not_begun_anew(tmp_path):
    (tmp_path / "f").write_bytes(b"precious")
    with pytest.raises(FileExistsError):
        AppendFile(tmp_path / "f")
    assert (tmp_path / "f").read_bytes() == b"precious"


def test_it_goes_on_behind_its_prefix_and_what_came_after_is_cut_off(tmp_path):
    (tmp_path / "f").write_bytes(b"abcdefg")
    file = AppendFile(tmp_path / "f", prefix_of(b"abc"))
    file.append(b"XY")
    assert file.sync() == prefix_of(b"abcXY")
    file.close()
    assert (tmp_path / "f").read_bytes() == b"abcXY"


@pytest.mark.parametrize("content", [b"abX", b"ab", b"abXdefg"], ids=["changed", "shorter", "changed and longer"])
def test_another_beginning_is_refused_and_left_alone(tmp_path, content):
    (tmp_path / "f").write_bytes(content)
    with pytest.raises(ValueError, match="f has changed"):
        AppendFile(tmp_path / "f", prefix_of(b"abc"))
    assert (tmp_path / "f").read_bytes() == content


class Full:
    """A disk with room for so many bytes; a signal may come after so many calls."""

    def __init__(self, file, room, signals_at=0):
        self.file, self.room, self.signals_at = file, room, signals_at

    def __getattr__(self, name):
        return getattr(self.file, name)

    def write(self, piece):
        if not self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        n = min(len(piece), self.room, 4)
        self.room -= n
        written = self.file.write(piece[:n])
        if self.signals_at and self.file.tell() >= self.signals_at:
            signal.raise_signal(signal.SIGINT)
        return written


@pytest.fixture
def disk(monkeypatch):
    """disk(room, signals_at): what is opened from here on is on a disk with that much room."""

    def of(room, signals_at=0):
        disks = []

        def opened(*arguments, **options):
            file = open(*arguments, **options)  # noqa: SIM115  closed by the file on the disk
            disks.append(Full(file, room, signals_at))
            return disks[-1]

        monkeypatch.setattr("cosim.runs.append_file.open", opened, raising=False)
        return disks

    return of


@pytest.mark.parametrize("room", range(9))
def test_on_a_full_disk_a_piece_is_whole_or_not_there(tmp_path, disk, room):
    disks = disk(3 + room)
    file = AppendFile(tmp_path / "f")
    file.append(b"abc")
    with pytest.raises(OSError, match="No space left"):
        file.append(b"123456789")
    assert (tmp_path / "f").read_bytes() == b"abc"
    disks[0].room = 100
    file.append(b"987654321")
    assert file.sync() == prefix_of(b"abc987654321")
    assert (tmp_path / "f").read_bytes() == b"abc987654321"
    file.close()


def test_an_interrupted_piece_is_not_there(tmp_path, disk):
    disk(100, signals_at=7)
    file = AppendFile(tmp_path / "f")
    file.append(b"abc")
    with pytest.raises(KeyboardInterrupt):
        file.append(b"123456789")
    file.close()
    assert (tmp_path / "f").read_bytes() == b"abc"


def test_the_systems_own_limit_leaves_whole_pieces(tmp_path):
    """RLIMIT_FSIZE: a short write, then EFBIG."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    file = AppendFile(tmp_path / "f")
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
        file.append(b"a" * 700)
        with pytest.raises(OSError, match="File too large"):
            file.append(b"b" * 700)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert (tmp_path / "f").read_bytes() == b"a" * 700
    file.append(b"c")
    file.close()
    assert (tmp_path / "f").read_bytes() == b"a" * 700 + b"c"
