"""The frame of every page: one file, whose script and style are in it, and which may ask for nothing."""

import json
import secrets
from functools import cache
from importlib.resources import files
from typing import Any

from bokeh.resources import Resources
from jinja2 import Environment, PackageLoader, StrictUndefined

from .. import __version__


def rendered(template: str, **content: Any) -> str:
    """Return a page. A nonce and a content security policy keep a browser from any script but ours, and any request."""
    return (
        _environment()
        .get_template(template)
        .render(
            nonce=secrets.token_urlsafe(16),
            version=__version__,
            css=_text("page.css"),
            script=_text("page.js"),
            bokeh=_bokeh() if content.pop("has_plots") else "",
            **content,
        )
    )


def rendered_part(template: str, **content: Any) -> str:
    """Return a part of a page."""
    return _environment().get_template(template).render(**content)


def script_data(content: Any) -> str:
    """Return JSON that stands in a page's script element, whatever texts are in it."""
    return json.dumps(content, allow_nan=False).replace("<", "\\u003c")


@cache
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("cosim.pages"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )


@cache
def _bokeh() -> str:
    """Return Bokeh's script, without its mathematical type, widgets and tables."""
    (script,) = Resources(mode="inline", components=["bokeh"]).js_raw[:1]
    return script.replace("</script", "<\\/script")


@cache
def _text(name: str) -> str:
    return (files("cosim.pages") / "templates" / name).read_text(encoding="utf-8")
