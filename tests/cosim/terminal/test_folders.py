"""Output folders and files of the commands that cannot be made: told before anything is computed."""

import os

import pytest

from cosim.errors import FolderError
from cosim.terminal.folders import must_be_new, new_folder


def test_a_new_file_is_in_a_folder_that_can_be_written_to(tmp_path, monkeypatch):
    must_be_new(None, "--ssv")
    must_be_new(tmp_path / "new.ssv", "--ssv")
    (tmp_path / "old.ssv").touch()
    with pytest.raises(FolderError, match=r"old\.ssv exists; give --ssv a new file"):
        must_be_new(tmp_path / "old.ssv", "--ssv")
    (tmp_path / "link.ssv").symlink_to(tmp_path / "elsewhere.ssv")  # which is not there, as on a disk that is not
    with pytest.raises(FolderError, match=r"link\.ssv exists; give --ssv a new file"):
        must_be_new(tmp_path / "link.ssv", "--ssv")
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # whoever runs this may be root
    with pytest.raises(FolderError, match=r"new\.ssv is in a folder that cannot be written to"):
        must_be_new(tmp_path / "new.ssv", "--ssv")


def test_a_name_that_is_too_long_is_refused(tmp_path):
    with pytest.raises(FolderError, match="cannot make the run folder"), new_folder("x", tmp_path / ("a" * 300)):
        pass
