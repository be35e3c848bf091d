"""Folders whose names FMUs cannot read."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from cosim import ModelDescriptionError, Scenario, open_slave, run
from cosim.fmi.folder import PrivateFolder
from cosim.system.fmu_cache import find_fmu

ODD = ["a space", "Prüfstand", "c++", "100 %", "日本", "a#b"]


@pytest.fixture(params=ODD)
def odd(request, tmp_path, monkeypatch):
    """An odd folder, which is that of temporary files too; what is made elsewhere is cleared up by who makes it."""
    folder = tmp_path / f"{request.param} folder"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))
    return folder


def test_an_fmu_s_folder_has_a_name_that_a_uri_keeps(odd):
    with PrivateFolder() as path:
        folder = Path(path)
        assert folder.as_uri().replace("%20", " ") == f"file://{folder}"
        assert folder.stat().st_mode & 0o077 == 0
        assert (folder.parent == odd) == (odd.name in ("a space folder",))
    assert not folder.exists()


@pytest.mark.full_but("c++-2")
@pytest.mark.fmu
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_scenario_runs_from_an_odd_folder(odd, fmi, leaves_no_folder):
    for name in ("Pendulum", "PendulumController"):
        (odd / f"{name} ä+.fmu").write_bytes(find_fmu(name, odd, fmi).read_bytes())
    text = (Path(__file__).parents[3] / "cosim" / "scenarios" / "pendulum.toml").read_text(encoding="utf-8")
    for name in ("Pendulum", "PendulumController"):
        text = text.replace(f'fmu = "{name}"', f'fmu = "{name} ä+.fmu"')
    (odd / "my + scenario.toml").write_text(text, encoding="utf-8")
    out = odd / "runs ü+"
    out.mkdir()
    scenario = Scenario.load(odd / "my + scenario.toml", {"scenario.stop_time": "0.1"})
    result = run(scenario, out=out)
    assert (result.status, result.error) == ("done", None)
    assert (out / "series.arrow").is_file()


@pytest.fixture
def leaves_no_folder(tmp_path_factory, monkeypatch):
    """Nothing is left where an FMU was unpacked instead; no other process makes folders there."""
    plain = tmp_path_factory.mktemp("plain")
    monkeypatch.setattr("cosim.fmi.folder._OTHER_FOLDERS", (str(plain),))
    yield
    assert list(plain.iterdir()) == []


def test_where_no_folder_will_do_it_is_said_in_one_line(odd, tmp_path, monkeypatch):
    if odd.name == "a space folder":
        pytest.skip("a folder with a space will do")
    monkeypatch.setattr("cosim.fmi.folder._OTHER_FOLDERS", (str(tmp_path / "nowhere"),))
    path = find_fmu("Pendulum", tmp_path)
    with pytest.raises(ModelDescriptionError, match=r"no FMU can be unpacked: .* set TMPDIR to a folder"):
        open_slave(path, "plant")


@pytest.mark.full
@pytest.mark.fmu
def test_the_command_runs_there(odd):
    """In a fresh process, with folder, output and temporary files of an odd name."""
    command = [sys.executable, "-m", "cosim.cli", "run", "pendulum", "--only", "--set", "scenario.stop_time=0.05"]
    root = str(Path(__file__).parents[3])
    environment = os.environ | {"TMPDIR": str(odd), "PYTHONPATH": root}
    done = subprocess.run(
        [*command, "--out", str(odd / "out")], capture_output=True, text=True, cwd=odd, env=environment
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert (odd / "out" / "manifest.json").is_file()
