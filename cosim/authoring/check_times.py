"""Check of the times that a scenario names: what lies outside of its run never happens."""

from collections.abc import Iterator

from ..errors import seconds
from ..findings import Finding, warning
from ..scenarios.scenario import Scenario
from .check_wiring import Components


def check_times(scenario: Scenario, _: Components) -> Iterator[Finding]:
    """Yield changes and sensor faults that come too late or early for the run, and instants outside of it."""
    start, stop = scenario.scenario.start_time, scenario.scenario.stop_time
    for reference, change in scenario.changes.items():
        rows = change if isinstance(change, tuple) else ()
        late = [since for since, _ in rows if since >= stop]
        if late and len(late) == len(rows):
            text = f"its first row, at {seconds(late[0])} s, holds from the start on: {_ends(stop)}"
            yield warning(f'changes."{reference}"', text)
            continue
        if rows and rows[0][0] > start + 0.5 * scenario.scenario.macro_step:
            text = f"its first row, at {seconds(rows[0][0])} s, holds from the start on: begin with one at"
            yield warning(f'changes."{reference}"', f"{text} {seconds(start)} s")
        if late:
            yield warning(f'changes."{reference}"', f"changes at {seconds(late[0])} s, but {_ends(stop)}")
    for i, fault in enumerate(scenario.sampling.faults):
        if fault.start >= stop:
            yield warning(f"sampling.faults.{i}", f"starts at {seconds(fault.start)} s, but {_ends(stop)}")
        elif fault.stop is not None and fault.stop <= start:
            yield warning(f"sampling.faults.{i}", f"stops at {seconds(fault.stop)} s, before the run starts")
    outside = [t for t in scenario.estimation.instants if not start <= t <= stop]
    if outside:
        times = f"the run is from {seconds(start)} to {seconds(stop)} s"
        yield warning("estimation.instants", f"{', '.join(map(seconds, outside))} s: {times}")


def _ends(stop: float) -> str:
    return f"the run ends at {seconds(stop)} s"
