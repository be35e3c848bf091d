"""Answers to a reader's first questions: how it went, what was noticed when, and what was written."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from ..runs.recorded_events import RecordedEvent
from ..runs.result import Run
from ..text_table import counted
from .marks import is_named, values_of
from .weighed import evidence_of

MOST_CHAPTERS: Final = 500
"""Number of rows of a table up to which all are shown."""


def verdict(run: Run, baselines: Mapping[str, Run], events: Sequence[RecordedEvent]) -> list[str]:
    """Return how the run ended, how well it tracked, and how often what was done: a sentence each."""
    name = "the nominal controller" if run.estimator == "none" else f"re-tuning by {run.estimator}"
    if run.estimator == "true":
        name = "the controller with the true parameters"
    stop = run.scenario.scenario.stop_time
    at = f"t = {run.time[-1]:.6g} s" if len(run.time) else "the start"
    endings = {
        "done": f"{name[0].upper()}{name[1:]} kept the loop to its end at {at}.",
        "diverged": f"The loop was lost with {name}: at {at} a tracked error passed the limit of divergence.",
        "faulted": f"The run ended at {at} by a fault: {run.error or 'no reason is recorded'}.",
        "running": f"The run goes on: {at} of {stop:g} s.",
        "unfinished": f"The run was stopped at {at} of {stop:g} s, and can be resumed.",
        "interrupted": f"The run was interrupted at {at} of {stop:g} s, and can be resumed.",
    }
    return [
        endings[run.status],
        *_compared(run, baselines),
        *([] if run.estimator in ("none", "true") else [_counts(events)]),
    ]


def _compared(run: Run, baselines: Mapping[str, Run]) -> Iterator[str]:
    """Yield the ratios of the mean squared tracking error to those of nominal and true parameters."""
    error = sum(run.mse)
    texts = {"none": "the nominal controller's", "true": "that of a controller with the true parameters"}
    found = {
        text: error / least
        for other, text in texts.items()
        if other in baselines and other != run.estimator and baselines[other].status == "done" == run.status
        if (least := sum(baselines[other].mse)) > 0.0 and np.isfinite(error / least)
    }
    if found:
        yield f"Its mean squared tracking error is {' and '.join(f'{_ratio(r)} {text}' for text, r in found.items())}."


def _ratio(ratio: float) -> str:
    if abs(ratio - 1.0) < 0.005:
        return "equal to"
    if ratio < 0.1:
        return f"1/{float(f'{1.0 / ratio:.3g}'):,.0f} of" if ratio > 0.0 else "0 times"
    return f"{ratio:.3g} times"


def _counts(events: Sequence[RecordedEvent]) -> str:
    def n(*kinds: str) -> int:
        return sum(e.get("kind") in kinds for e in events)

    w = n("write")
    found = Counter(str(e.get("kind")) for e in events if is_named(e))
    counts = [
        f"It was {_passive('triggered', n('trigger'))} and wrote {f'parameters {_often(w)}' if w else 'no parameters'}",
        f"the guard refused {counted(n('veto'), 'write')} and reverted {n('revert')}",
        f"{counted(found['disturbance'], 'disturbance')} {'was' if found['disturbance'] == 1 else 'were'} named",
        *(f"{what} {_often(found[kind])}" for kind, what in _LACKS.items() if found[kind]),
    ]
    return "; ".join(counts) + "."


def _passive(verb: str, n: int) -> str:
    return f"{verb} {_often(n)}" if n else f"never {verb}"


def _often(n: int) -> str:
    return {0: "never", 1: "once", 2: "twice"}.get(n, f"{n} times")


class Chapter(NamedTuple):
    """One search: what began it, and what came of it."""

    t: float
    noticed: str
    n_candidates: int
    weighed: str
    written: str
    refused: str


def chapters(run: Run, events: Sequence[RecordedEvent]) -> list[Chapter]:
    """Return the searches in order, each from its trigger to the next one."""
    begins = [i for i, e in enumerate(events) if e.get("kind") == "trigger"]
    found: list[Chapter] = []
    for begin, end in pairwise([*begins, len(events)]):
        part = events[begin:end]
        writes = [e for e in part if e.get("kind") == "write"]
        counts = Counter(map(_done, part))
        after = [f"{text} {_often(counts[text])}" for text in [*_VERBS.values(), *_OVERS.values()] if counts[text]]
        written = f"{counted(len(writes), 'write')}, the last: {values_of(writes[-1], run)}" if writes else "nothing"
        reason = str(part[0].get("reason") or "")
        n_candidates = sum(e.get("kind") == "candidate" for e in part)
        weighed = next(filter(None, map(evidence_of, reversed(part))), "")
        found.append(Chapter(float(part[0]["t"]), reason, n_candidates, weighed, written, ", ".join(after)))
    return found


def _done(event: RecordedEvent) -> str:
    kind = event.get("kind")
    return _OVERS[str(kind)] if kind in _OVERS and not is_named(event) else _VERBS.get(str(kind), "")


_LACKS: Final = {"lag": "late or limited inputs were named", "friction": "friction that the model lacks was named"}
_OVERS: Final = {"disturbance": "a disturbance over", "lag": "inputs as sent again", "friction": "friction over"}
_VERBS: Final = {
    "veto": "refused", "limit": "limited", "hold": "held back in part", "revert": "reverted", "undo": "undone",
    "disturbance": "a disturbance named", "lag": "late or limited inputs named",
    "friction": "friction named", "unexplained": "not explained",
    "stop": "re-tuning stopped",
}  # fmt: skip
