"""The plant of an online replay: samples of its log, and its FMU for roll-outs from them."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from estimator import Sample, Vector

from ..errors import WiringError
from ..fmi.archive import capabilities, has_fixed_step
from ..fmi.component import Component
from ..fmi.ports import Catalogue
from ..fmi.types import is_real
from ..objectives.hidden_states import Suspect, hidden_states
from ..objectives.rollout_fmu import START_METHODS, Shadow, StartMethod, obstacles_in_words
from ..sampling.screen import OutputScreen
from ..scenarios.schema.sampling import ObservationSettings
from .log_windows import LogWindow
from .request import EstimateError, Request
from .rollout import Grid, grid_of, noise_of
from .start_states import MOVING
from .understood import Understood


@dataclass(frozen=True)
class OnlinePlant:
    """The plant of a replay: its FMU and its logs, as a request says."""

    request: Request
    understood: Understood

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """Inputs of the FMU, those without a column last."""
        return (*self.request.inputs, *self._other_inputs)

    @cached_property
    def noise_of_states(self) -> list[float]:
        """Standard deviation of the noise of each state."""
        return noise_of([replace(w, measured=w.states) for w in self.understood.windows]).tolist()

    def screen(self, macro_step: float) -> OutputScreen:
        """Return a screen of the samples; macro_step [s]: between them."""
        of_outputs = dict(zip(self.request.measured, self.understood.noise.tolist(), strict=True))
        of_states = dict(zip(self._states, self.noise_of_states, strict=True))
        return OutputScreen(ObservationSettings(), of_outputs, of_states, macro_step, may_be_missing=True)

    def n_points(self, window: LogWindow) -> int:
        """Return the number of samples of a window. Raises EstimateError, LogError."""
        return len(self._grid(window).times)

    def replayed(self, window: LogWindow, theta: Vector, n_proof: int) -> tuple[list[Sample], Shadow]:
        """Return the samples of a window, in the FMU's time, and the FMU for roll-outs from them.

        Not from measured states, where the first n_proof samples show others that have no column. theta (d,): in use.
        """
        request, understood = self.request, self.understood
        interface: Any = capabilities(understood.component.description)
        samples, u0 = self._samples(window)
        names = {*understood.space.names}
        start = dict(zip(self.inputs, u0, strict=True)) | request.constants | dict(window.start)
        shadow = Shadow(
            request.fmu, self.inputs, self._states, tuple(request.measured), tuple(understood.noise.tolist()),
            understood.space.names, {name: value for name, value in start.items() if name not in names},
            samples[0].t, samples[-1].t, not interface.canBeInstantiatedOnlyOncePerProcess, self.obstacles,
            request.timeout, request.environment, told_by=self._told_by,
        )  # fmt: skip
        suspects = _suspects(understood.component, shadow)
        if "measured" not in self.obstacles and suspects:
            hidden = hidden_states(shadow, samples, theta, suspects, n_proof)
            shadow = shadow if hidden is None else replace(shadow, obstacles={**self.obstacles, "measured": hidden})
        return samples, shadow

    @cached_property
    def obstacles(self) -> dict[StartMethod, str]:
        """Ways of beginning a roll-out that do not work, with reasons. Raises EstimateError where none is left."""
        request, component = self.request, self.understood.component
        obstacles: dict[StartMethod, str] = {"state": "there is only the log"}
        if not self._states:
            obstacles["measured"] = "no --start names the columns of the states"
        elif numbers := [name for name in request.constants if component.variables[name].causality in MOVING]:
            obstacles["measured"] = f"--start gives {numbers[0]} a number, which is no measurement"
        elif any(np.isnan(w.states[0]).any() for w in self.understood.windows):
            obstacles["measured"] = "values are missing in the first row of the states' columns"
        if unknown := [p.name for p in self.understood.space if component.variables[p.name].causality != "parameter"]:
            raise EstimateError(f"--online estimates parameters, and '{unknown[0]}' is none: leave out --online.")
        try:
            Catalogue(request.fmu.name, component.description.modelVariables).ports(
                "tunable parameter", self.understood.space.names
            )
        except WiringError as e:
            obstacles["replay"] = str(e).rstrip(".")
        if len(obstacles) == len(START_METHODS):
            raise EstimateError(f"--online has no way to begin a roll-out: {obstacles_in_words(obstacles)}.")
        return obstacles

    def _grid(self, window: LogWindow) -> Grid:
        """Return the communication points within the window. Raises EstimateError, LogError."""
        step, is_even = self.request.step, has_fixed_step(self.understood.component.description)
        distance = float(np.median(np.diff(window.time)))
        if step is not None and step < 0.99 * distance:
            raise EstimateError(f"--online takes samples {distance:g} s apart: --step must be so long at least.")
        grid = grid_of(window, step, is_even)
        is_beyond = grid.rows is not None and grid.times[-1] > grid.rows[-1] + 1e-9 * distance
        return grid if not is_beyond else grid._replace(times=grid.times[:-1], inputs=grid.inputs[:-1])

    def _samples(self, window: LogWindow) -> tuple[list[Sample], list[float]]:
        """Return a sample for each row, or communication point, in the FMU's time; and the inputs in the first row.

        Inputs that have no column come last.
        """
        (times, inputs, rows), others = self._grid(window), self._other_inputs.values()
        table = np.column_stack([window.states, window.measured])
        if rows is not None:
            table = np.column_stack([np.interp(times, rows, column, right=np.nan) for column in table.T])
        held, n = [inputs[0], *inputs], window.states.shape[1]
        return [
            Sample(t, tuple(row[:n]), (*u, *others), (), tuple(row[n:]))
            for t, u, row in zip(times, held, table.tolist(), strict=True)
        ], [*held[0], *others]

    @cached_property
    def _other_inputs(self) -> dict[str, float]:
        """Values of the inputs without a column: what the log does not show may act on them all the same."""
        request, component = self.request, self.understood.component
        taken = {*request.inputs, *request.start_columns}
        others = [v for v in component.having("input") if is_real(v.type) and v.name not in taken]
        start = {v.name: request.constants.get(v.name, v.start) for v in others}
        return {name: float(value) for name, value in start.items() if value is not None}

    @property
    def _states(self) -> tuple[str, ...]:
        """Variables that start as their column does: the states, if none is missing, which is tested later."""
        return tuple(self.request.start_columns)

    @property
    def _told_by(self) -> dict[str, str]:
        """Output with the column, and the unit, of each parameter that a state starts as."""
        request, component = self.request, self.understood.component
        variables, unit = component.variables, component.unit
        outputs = [(column, unit(name), name) for name, column in request.measured.items()]
        found: dict[str, str] = {}
        for name in self._states:
            same = [output for column, of, output in outputs if (column, of) == (request.start[name], unit(name))]
            if same and variables[name].causality == "parameter":
                found[name] = same[0]
        return found


def _suspects(component: Component, shadow: Shadow) -> list[Suspect]:
    """Return the variables that may be states without a column: with a start value, or a declared derivative."""
    known = {*shadow.states, *shadow.told_by.values()}
    moving = [v for v in component.variables.values() if v.causality in MOVING and is_real(v.type)]
    return [
        Suspect(v.name, float(v.start or 0.0))
        for v in moving
        if v.name not in known
        and v.variability in ("continuous", "discrete")
        and (v.start is not None or v.name in component.derivatives)
    ]
