"""What an importer's script is given and gives back: `python run_<importer>.py JOBS RESULTS`, both JSON.

A variable is named `component.variable` everywhere. Nothing but the standard library is used here.
"""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Job:
    """One co-simulation from t = 0."""

    macro_step: float
    """s."""
    n_steps: int
    """Macro steps."""
    fmus: dict[str, str]
    """Path of each component's FMU."""
    start: dict[str, float]
    """Values before the first step: parameters, states, inputs."""
    connections: dict[str, str]
    """Input = output."""
    changes: dict[str, dict[str, float]]
    """Inputs and tunable parameters that are set at a communication point, by its number (a string, as JSON has it)."""
    outputs: list[str]
    """The columns of the rows that are wanted."""
    options: dict
    """The importer's own settings."""

    def changes_at(self, k: int) -> dict[str, float]:
        """What is set before the step from t_k on."""
        return self.changes.get(str(k), {})

    def of(self, component: str, values: dict) -> dict:
        """Those values whose names belong to the component, by the name within it."""
        return {name.partition(".")[2]: v for name, v in values.items() if name.partition(".")[0] == component}

    def changed(self) -> set[str]:
        """Names of all that is ever set while it runs."""
        return {name for change in self.changes.values() for name in change}


def run(simulate: Callable[[Job], list[list[float]]]) -> None:
    """Simulate the jobs one after another; `simulate` returns the rows at t_1 .. t_n."""
    jobs = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    rows = {name: simulate(Job(**job)) for name, job in jobs.items()}
    Path(sys.argv[2]).write_text(json.dumps(rows), encoding="utf-8")
