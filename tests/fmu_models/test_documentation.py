"""What is in an FMU for people: pages, licences, icons."""

import inspect
import zipfile
from html.parser import HTMLParser
from pathlib import Path

import fmpy
import numpy as np
import pytest
from lxml import etree
from PIL import Image

from fmu_models import build
from fmu_models.documentation import Page, files
from fmu_models.kernel.theory import Theory
from fmu_models.pendulum.plant import Pendulum

KINDS = [
    *(pytest.param(2, name, id=f"{name}-2") for name in build.NAMES),
    *(pytest.param(3, name, id=f"{name}-3") for name in ("Quadrotor", "PendulumController")),
    *(pytest.param("me", name, id=f"{name}-3-me") for name in ("Quadrotor", "Pendulum")),
]
VOID = {"meta", "br"}


class Html(HTMLParser):
    """The text of a page whose tags are all closed, in the right order; and whatever it takes from elsewhere."""

    def __init__(self, html):
        super().__init__()
        self.open, self.texts, self.links = [], [], []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.links += [value for key, value in attrs if key in ("src", "href", "srcset", "data")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


def icon_of(name):
    """The picture beside the module of the model's class."""
    return Path(inspect.getfile(build.MODELS[name])).with_suffix(".png")


def page(summary):
    return Page("Pendulum", summary, Theory(("a = b",), "Notes."), Pendulum.variables)


@pytest.fixture
def files_of(built):
    """Contents by path of an FMU of that kind and name."""

    def read(kind, name):
        with zipfile.ZipFile(built[kind][name]) as archive:
            return {path: archive.read(path) for path in archive.namelist()}

    return read


@pytest.mark.parametrize(("kind", "name"), KINDS)
def test_an_fmu_holds_its_page_its_licences_and_its_icon(files_of, kind, name):
    found = files_of(kind, name)
    page = Html(found["documentation/index.html"].decode())
    assert page.links == []
    model = build.MODELS[name]
    table = model.exchange_table() if kind == "me" else model.variables
    for v in table:
        assert {v.name, v.unit or "Boolean", f"{v.variability} {v.causality}", v.description} <= set(page.texts)
    assert found["documentation/licenses/license.txt"] == Path(__file__).parents[2].joinpath("LICENSE").read_bytes()
    assert b"Permission is hereby granted" in found["documentation/licenses/pythonfmu.txt"]
    assert ("documentation/licenses/pythonfmu3.txt" in found) == (kind != 2)
    assert found["model.png" if kind == 2 else "terminalsAndIcons/icon.png"] == icon_of(name).read_bytes()
    assert ("terminalsAndIcons/terminalsAndIcons.xml" in found) == (kind != 2)
    assert not [path for path in found if path.startswith("sources/")]


def test_the_terminals_and_icons_of_fmi_3_are_valid(files_of):
    schema = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd"
    text = files_of(3, "Pendulum")["terminalsAndIcons/terminalsAndIcons.xml"]
    etree.XMLSchema(etree.parse(schema)).assertValid(etree.fromstring(text))


@pytest.mark.parametrize(
    "path", sorted({icon_of(name) for name in build.NAMES}), ids=lambda p: f"{p.parent.name}-{p.stem}"
)
def test_an_icon_is_a_picture_on_a_transparent_ground(path):
    image = np.asarray(Image.open(path).convert("RGBA"))
    assert image.shape[0] == image.shape[1] >= 100  # FMI 3.0.1, section 2.6
    alpha = image[..., 3]
    assert alpha[0, 0] == 0
    assert 0.05 < (alpha == 255).mean() < 0.5


def test_a_plant_a_controller_and_a_reference_have_different_icons():
    names = ("Pendulum", "PendulumController", "PendulumReference", "Quadrotor", "FrictionPendulum")
    assert len({icon_of(name).read_bytes() for name in names}) == len(names)


def test_an_fmu_without_an_icon_has_no_place_for_one():
    for fmi in (2, 3):
        paths = files(page("Nothing"), fmi, ())
        assert sorted(paths) == ["documentation/index.html", "documentation/licenses/license.txt"]


def test_a_page_escapes_what_is_no_markup():
    assert "1 &lt; 2 &amp; 3" in page("1 < 2 & 3").html()


def test_an_adaptive_controller_has_the_equations_of_its_controller_and_says_what_it_adds(files_of):
    texts = [
        Html(files_of(2, name)["documentation/index.html"].decode()).texts
        for name in ("PendulumController", "PendulumControllerAdaptive")
    ]
    equations = [text for text in texts[0] if "φ̈" in text or "sin φ" in text]
    assert equations
    assert set(equations) <= set(texts[1])
    assert not any("update_ready" in text for text in texts[0])
    assert any("used from a step on at which update_ready is true" in text for text in texts[1])
