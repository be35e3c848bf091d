"""Run folders of earlier versions: what had another name in them is read."""

import json

import pytest

from cosim import read_run, run
from cosim.runs.manifest import write_manifest

CHANGED_EARLY = {'changes."plant.m"': "[[0.0, 1.75], [0.1, 4.271]]"}


@pytest.mark.fmu
@pytest.mark.full
def test_a_final_estimate_under_its_former_name_is_read(pendulum, tmp_path):
    folder = tmp_path / "run"
    found = run(pendulum(CHANGED_EARLY, stop_time=0.6), out=folder).final_estimate
    assert found is not None
    result = json.loads((folder / "result.json").read_text())
    result["belief"] = result.pop("final_estimate")
    (folder / "result.json").write_text(json.dumps(result))
    manifest = json.loads((folder / "manifest.json").read_text())
    del manifest["sha256"]["result.json"], manifest["seal"]
    manifest["scenario"]["guard"]["foresight"] = manifest["scenario"]["guard"].pop("lookahead")
    write_manifest(folder, manifest, is_own=True)
    old = read_run(folder)
    assert old.final_estimate == found
    assert old.scenario.guard.lookahead
