"""What is in an FMU for people: pages, licences, icons."""

import io
import zipfile
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path

import fmpy
import numpy as np
import pytest
from lxml import etree
from PIL import Image

from fmu_models import build, documentation
from fmu_models.equations import EQUATIONS
from fmu_models.icon import SIZE, Stroke, _rasterized, png
from fmu_models.pendulum_fmu import Pendulum

KINDS = [
    *(pytest.param(name, 2, "CoSimulation", id=f"{name}-2") for name in build.NAMES),
    *(pytest.param(name, 3, "CoSimulation", id=f"{name}-3") for name in ("Quadrotor", "PendulumController")),
    *(pytest.param(name, 3, "ModelExchange", id=f"{name}-3-me") for name in ("Quadrotor", "Pendulum")),
]
VOID = {"meta", "br"}


class Page(HTMLParser):
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


@pytest.fixture(scope="module")
def files_of(tmp_path_factory):
    """Contents by path of an FMU of that kind."""
    folder = tmp_path_factory.mktemp("fmus")

    def read(*kind):
        with zipfile.ZipFile(build.build(kind[0], folder / "-".join(map(str, kind)), *kind[1:])) as archive:
            return {name: archive.read(name) for name in archive.namelist()}

    return read


@pytest.mark.parametrize(("name", "fmi", "interface"), KINDS)
def test_an_fmu_holds_its_page_its_licences_and_its_icon(files_of, name, fmi, interface):
    files = files_of(name, fmi, interface)
    page = Page(files["documentation/index.html"].decode())
    assert page.links == []
    model = getattr(import_module(f"fmu_models.{build._SCRIPTS[name]}"), name)
    table = model.exchange_table() if interface == "ModelExchange" else model.variables
    for v in table:
        assert {v.name, v.unit or "Boolean", f"{v.variability} {v.causality}", v.description} <= set(page.texts)
    assert files["documentation/licenses/license.txt"] == Path(__file__).parents[2].joinpath("LICENSE").read_bytes()
    assert b"Permission is hereby granted" in files["documentation/licenses/pythonfmu.txt"]
    assert ("documentation/licenses/pythonfmu3.txt" in files) == (fmi == 3)
    assert files["model.png" if fmi == 2 else "terminalsAndIcons/icon.png"] == png(name)
    assert not [path for path in files if path.startswith("sources/")]


def test_the_terminals_and_icons_of_fmi_3_are_valid(files_of):
    schema = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd"
    text = files_of("Pendulum", 3, "CoSimulation")["terminalsAndIcons/terminalsAndIcons.xml"]
    etree.XMLSchema(etree.parse(schema)).assertValid(etree.fromstring(text))


@pytest.mark.parametrize("name", build.NAMES)
def test_an_icon_is_a_picture(name):
    image = np.asarray(Image.open(io.BytesIO(png(name))))  # Pillow's decoder, not our encoder
    assert image.shape == (SIZE, SIZE, 4)
    alpha = image[..., 3]
    assert alpha[0, 0] == 0
    assert 0.05 < (alpha == 255).mean() < 0.5
    assert len({tuple(pixel) for pixel in image[alpha == 255]}) >= 3  # dark, grey and a colour
    assert png.__wrapped__(name) == png(name)


def test_an_icon_says_plant_or_controller_or_reference():
    assert len({png(name) for name in ("Pendulum", "PendulumController", "PendulumReference", "Quadrotor")}) == 4


def test_every_model_has_its_equations():
    assert set(EQUATIONS) == set(build.NAMES)
    for equations, notes, _ in EQUATIONS.values():
        assert equations
        assert notes


def test_a_stroke_has_its_width_and_a_soft_edge():
    """A line of 10 pixels at 45 degrees covers length times width, and its round ends: 10 d + pi 10^2 / 4."""
    row = np.array(_rasterized([Stroke((0.25, 0.25), (0.75, 0.75), 10 / SIZE, (255, 0, 0))])).reshape(SIZE, SIZE, 4)
    area = row[..., 3].sum() / 255.0
    assert area == pytest.approx(10 * SIZE / 2 * np.sqrt(2) + np.pi * 25, rel=0.01)


def test_a_page_escapes_what_is_no_markup():
    page = documentation.page("Pendulum", "1 < 2 & 3", Pendulum.variables)
    assert "1 &lt; 2 &amp; 3" in page
