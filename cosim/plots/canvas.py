"""Elements shared by all figures: labels, axes that accept any data, PNG and SVG files written atomically."""

import re
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from ..files import write_bytes
from .ranges import AxisLimits

_DPI: Final = 120
_STEPS: Final = (1, 2, 2.5, 5, 10)
_GREEK: Final = frozenset(
    [
        "alpha",
        "beta",
        "gamma",
        "delta",
        "epsilon",
        "zeta",
        "eta",
        "theta",
        "kappa",
        "lambda",
        "mu",
        "nu",
        "xi",
        "rho",
        "sigma",
        "tau",
        "phi",
        "chi",
        "psi",
        "omega",
        "Gamma",
        "Delta",
        "Theta",
        "Lambda",
        "Xi",
        "Sigma",
        "Phi",
        "Psi",
        "Omega",
    ]
)
_SUPERSCRIPTS: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of that size [inch], which belongs to no global state."""
    figure = Figure(figsize=(width, height), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_png(figure: Figure, path: Path) -> Path:
    """Write the figure atomically; return the path. Raises FolderError."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    write_bytes(path, buffer.getvalue())
    return path


def save_svg(figure: Figure, path: Path) -> Path:
    """Write the figure atomically as SVG, the same bytes for the same figure; return the path. Raises FolderError."""
    buffer = BytesIO()
    with rc_context({"svg.hashsalt": "fmu-retune"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    write_bytes(path, buffer.getvalue())
    return path


def tidy(axes: Axes) -> None:
    """Draw a light grid below the data, and no frame above and to the right."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=9)


def top_legend(figure: Figure, handles: Mapping[str, Any], n_columns: int, title: str | None = None) -> None:
    """Draw a legend above all axes, where it covers no data; handles: by text."""
    figure.legend(
        handles.values(), handles.keys(), loc="outside upper center", ncols=n_columns, frameon=False, fontsize=9,
        columnspacing=1.3, handlelength=2.2, handletextpad=0.5, title=title, title_fontsize=10,
    )  # fmt: skip


def label(name: str, unit: str | None = None) -> str:
    """Return the axis label of a variable: `J_x`, `kg.m2` becomes J with an index and [kg m²]."""
    short = name if len(name) <= 28 else f"{name[:14]}…{name[-13:]}"
    return with_unit(symbol(name) or short.replace("$", r"\$"), unit)


def with_unit(text: str, unit: str | None) -> str:
    """Return the text and, if there is one, the FMI unit as it is printed."""
    return text if unit in (None, "", "1") else f"{text} [{_unit_text(unit)}]"


def symbol(name: str) -> str | None:
    """Return a name such as `phi` or `J_x` in mathematical type; None for any other."""
    match = re.fullmatch(r"([A-Za-z]+?)(?:_([A-Za-z0-9]{1,4}))?", name)
    if match is None or not (len(match[1]) == 1 or match[1] in _GREEK):
        return None
    letter = f"\\{match[1]}" if match[1] in _GREEK else match[1]
    index = match[2] if match[2] is None or len(match[2]) < 3 else rf"\mathrm{{{match[2]}}}"
    return f"${letter}$" if index is None else f"${letter}_{{{index}}}$"


def _unit_text(unit: str) -> str:
    raised = re.sub(r"(?<=[A-Za-z])-?\d+", lambda m: m[0].translate(_SUPERSCRIPTS), unit)
    return raised.replace(".", " ").replace("$", r"\$")


def set_linear(axes: Axes, limits: AxisLimits, margin: float = 0.06) -> AxisLimits:
    """Set a linear y axis over the limits and a margin; return the range shown."""
    low, high = limits
    width = high - low or 0.1 * abs(high) or 1.0
    shown = (low - margin * width, high + margin * width)
    axes.set_ylim(*shown)
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=_STEPS))
    return shown


def set_log(axes: Axes, which: Literal["x", "y"], limits: AxisLimits, margin: float = 0.06) -> AxisLimits:
    """Set a logarithmic axis over the limits > 0 and a margin of their logarithm, with ticks as plain numbers."""
    low, high = limits
    widening = max(high / low, 1.05) ** margin
    shown = (low / widening, high * widening)
    axis = axes.xaxis if which == "x" else axes.yaxis
    (axes.set_xscale if which == "x" else axes.set_yscale)("log")
    (axes.set_xlim if which == "x" else axes.set_ylim)(*shown)
    axis.set_major_locator(FixedLocator(list(_log_ticks(*shown))))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(_tick_text))
    return shown


def _log_ticks(low: float, high: float) -> Sequence[float]:
    """Return between three and about eight ticks: decades, or 1-2-5, or round steps inside a decade."""
    exponents = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    for digits in ((1.0,), (1.0, 2.0, 5.0)):
        ticks = [d * 10.0**k for k in exponents for d in digits if low <= d * 10.0**k <= high]
        if len(ticks) >= 3:
            return ticks[:: -(-len(ticks) // 8)]
    return [t for t in MaxNLocator(5, steps=_STEPS).tick_values(low, high) if low <= t <= high]


def _tick_text(value: float, _: int | None) -> str:
    if 1e-3 <= value < 1e4:
        return f"{value:g}"
    exponent = int(np.floor(np.log10(value) + 1e-9)) if value > 0.0 else 0
    digit = f"{value / 10.0**exponent:.3g}"
    power = f"10^{{{exponent}}}"
    return f"${power}$" if digit == "1" else rf"${digit}\cdot{power}$"
