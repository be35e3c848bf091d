"""The documentation site: built without a warning, notebooks executed; promises have tests, snippets fit."""

import ast
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

from cosim.terminal.options import make_parser
from estimator.events import Event

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(page for page in DOCS.glob("*.md") if not page.name.endswith(".in.md"))


def snippets(page, *languages):
    text = page.read_text(encoding="utf-8")
    return [body for language, body in re.findall(r"^```(\w*)\n(.*?)^```", text, re.M | re.S) if language in languages]


@pytest.mark.full
@pytest.mark.fmu
def test_the_site_is_built_without_a_warning_and_its_notebooks_run(tmp_path):
    pytest.importorskip("myst_nb")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "-q",
        "-b",
        "html",
        "-d",
        tmp_path / "trees",
        DOCS,
        tmp_path / "site",
    ]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr
    pages = [page.read_text(encoding="utf-8") for page in (tmp_path / "site").rglob("*.html")]
    assert len(pages) > 20
    for text in pages:
        fetched = re.findall(r"<(?:script|link|img)[^>]+(?:src|href)=\"(https?:[^\"]+)", text)
        assert fetched == []  # neither fonts nor scripts of others


def test_every_page_is_in_the_table_of_contents():
    sections = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "site").glob("*.md"))
    listed = set(re.findall(r"^\.\./(\S+)$", sections, re.M))
    pages = {page.stem for page in PAGES} | {f"notebooks/{path.stem}" for path in (DOCS / "notebooks").glob("*.ipynb")}
    assert listed - {"generated/command-line"} == pages - {"README", "index"}


def test_every_kind_of_event_is_explained():
    table = (DOCS / "events.md").read_text(encoding="utf-8")
    kinds = {*get_args(get_type_hints(Event)["kind"]), "fault", "interrupt"}
    assert set(re.findall(r"^\| `(\w+)` \|", table, re.M)) == kinds


def test_every_promise_has_a_test_that_there_is():
    promised = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", (DOCS / "promises.md").read_text(encoding="utf-8"))
    assert len(promised) > 12
    for path, name in promised:
        source = (ROOT / path).read_text(encoding="utf-8")
        assert not name or f"def {name}(" in source, f"{path}::{name}"


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda page: page.name)
def test_snippets_are_programs_tables_and_commands_that_there_are(page):
    for text in snippets(page, "python"):
        ast.parse(text)
    for text in snippets(page, "toml"):
        tomllib.loads(text)
    parser = make_parser()
    for text in snippets(page, "sh", ""):
        for line in text.replace("\\\n", " ").splitlines():
            if line.startswith("retune ") and "..." not in line and not re.search(r"\b[A-Z]{3,}\b", line):
                words = shlex.split(re.split(r"[|>]", line)[0], comments=True)[1:]
                if words not in (["--version"],):
                    parser.parse_args(words)
