"""Files in an FMU for its users: documentation/index.html, the licences, the icon. Standard library only."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.metadata import distribution
from pathlib import Path

from .kernel.description import VariableRow
from .kernel.theory import Theory

LICENSE = Path(__file__).with_name("LICENSE")
_STYLE = (
    "body{font-family:sans-serif;max-width:60em;margin:2em auto;padding:0 1em;line-height:1.4}"
    ".equation{font-family:serif;font-size:115%;margin-left:2em}"
    "table{border-collapse:collapse}td,th{border:1px solid #bbb;padding:.15em .5em;text-align:left}"
)


@dataclass(frozen=True)
class Page:
    """Content of an FMU's documentation."""

    name: str
    """Name of the model."""
    summary: str
    """Summary in one sentence."""
    theory: Theory
    """Equations of the model."""
    variables: Sequence[VariableRow]
    """Table of variables."""
    icon: bytes | None = None
    """Icon, a PNG picture; None for an FMU without one."""

    def html(self) -> str:
        """Return the model's documentation, self-contained HTML."""
        lines = "".join(f'<p class="equation">{equation}</p>\n' for equation in self.theory.equations)
        rows = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in _cells(v))}</tr>\n" for v in self.variables)
        heads = "".join(f"<th>{head}</th>" for head in ("Name", "Unit", "Kind", "Start", "Range", "Description"))
        source = f"<p>{self.theory.source}</p>" if self.theory.source else ""
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f"<title>{self.name}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
            f"<h1>{self.name}</h1>\n<p>{escape(self.summary)}</p>\n"
            f"<h2>Equations</h2>\n{lines}<p>{self.theory.notes}</p>\n{source}\n"
            f"<h2>Behaviour</h2>\n<p>{_behaviour(self.variables)}</p>\n"
            f"<h2>Variables</h2>\n<table>\n<tr>{heads}</tr>\n{rows}</table>\n"
            "<p>MIT licence: see the folder licenses.</p>\n</body>\n</html>\n"
        )


def files(page: Page, fmi: int, libraries: Sequence[str]) -> dict[str, bytes]:
    """Return the files for users by their paths in the FMU.

    fmi: 2 or 3, for the icon's place;  libraries: the distributions whose code the FMU holds beside ours.
    """
    licences = {name: distribution(name).read_text("licenses/LICENSE") or "" for name in libraries}
    return {
        "documentation/index.html": page.html().encode(),
        "documentation/licenses/license.txt": LICENSE.read_bytes(),
        **{f"documentation/licenses/{library}.txt": text.encode() for library, text in licences.items()},
        **({} if page.icon is None else {"model.png": page.icon} if fmi == 2 else _terminals_and_icons(page.icon)),
    }


def _terminals_and_icons(icon: bytes) -> dict[str, bytes]:
    """Return the icon, and the file with its size, by their paths. FMI 3.0.1, section 2.6."""
    xml = (
        '<?xml version="1.0" encoding="UTF-8"?>\n<fmiTerminalsAndIcons fmiVersion="3.0">\n  <GraphicalRepresentation>\n'
        '    <CoordinateSystem x1="-100" y1="-100" x2="100" y2="100" suggestedScalingFactorTo_mm="0.1"/>\n'
        '    <Icon x1="-100" y1="-100" x2="100" y2="100"/>\n'
        "  </GraphicalRepresentation>\n</fmiTerminalsAndIcons>\n"
    )
    return {"terminalsAndIcons/icon.png": icon, "terminalsAndIcons/terminalsAndIcons.xml": xml.encode()}


def _cells(v: VariableRow) -> tuple[str, ...]:
    start = "" if v.start is None else str(v.start).lower() if v.type == "Boolean" else f"{v.start:.10g}"
    low, high = ("" if bound is None else f"{bound:g}" for bound in (v.min, v.max))
    span = f"{low or '−∞'} … {high or '∞'}" if low or high else ""
    return (escape(v.name), v.unit or "Boolean", f"{v.variability} {v.causality}", start, span, escape(v.description))


def _behaviour(variables: Sequence[VariableRow]) -> str:
    n_states = sum(v.derivative is not None for v in variables)
    if any(v.name == "max_step" for v in variables):
        return (
            f"{n_states} continuous states, integrated over a step by the classical Runge-Kutta method of fourth order "
            "in equal steps of at most max_step. The inputs are held over a step, so no output follows an input at "
            "once; ..._held tells the input that was held. With tau_u above 0 the commands act through actuators with "
            "a lag of first order, which start at the first command; ..._held tells the command, and disturbances have "
            "no lag. Tunable parameters may be changed between steps."
        )
    if n_states:
        return (
            f"{n_states} continuous states. The actuators have no lag, unlike those of the co-simulation FMU. Tunable "
            "parameters may be changed in event mode."
        )
    if any(v.causality == "input" for v in variables):
        return "Memoryless: the outputs are functions of the inputs and parameters of the moment."
    return "A function of time. Tunable parameters may be changed between steps."
