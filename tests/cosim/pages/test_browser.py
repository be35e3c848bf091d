"""The pages in a real browser: Debian's Chromium, headless."""

import functools
import json
import os
import shutil
import subprocess
import sys
import threading

import numpy as np
import pytest
from PIL import Image

from cosim.pages.list_page import link_from, list_html, listed, run_folders
from cosim.pages.runs_page import read_page
from cosim.pages.server import PageServer
from cosim.pages.watched import WatchedRuns

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
HOSTILE = "</script><img src=http://evil.example/x onerror=alert(1)>$$x$$"

pytestmark = [
    pytest.mark.full,
    pytest.mark.fmu,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt-get install chromium"),
]


@pytest.fixture(scope="module")
def chromium():
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as driver:
        # As root there is no sandbox; a page of ours loads nothing that is not in it.
        browser = driver.chromium.launch(executable_path=CHROMIUM, chromium_sandbox=os.geteuid() != 0)
        yield browser
        browser.close()


@pytest.fixture
def opened(chromium):
    """opened(address): the page, ready; at the end nothing has been asked for but the page and what is its server's,
    and nothing is in the console but that Bokeh is ready."""
    pages, asked, said = [], [], []

    def open_page(address):
        page = chromium.new_page(viewport={"width": 1200, "height": 900})
        pages.append((page, address))
        page.on("request", lambda request: asked.append(request.url))
        page.on("console", lambda message: said.append((message.type, message.text)))
        page.on("pageerror", lambda error: said.append(("error", str(error))))
        page.on("dialog", lambda dialog: said.append(("error", dialog.message)))
        page.goto(address)
        page.wait_for_selector("body[data-ready]")
        return page

    yield open_page
    for page, address in pages:
        page.close()
        assert [url for url in asked if not url.startswith(address)] == []
    assert [(kind, text) for kind, text in said if kind != "info"] == []


def written(folder, html):
    path = folder / "page.html"
    path.write_text(html)
    return path.as_uri()


def place(page, name, x, y):
    """Where a point of the picture of that name is in the window [pixels]; y: a number, or the name of a row."""
    script = """([name, x, y]) => {
        const view = Bokeh.index.find_one(Bokeh.documents[0].get_model_by_name(name));
        view.el.scrollIntoView({block: "center"});
        const box = view.canvas_view.el.getBoundingClientRect();
        return [box.left + view.frame.x_scale.compute(x), box.top + view.frame.y_scale.compute(y)];
    }"""
    return page.evaluate(script, [name, x, y])


def shown(page):
    """The time that all pictures show, from and to [s]."""
    script = """() => Bokeh.documents[0].roots().flatMap((root) => [...root.references()])
        .filter((model) => model.type === "Figure").map((model) => [model.x_range.start, model.x_range.end])"""
    ranges = page.evaluate(script)
    assert len(ranges) > 5
    assert all(each == ranges[0] for each in ranges)
    return ranges[0]


@pytest.fixture
def report(recorded, tmp_path, opened):
    return opened(written(tmp_path, read_page([recorded]).html()))


def test_a_report_opens_without_a_word_or_a_request_and_is_not_blank(report, tmp_path):
    report.screenshot(path=tmp_path / "page.png", full_page=True)
    colours = Image.open(tmp_path / "page.png").convert("RGB").getcolors(1_000_000)
    drawn = {colour for n, colour in colours if n > 100}
    assert {(0, 114, 178), (213, 94, 0)} <= drawn  # re-tuned and nominal
    assert report.title() == "pendulum"
    assert "kept the loop to its end" in report.inner_text(".verdict")


def test_the_reason_of_an_event_shows_below_the_cursor(report, recorded):
    events = [json.loads(line) for line in (recorded / "events.jsonl").read_text().splitlines()]
    first = next(e for e in events if e["kind"] == "trigger")
    x, y = place(report, "events", first["t"], "noticed")
    report.mouse.move(x + 3, y + 3)
    report.mouse.move(x, y)
    report.wait_for_selector(f"text={first['reason']}")


def test_the_evidence_of_a_hypothesis_shows_below_the_cursor(report, recorded):
    events = [json.loads(line) for line in (recorded / "events.jsonl").read_text().splitlines()]
    first = next(e for e in events if e["kind"] == "evidence")
    scores = [score for score in first["scores"].values() if score is not None]
    worse = first["scores"]["nothing"] - min(scores)
    x, y = place(report, "evidence: worse than\nthe best by", first["t"], worse)
    report.mouse.move(x + 3, y + 3)
    report.mouse.move(x, y)
    report.wait_for_selector(f"text=nothing has changed: worse than the best by {worse:.3g}")


def test_the_value_of_a_curve_shows_below_the_cursor(report, recorded):
    run = read_page([recorded]).main[0].run
    x, y = place(report, "phi [rad]", float(run.time[60]), float(run["plant.phi"][60]))
    report.mouse.move(x + 3, y)
    report.mouse.move(x, y)
    report.wait_for_selector("text=at 0.6 s")


def test_all_pictures_zoom_together_and_back(report, becomes_true):
    whole = shown(report)
    (left, y), (right, _) = (place(report, "phi [rad]", t, 1.05) for t in (0.3, 0.6))
    report.mouse.move(left, y)
    report.mouse.down()
    report.mouse.move(right, y + 20, steps=20)
    report.mouse.up()
    assert becomes_true(lambda: report.evaluate("Bokeh.documents[0].get_model_by_name('events').x_range.start > 0.2"))
    assert shown(report) == pytest.approx([0.3, 0.6], abs=0.01)
    report.locator(".bk-tool-icon-reset").first.click()
    assert becomes_true(lambda: report.evaluate("Bokeh.documents[0].get_model_by_name('events').x_range.start === 0"))
    assert shown(report) == whole


def test_a_run_is_hidden_and_shown_by_its_tick(report):
    script = """(key) => page.renderers[key].map((id) => Bokeh.documents[0].get_model_by_id(id).visible)"""
    assert all(report.evaluate(script, "r0-none"))
    report.uncheck('input[data-run="r0-none"]')
    assert not any(report.evaluate(script, "r0-none"))
    assert all(report.evaluate(script, "r0"))
    report.check('input[data-run="r0-none"]')
    assert all(report.evaluate(script, "r0-none"))


def test_hostile_names_run_nothing_and_load_nothing(made_up, page_of, tmp_path, opened):
    events = [{"t": 0.1, "kind": "veto", "reason": HOSTILE}]
    page = opened(written(tmp_path, page_of(made_up(about=HOSTILE, events=events)._replace(text=HOSTILE)).html()))
    assert HOSTILE in page.inner_text(".about")
    x, y = place(page, "events", 0.1, "refused by the guard")
    page.mouse.move(x + 3, y + 3)
    page.mouse.move(x, y)
    page.wait_for_selector("text=0.1 s: </script>")
    assert page.locator("img").count() == 0


def test_a_list_is_searched_and_sorted(recorded, tmp_path, opened):
    for k in (0, 1, 2):
        shutil.copytree(recorded, tmp_path / "all" / f"run-{k}")
    shutil.copytree(recorded / "none", tmp_path / "all" / "other")
    folders = run_folders(tmp_path / "all")
    rows = [listed(folder) for folder in folders]
    page = opened(written(tmp_path, list_html("all", rows, link_from(tmp_path / "page.html"))))

    def names():
        return page.evaluate("[...document.querySelectorAll('#rows tr:not(.hidden)')].map((r) => r.cells[0].innerText)")

    assert names() == ["other", "run-0", "run-1", "run-2"]
    page.fill("#filter", "target run")
    assert names() == ["run-0", "run-1", "run-2"]
    assert page.inner_text("#n-shown") == "3"
    page.fill("#filter", "")
    page.click("#runs th:nth-child(6)")
    assert names()[3] == "other"
    page.click("#runs th:nth-child(6)")
    assert names()[0] == "other"


def test_a_page_grows_with_the_run_and_keeps_what_was_chosen(recorded, tmp_path, opened, becomes_true):
    folder = tmp_path / "run"
    folder.mkdir()
    for name in ("series.arrow", "events.jsonl"):
        content = (recorded / name).read_bytes()
        (folder / name).write_bytes(content[: int(len(content) * 0.7)])
    manifest = json.loads((recorded / "manifest.json").read_text())
    kept = {k: v for k, v in manifest.items() if k not in ("seal", "signature", "sha256")}
    (folder / "manifest.json").write_text(json.dumps(kept | {"status": "running"}))
    server = PageServer({"": WatchedRuns([folder])})
    thread = threading.Thread(target=server.serve)
    thread.start()
    try:
        page = opened(server.address)
        rows = functools.partial(page.evaluate, "Bokeh.documents[0].get_model_by_name('r0').data.t.length")
        n = rows()
        shutil.copytree(recorded, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("none"))
        assert becomes_true(lambda: "has ended" in page.inner_text("#state"))
        assert rows() == 121 > n
        assert "kept the loop to its end" in page.inner_text(".verdict")
    finally:
        server.shutdown()
        thread.join()


def test_a_run_that_is_watched_has_the_same_bits_and_outlives_the_page(recorded, tmp_path, opened, becomes_true):
    settings = {"scenario.stop_time": "1.2", "changes": '{"plant.m" = [[0.0, 1.75], [0.05, 4.271]]}'}
    command = [sys.executable, "-m", "cosim.cli", "run", "pendulum", "--only", "--view", "--out", tmp_path / "run"]
    command += [part for key, value in settings.items() for part in ("--set", f"{key}={value}")]
    # The viewer opens a browser that does nothing: `true`.
    running = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=os.environ | {"BROWSER": "true"})
    assert running.stderr is not None
    page = opened(running.stderr.readline().strip())
    assert becomes_true(lambda: "has ended" in page.inner_text("#state"))
    assert running.wait(timeout=60) == 0
    assert running.stderr.read() == ""  # to its end: the viewer has ended, too
    running.stderr.close()
    for name in ("series.arrow", "events.jsonl"):
        assert (tmp_path / "run" / name).read_bytes() == (recorded / name).read_bytes()
    assert np.ptp(page.evaluate("[...Bokeh.documents[0].get_model_by_name('r0').data.t]")) == pytest.approx(1.2)
