"""Times in a draft scenario, of the default experiments that its FMUs declare: see `draft`."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import floor, isclose, isfinite, log10
from typing import Final

from ..fmi.component import Component
from .guess import CONTROLLER, PLANT, REFERENCE
from .toml_lines import quoted, said

_STOP_TIME: Final = 10.0  # s, where no FMU says any
_STEPS: Final = 1000  # of a run, where no FMU says a step
_MOST_STEPS: Final = 1e9  # of a scenario
_SHORTEST: Final = 1e-12  # s, of a run


@dataclass(frozen=True)
class Span:
    """Start and stop of a run."""

    start: float
    """Time of the first communication point [s]."""
    stop: float
    """Time of the last one [s]."""
    source: str = ""
    """File that declares them; empty where none does."""

    @property
    def length(self) -> float:
        """Time from start to stop [s]."""
        return self.stop - self.start

    @property
    def is_usable(self) -> bool:
        """True where a scenario can have these times; a schema allows INF, and a stop before the start."""
        return self.length >= _SHORTEST and isfinite(self.length)


def span(components: Mapping[str, Component]) -> Span:
    """Return the times that reference, plant or controller declare, in this order, or a guess."""
    return next((declared for declared in _declared(components) if declared.is_usable), Span(0.0, _STOP_TIME))


def _declared(components: Mapping[str, Component]) -> Iterator[Span]:
    for name in (REFERENCE, PLANT, CONTROLLER):
        experiment = components[name].experiment if name in components else {}
        if "stop_time" in experiment:
            yield Span(experiment.get("start_time", 0.0), experiment["stop_time"], components[name].fmu.name)


def settings(components: Mapping[str, Component]) -> list[str]:
    """Return the lines for name, times and macro step of the scenario."""
    times = span(components)
    step, of_step = _step(components, times.length)
    name = re.sub(r"[^A-Za-z0-9]+", "-", str(components[PLANT].description.modelName)).strip("-").lower()
    of_times = f"s, of {times.source}" if times.source else "s, GUESS"
    return [
        "[scenario]",
        f"name = {quoted(name or 'scenario')}",
        *([said(f"start_time = {times.start!r}", of_times)] if times.start else []),
        said(f"stop_time = {_whole(times, step)!r}", of_times),
        said(f"macro_step = {step!r}", f"s, {f'of {of_step}' if of_step else 'GUESS'}: {_number(times, step):,} steps"),
    ]


def _step(components: Mapping[str, Component], length: float) -> tuple[float, str]:
    """Return the smallest macro step [s] that is declared for a run of this length [s], and whose it is, or a guess."""
    steps = [(c.experiment.get("step_size", 0.0), c.fmu.name) for c in components.values()]
    usable = [(step, name) for step, name in steps if step > length / _MOST_STEPS and isfinite(step)]
    return min(usable, default=(_round(length / _STEPS), ""))


def _round(step: float) -> float:
    """Return the next lower one of 1, 2 and 5 times a power of ten."""
    power = 10.0 ** floor(log10(step) + 1e-9)
    return float(f"{max(n for n in (1, 2, 5) if n * power <= step * (1 + 1e-9)) * power:.3g}")


def _whole(times: Span, step: float) -> float:
    """Return the stop time [s] after a whole number of macro steps: the declared one, where it is such."""
    length = _number(times, step) * step
    return times.stop if isclose(length, times.length, rel_tol=1e-9) else float(f"{times.start + length:.12g}")


def _number(times: Span, step: float) -> int:
    """Return the number of macro steps of a run."""
    return max(1, round(times.length / step))


def rows(times: Span, before: float, after: float) -> str:
    """Return the rows of a change after a third of the run."""
    change = times.start + float(f"{times.length / 3:.3g}")
    return f"[[{times.start!r}, {before!r}], [{change:.12g}, {after:.6g}]]"
