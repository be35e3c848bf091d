"""Files that are written whole or not at all."""

import os

import pytest

from cosim import files


def test_an_interrupt_just_after_the_renaming_stays_an_interrupt(tmp_path, monkeypatch):
    """Ctrl-C while a checkpoint was written ended as "cannot write checkpoint.bin"."""
    renamed = os.replace

    def interrupted(source, target):
        renamed(source, target)
        raise KeyboardInterrupt

    monkeypatch.setattr(files.os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        files.write_text(tmp_path / "a", "whole")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_text() == "whole"
