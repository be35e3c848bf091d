"""`retune report`: one file that asks for nothing, whatever is in the run."""

import base64
import dataclasses
import json
import re

import numpy as np
import pytest

from cosim import Scenario, run
from cosim.errors import FolderError
from cosim.files import to_json
from cosim.pages.list_page import listed, run_folders
from cosim.pages.marks import SIGNS
from cosim.pages.pictures import draw_pictures
from cosim.pages.runs_page import read_page
from cosim.pages.weighed import HYPOTHESES
from cosim.plots.palette import RUNS
from cosim.runs.manifest import read_manifest
from cosim.runs.recorded_events import read_events
from estimator.hypotheses import Weighing

HOSTILE = "</script><img src=http://evil.example/x onerror=alert(1)>$$x$$"


def without_bokeh(html):
    """The page without the script of Bokeh, which is the longest."""
    scripts = re.findall(r"<script nonce=.*?</script>", html, re.DOTALL)
    return html.replace(max(scripts, key=len), "")


def data_of(html):
    return json.loads(re.search(r'<script type="application/json" id="page">(.*?)</script>', html, re.DOTALL)[1])


@pytest.mark.full
@pytest.mark.fmu
def test_a_report_tells_what_the_run_was_and_asks_for_nothing(recorded):
    html = read_page([recorded]).html()
    text = without_bokeh(html)
    assert "http:" not in text
    assert "https:" not in text
    assert "default-src 'none'" in text
    assert "connect-src" not in text
    manifest = read_manifest(recorded)
    for digest in (*manifest.sha256.values(), *(fmu["sha256"] for fmu in manifest.fmus.values())):
        assert digest in text
    assert manifest.versions["numpy"] in text
    assert "nominal controller" in text  # the table of the terminal
    assert {*data_of(html)["renderers"]} == {"r0", "r0-none"}


def test_a_page_asks_for_nothing_and_has_versions_hashes_and_the_table_of_the_terminal(made_up, page_of):
    text = without_bokeh(page_of(made_up()).html())
    assert re.findall(r"https?:", text) == []
    assert "default-src 'none'" in text
    assert "connect-src" not in text
    for part in ("9.9", "ab12", "mean squared tracking error", "2 standard deviations"):
        assert part in text


@pytest.mark.full
@pytest.mark.fmu
def test_the_data_of_the_curves_are_the_record_bit_for_bit(recorded):
    page = read_page([recorded])
    columns = draw_pictures(page.shown).columns.to_json()
    drawn = {name: base64.b64decode(packed["f8"]) for name, packed in columns["r0"].items()}
    run = page.main[0].run
    assert drawn["t"] == run.time.tobytes()
    assert drawn["held.plant.u 0"] == run["held.plant.u"].tobytes()
    assert drawn["m 0"] == run["controller.m"].tobytes()
    events = [json.loads(line) for line in (recorded / "events.jsonl").read_text().splitlines()]
    for kind in {e["kind"] for e in events} - {"candidate", "evidence"}:
        times = np.frombuffer(base64.b64decode(columns[f"r0 {kind}"]["x"]["f8"]))
        assert times.tolist() == [e["t"] for e in events if e["kind"] == kind]
        assert all(columns[f"r0 {kind}"]["text"])


@pytest.mark.full
@pytest.mark.fmu
def test_a_run_that_goes_on_or_was_killed_has_its_page(recorded, tmp_path):
    for name, lost in (("series.arrow", 100), ("events.jsonl", 300)):  # bytes: of the last rows, of the last events
        (tmp_path / name).write_bytes((recorded / name).read_bytes()[:-lost])
    manifest = json.loads((recorded / "manifest.json").read_text())
    kept = {k: v for k, v in manifest.items() if k not in ("seal", "signature", "sha256")}
    (tmp_path / "manifest.json").write_text(to_json(kept | {"status": "running"}))
    page = read_page([tmp_path])
    assert not page.is_final
    assert "The run was stopped at t = " in page.html()


def test_each_run_has_the_band_of_its_own_parameter(made_up, changed):
    """The second run has its parameters in the other order."""
    written = {"t": 0.1, "kind": "write", "std": [0.1, 0.1]}
    first, second = (made_up(events=[written | {"theta": theta}]) for theta in ([1.0, 2.0], [2.0, 1.0]))
    scenario = second.run.scenario
    estimation = scenario.estimation.model_copy(update={"parameters": scenario.estimation.parameters[::-1]})
    second = changed(second, scenario=scenario.model_copy(update={"estimation": estimation}))._replace(key="r1")
    sources = draw_pictures([first, second]).columns.sources
    for key, name, value in (("r0", "m", 1.0), ("r1", "m", 1.0), ("r0", "l", 2.0), ("r1", "l", 2.0)):
        low, high = (sources[f"{key} band {name}"].data[f"{name} {edge}"][0] for edge in (0, 1))
        assert np.sqrt(low * high) == pytest.approx(value)


def test_a_truth_and_a_reference_are_drawn_again_where_they_differ(made_up):
    runs = [made_up(), made_up()._replace(key="r1"), made_up(plant_m=[3.0] * 100, reference_phi_ref=[0.5] * 100)]
    runs[2] = runs[2]._replace(key="r2", style=RUNS[2])
    pictures = draw_pictures(runs)
    for name in ("true m", "reference.phi_ref"):
        drawn = {key: s.data[f"{name} 0"] for key, s in pictures.columns.sources.items() if f"{name} 0" in s.data}
        assert {*drawn} == {"r0", "r2"}
        assert drawn["r2"][0] == runs[2].run["plant.m" if name == "true m" else name][0]


def test_every_hypothesis_that_is_compared_has_a_sign():
    names = {field.name for field in dataclasses.fields(Weighing)} - {"noise"}  # that is never recorded
    assert names <= HYPOTHESES.keys()


def test_the_evidence_of_the_hypotheses_is_drawn_and_told(made_up, page_of):
    scores = {"parameters": 12.0, "disturbance": 15.0, "nothing": 1012.0, "both": None}
    event = {"t": 0.5, "kind": "evidence", "n_samples": 5, "scores": scores, "explained": ["parameters"]}
    odd = [event | {"scores": other} for other in ({}, {"nothing": None}, None)]
    columns = page_of(made_up(events=[event, *odd])).news()["columns"]
    drawn = {name: columns[f"r0 evidence {name}"] for name in ("parameters", "disturbance", "nothing")}
    values = {name: np.frombuffer(base64.b64decode(drawn[name]["y"]["f8"])).tolist() for name in drawn}
    assert values == {"parameters": [1.0], "disturbance": [3.0], "nothing": [1000.0]}
    assert "r0 evidence both" not in columns
    assert drawn["disturbance"]["text"] == [
        'a disturbance acts: worse than the best by 3. "parameters have changed" explains the newest 5 samples; worse: '
        "a disturbance acts (by 3), nothing has changed (by 1e+03)"
    ]
    assert "very strong evidence against it" in drawn["nothing"]["text"][0]


def test_latencies_are_drawn_at_their_times_the_longest_of_many_too(made_up, page_of, changed):
    n = 20_000
    seconds = tuple((0.5,) if k == 12_345 else (0.001, 0.002) for k in range(1, n))
    shown = changed(made_up(n), latencies=seconds, latency_steps=((1, n - 1),))
    packed = page_of(shown).news()["columns"]["r0 latency"]
    t, y = (np.frombuffer(base64.b64decode(packed[name]["f8"])) for name in "xy")
    assert len(t) <= 5000
    assert (t[np.argmax(y)], y.max()) == (pytest.approx(123.45), pytest.approx(500.0))
    assert t[-1] == pytest.approx(199.99)
    assert "r0 latency" not in page_of(changed(shown, latency_steps=((1, 7),))).news()["columns"]


def test_of_very_many_marks_some_are_drawn_up_to_the_end(made_up, page_of):
    events = [{"t": 1e-4 * k, "kind": "write", "theta": [1.0, 0.75]} for k in range(30_000)]
    packed = page_of(made_up(events=events)).news()["columns"]["r0 write"]
    t = np.frombuffer(base64.b64decode(packed["x"]["f8"]))
    assert 4000 < len(t) <= 5000
    assert t[-1] > 2.99


def test_hostile_names_stay_text(made_up, page_of):
    shown = made_up(about=HOSTILE, events=[{"t": 0.1, "kind": "veto", "reason": HOSTILE}])
    html = page_of(shown).html()
    assert HOSTILE not in html
    assert "<img" not in html
    assert HOSTILE in str(data_of(html))


@pytest.mark.full_but("nan")
@pytest.mark.parametrize(
    "columns",
    [
        {"plant_phi": [np.nan] * 100, "controller_m": [np.nan] * 100, "plant_m": [np.nan] * 100},
        {"plant_phi": [1e300] * 50 + [-1e300] * 50, "controller_m": [1e300] * 100, "held_plant.u": [np.inf] * 100},
        {"plant_phi": [0.0] * 100, "reference_phi_ref": [0.0] * 100, "controller_m": [-1.0] * 100},
    ],
    ids=["nan", "huge", "constant"],
)
def test_whatever_the_values_there_is_a_page(made_up, page_of, columns):
    page = page_of(made_up(**columns))
    assert "</html>" in page.html()
    to_json(page.news())


@pytest.mark.full
def test_events_that_make_no_sense_are_survived(made_up, page_of, tmp_path):
    odd = ["text", [1], {"a": 1}, None, 1e999, True, -1]
    keys = (
        "kind",
        "reason",
        "theta",
        "std",
        "cost",
        "size",
        "fault",
        "sensor",
        "scores",
        "explained",
        "n_samples",
        "terms",
        "dead_time",
    )
    events = [{"t": 0.1 * k, key: value} for key in keys for k, value in enumerate(odd)]
    events += [event | {"kind": kind} for kind in ("trigger", "candidate", "evidence", *SIGNS) for event in events]
    weighed = {"t": 0.5, "kind": "evidence", "scores": {"nothing": 2.0, "both": 1.0}}
    events += [weighed | {key: value} for key in ("explained", "n_samples") for value in odd]
    events += [weighed | {"scores": {"nothing": value, "both": 1.0}} for value in odd]
    events += [{"t": 0.5, "kind": "disturbance", "size": {"plant.phi": value}} for value in odd]
    (tmp_path / "events.jsonl").write_text("".join(json.dumps(event) + "\n" for event in events))
    page = page_of(made_up(events=read_events(tmp_path)))
    assert "</html>" in page.html()
    to_json(page.news())


@pytest.mark.full
def test_a_million_rows_make_a_small_page_that_has_the_peak(made_up, page_of):
    phi = np.sin(np.arange(1_000_000) / 1e5)
    phi[765_432] = 3.0
    page = page_of(made_up(1_000_000, plant_phi=phi))
    html = page.html()
    assert len(html) < 3_000_000
    packed = page.news()["columns"]["r0 plant.phi"]["plant.phi 0"]["f8"]
    assert np.frombuffer(base64.b64decode(packed)).max() == 3.0


@pytest.mark.full
@pytest.mark.fmu
def test_the_report_of_the_quadrotor_is_small_enough_to_send(tmp_path):
    for name in ("target", "none", "true"):
        run("quadrotor", name, 0, tmp_path / ("run" if name == "target" else f"run/{name}"))
    assert len(read_page([tmp_path / "run"]).html()) < 3_000_000


def test_a_folder_without_a_run_is_named(tmp_path):
    with pytest.raises(FolderError, match="holds no run"):
        run_folders(tmp_path)
    with pytest.raises(FolderError, match="No such file"):
        run_folders(tmp_path / "gone")


def test_a_run_folder_without_its_manifest_is_not_taken_for_a_folder_of_its_baselines(tmp_path):
    (tmp_path / "series.arrow").touch()
    (tmp_path / "none").mkdir()
    (tmp_path / "none" / "manifest.json").touch()
    with pytest.raises(FolderError, match=r"is no run folder: cannot read manifest.json: No such file"):
        read_page(run_folders(tmp_path))


@pytest.mark.full
@pytest.mark.fmu
@pytest.mark.parametrize(("estimator", "seed", "is_one"), [("none", 0, True), ("none", 7, False), ("ukf", 0, False)])
def test_only_the_nominal_controllers_run_of_the_same_seed_and_scenario_is_the_baseline(
    tmp_path, estimator, seed, is_one
):
    short = Scenario.load("pendulum", {"scenario.stop_time": "0.5", "scenario.isolation": "none"})
    run(short, "target", 0, tmp_path / "run")
    run(short, estimator, seed, tmp_path / "run" / "none")
    other = Scenario.load("pendulum", {"scenario.stop_time": "0.4", "scenario.isolation": "none"})
    run(other, "true", 0, tmp_path / "run" / "true")
    (baselines,) = read_page([tmp_path / "run"]).baselines.values()
    assert list(baselines) == (["none"] if is_one else [])


@pytest.mark.full
@pytest.mark.fmu
def test_a_list_of_runs_has_a_row_for_each_a_damaged_one_too(recorded, tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        for path in recorded.glob("*.json"):
            (tmp_path / name / path.name).write_bytes(path.read_bytes())
    (tmp_path / "b" / "manifest.json").write_text("{}")
    whole, damaged = (listed(folder) for folder in run_folders(tmp_path))
    result = json.loads((recorded / "result.json").read_text())
    assert whole.cells[:6] == ("a", "pendulum", "target", 0, "done", sum(result["mse"]))
    assert "holds no readable run" in str(damaged.cells[4])
