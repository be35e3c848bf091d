"""The server of growing pages: it answers who knows the token, on this machine, and reads no more than the store."""

import http.client
import json
import shutil
import threading

import pytest

from cosim.errors import FolderError
from cosim.pages.server import PageServer
from cosim.pages.watched import WatchedList, WatchedRuns


class Stub:
    """A page whose news are given."""

    def __init__(self, **news):
        self.told = {"is_final": False, **news}

    def html(self):
        return "<p>page</p>"

    def news(self, since):
        if "error" in self.told:
            raise FolderError(self.told["error"])
        return {"since": since, **self.told}


@pytest.fixture
def serving():
    """serving(pages): a server in a thread, which is ended."""
    servers = []

    def serve(pages):
        server = PageServer(pages)
        thread = threading.Thread(target=server.serve)
        thread.start()
        servers.append((server, thread))
        return server

    yield serve
    for server, thread in servers:
        server.shutdown()
        thread.join()


def asked(server, path, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=20)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    content = answer.read().decode()
    connection.close()
    return answer.status, content


def test_a_page_is_for_those_who_know_its_address(serving):
    server = serving({"": Stub(), "run/0": Stub(is_final=True)})
    token = server.token
    assert server.server_address[0] == "127.0.0.1"
    assert len(token) >= 32
    assert asked(server, f"/{token}/") == (200, "<p>page</p>")
    assert asked(server, f"/{token}/run/0/") == (200, "<p>page</p>")
    assert json.loads(asked(server, f"/{token}/data?since=7")[1]) == {"since": "7", "is_final": False}
    for path in (
        "/",
        "/data",
        f"/{token[:-1]}/",
        f"/{token}x/",
        f"/{token}/run/1/",
        f"/{token}/../../etc/passwd",
        "//",
    ):
        assert asked(server, path) == (404, "there is no such page"), path
    for host in ("evil.example", f"evil.example:{server.server_port}", ""):
        assert asked(server, f"/{token}/", Host=host)[0] == 404, host


def test_what_cannot_be_read_just_now_is_told_in_one_line(serving):
    server = serving({"": Stub(error="runs/x is damaged")})
    assert asked(server, f"/{server.token}/data") == (503, "runs/x is damaged")


def test_two_servers_have_two_addresses(serving):
    one, other = serving({"": Stub()}), serving({"": Stub()})
    assert one.token != other.token
    assert one.server_port != other.server_port


@pytest.mark.parametrize("case", ["a page has all", "nobody asks"])
def test_the_viewer_of_a_run_ends_by_itself(case):
    server = PageServer({"": Stub(is_final=True)})
    thread = threading.Thread(target=server.serve_until_end, args=(lambda: case == "nobody asks", 0.0))
    thread.start()
    if case == "a page has all":
        asked(server, f"/{server.token}/data?since=1&has=all")
    thread.join(timeout=20)
    assert not thread.is_alive()


@pytest.fixture
def growing(recorded, tmp_path):
    """growing(share): a run folder that holds that share of the rows and events of a run; 1 for the whole."""

    def grow(share):
        if share == 1:
            shutil.copytree(recorded, tmp_path, dirs_exist_ok=True)
            return tmp_path
        for name in ("series.arrow", "events.jsonl"):
            content = (recorded / name).read_bytes()
            (tmp_path / name).write_bytes(content[: int(len(content) * share)])
        manifest = json.loads((recorded / "manifest.json").read_text())
        kept = {k: v for k, v in manifest.items() if k not in ("seal", "signature", "sha256")}
        (tmp_path / "manifest.json").write_text(json.dumps(kept | {"status": "running"}))
        return tmp_path

    return grow


@pytest.mark.full
@pytest.mark.fmu
def test_a_page_gets_what_is_new_and_only_that(growing, leaves_nothing):
    watched = WatchedRuns([growing(0.7)])
    assert "connect-src 'self'" in watched.html()
    first = watched.news("")
    assert not first["is_final"]
    assert "was stopped at" in first["parts"]["above"]
    assert "columns" not in watched.news(first["version"])
    growing(1)
    last = watched.news(first["version"])
    assert last["is_final"]
    assert last["state"] == "The run has ended: the page is complete."
    assert len(last["columns"]["r0"]["t"]["f8"]) > len(first["columns"]["r0"]["t"]["f8"])
    assert watched.news(last["version"])["is_final"]


@pytest.mark.full
@pytest.mark.fmu
def test_looking_changes_nothing_in_the_folder(growing):
    folder = growing(0.7)
    before = {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in folder.iterdir()}
    watched = WatchedRuns([folder])
    watched.html()
    watched.news("")
    assert {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in folder.iterdir()} == before


@pytest.mark.full
@pytest.mark.fmu
def test_a_thousand_runs_are_listed_and_looked_at_again_only_where_they_changed(recorded, tmp_path):
    folders = [tmp_path / f"{k:04}" for k in range(1000)]
    for folder in folders:
        folder.mkdir()
        for name in ("manifest.json", "result.json"):
            (folder / name).symlink_to(recorded / name)
    watched = WatchedList("study", folders)
    assert "</span> of 1000 runs" in watched.html()
    first = watched.news("")
    assert first["parts"]["rows"].count("<tr>") == 1000
    assert "parts" not in watched.news(first["version"])
    (folders[3] / "manifest.json").unlink()
    assert "0003 is no run folder" in watched.news(first["version"])["parts"]["rows"]
