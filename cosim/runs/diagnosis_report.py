"""Lines of the report on what the diagnosis found: the residuals' size, disturbances, failed searches, and rests."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from ..text_table import counted
from .recorded_events import RecordedEvent
from .result import Run, Series

_WORSE: Final = 1.5
"""Ratio of what the model leaves unexplained to the declared noise that is worth a line."""
_SMOOTH: Final = 0.5
"""Correlation of residuals from sample to sample that no sensor's noise has."""
_DROWNED: Final = 3.0
"""Ratio of a signal's standard deviation to its declared noise below which little of it is seen."""
_SPEEDS: Final = {
    "viscous": "times the speed",
    "dry": "against the speed",
    "quadratic": "times the square of the speed",
}
_OF_A_MODEL: Final = "the model lacks something (friction, a lag, another parameter)"
_OF_THE_PLANT: Final = "something acts on the plant that its inputs do not hold"
_SAVING: Final = (
    "an FMU that saves its state needs none of that (canGetAndSetFMUstate, canSerializeFMUstate; of pythonfmu: "
    "pythonfmu build --handle-state --serialize-state)"
)


def diagnosis_report(run: Run, events: Sequence[RecordedEvent]) -> list[str]:
    """Return lines on what a run's diagnosis found, and on why nothing was re-tuned."""
    if not run.diagnosis:
        return []
    is_own_model = run.objective.startswith("roll-outs") and run.scenario.estimation.rollout.fmu is None
    lines = diagnosed(run.diagnosis, _OF_THE_PLANT if is_own_model else _OF_A_MODEL)
    lines += list(_rests(run, events)) or resting(run.diagnosis)
    if "again from the start" in run.objective and (run.diagnosis["unexplained"] or run.diagnosis.get("rest")):
        lines.append(f"after a change, roll-outs from the start begin in a wrong state for some time; {_SAVING}")
    return [*lines, *_untriggered(run)]


def diagnosed(found: Mapping[str, Any], lacking: str = _OF_A_MODEL) -> list[str]:
    """Return lines on what the model leaves unexplained, for which `lacking` is the reason, and on disturbances."""
    channels = found["channels"].items()
    lines = [
        f"the model explains {name} to {ratio:.2g} times its declared noise"
        + (
            ": if that is noise, multiply it by as much"
            if channel["correlation"] < _SMOOTH
            else f", and the rest is smooth: {lacking}"
        )
        for name, channel in channels
        if (ratio := max(channel["scale"], channel["noise_ratio"] or 0.0)) >= _WORSE
    ]
    lines += [
        f"the declared noise of {name} is {1.0 / channel['noise_ratio']:.2g} times too large"
        for name, channel in channels
        if channel["noise_ratio"] and channel["scale"] * channel["noise_ratio"] <= 1.0 / _WORSE
    ]
    if found["disturbance"]:
        last = found["disturbances"][-1]
        sizes = ", ".join(f"{name} {size:.3g}" for name, size in last["size"].items())
        lines.append(
            f"{counted(found['disturbance'], 'disturbance')} named, the last at t = {last['t']:g} s ({sizes}): "
            "what was written for them, if anything, is undone"
        )
    lines += _late(found.get("input_lag", {})) + _rubbing(found.get("known_friction", ()))
    if found["unexplained"]:
        lines.append(
            f"failed searches: {found['unexplained']}, no parameters explain the samples; {lacking}, or a sensor is "
            "wrong"
        )
    return lines


def _late(lag: Mapping[str, Any]) -> list[str]:
    """Return a line on the lag, or the limits, of the plant's inputs that are known at the end, if there are any."""
    kinds = {"time_constant": "an actuator follows with a time constant of", "dead_time": "there is a dead time of"}
    found = [f"{text} {lag[kind]:.3g} s" for kind, text in kinds.items() if lag.get(kind)]
    if rates := [f"{rate:.3g}" for rate in lag.get("rates", ()) if rate is not None]:
        found.append(f"an actuator's rate is limited to {' and '.join(rates)} per second")
    lines = [f"the plant's inputs arrive late: {found[0]} that the model lacks, and is compensated"] if found else []
    if limits := lag.get("limits"):
        texts = [f"{name} {limit_text(*of)}" for name, of in limits.items()]
        lines.append(f"not all of the plant's inputs arrive: {', '.join(texts)}, which is taken into account")
    return lines


def limit_text(lower: float | None, upper: float | None) -> str:
    """Return in words between which limits an input arrives."""
    if lower is None or upper is None:
        return f"is at least {lower:.4g}" if upper is None else f"is at most {upper:.4g}"
    return f"is stuck at {lower:.4g}" if lower == upper else f"is between {lower:.4g} and {upper:.4g}"


def _rubbing(friction: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a line on the friction that is known at the end, if there is any."""
    text = "the plant has friction that the model lacks, and that is taken out of the samples"
    return [f"{text}: {'; '.join(map(friction_term, friction))}"] if friction else []


def friction_term(term: Mapping[str, Any]) -> str:
    """Return a term of friction in words: its law and size, what it acts on, and which speed is meant."""
    size = f"{term['coefficient']:.3g} {_SPEEDS[term['law']]}"
    return f"{term['law']} on {term['acts_on']}, {size} whose derivative is {term['speed_of']}"


def resting(found: Mapping[str, Any]) -> list[str]:
    """Return a line on the channels that rest at the end, if any do."""
    names = [name for name, channel in found["channels"].items() if channel["is_resting"]]
    return [f"re-tuning rests at the end: {', '.join(names)} left out"] if names else []


def _rests(run: Run, events: Sequence[RecordedEvent]) -> Iterator[str]:
    """Yield a line on each rest, one that begins before another is over being part of that."""
    ends = [e for e in events if e.get("kind") == "friction" or (e.get("kind") == "rest" and e.get("n_samples") == 0)]
    first: float | None = None
    rests = [e for e in events if e.get("kind") == "rest" and e.get("n_samples", 0) > 0]
    for event, following in zip(rests, [*rests[1:], None], strict=False):
        begin, n = (event["t"] if first is None else first), event["n_samples"]
        end, over = _end_of(run, event["t"], n), next((e for e in ends if e["t"] > event["t"]), None)
        if over is not None and (end is None or over["t"] < end):
            end = over["t"]
        else:
            over = None
        if following is not None and (end is None or following["t"] <= end):
            first = begin
            continue
        first = None
        yield _rest(run, begin, end, n if begin == event["t"] else None, over)


def _end_of(run: Run, begin: float, n_samples: int) -> float | None:
    """Return when a rest of n_samples is over [s]; None where it lasts to the end."""
    later = run.time[np.isfinite(run.series.get("filtered.time", run.time)) & (run.time > begin)]
    return float(later[n_samples - 1]) if n_samples <= len(later) else None


def _rest(run: Run, begin: float, end: float | None, n: int | None, over: RecordedEvent | None) -> str:
    """Return a line on a rest from begin to end [s], with what changed meanwhile and so was not seen.

    n: number of its samples, where it is one; over: event that has ended it early.
    """
    until = "to the end" if end is None else f"until t = {end:g} s"
    told = f"re-tuning rested from t = {begin:g} s {until}"
    if over is not None:
        why = "friction was named" if over["kind"] == "friction" else over["reason"]
        return f"{told}, when {why}"
    missed = [
        f"{name} at t = {run.time[k]:g} s"
        for name, values in run.true_parameters.items()
        if (k := _first_change(run.time, values, begin, end)) is not None
    ]
    unseen = f"; what changes meanwhile is not seen: {', '.join(missed)}" if missed else ""
    return f"{told}, {'again and again' if n is None else f'for {n} samples'} (diagnosis.rest){unseen}"


def _first_change(time: Series, values: Series, begin: float, end: float | None) -> int | None:
    """Return the place of the first change of a series within a span of time, or None."""
    is_inside = (time[1:] > begin) & (time[1:] <= (np.inf if end is None else end))
    changes = np.flatnonzero(is_inside & (np.diff(values) != 0.0))
    return int(changes[0]) + 1 if len(changes) else None


def _untriggered(run: Run) -> Iterator[str]:
    """Yield a line where no episode began, and one on each signal that is no larger than its declared noise."""
    trigger = run.scenario.estimation.trigger
    if run.n_episodes or not run.guard or run.guard["written"] or not len(run.time):
        return
    error = np.sqrt(sum(e * e for e in run.errors.values()))
    if trigger.kind == "tracking" and np.all(error < trigger.threshold):
        yield f"nothing was re-tuned: the tracking error never passed the trigger's threshold, {trigger.threshold:g}"
        return
    if "which failed each time" in run.objective:
        yield f"nothing was re-tuned: {run.scenario.estimation.objective} failed each time it was called"
        return
    yield "nothing was re-tuned: the samples never contradicted the parameters in force beyond the declared noise"
    sampling = run.scenario.sampling
    for name, declared in {**sampling.derivatives, **sampling.outputs}.items():
        signal = run.series.get(name)
        if signal is None or not declared.noise or np.ptp(signal) == 0.0:
            continue
        if (size := float(np.std(signal))) < _DROWNED * declared.noise:
            yield f"the declared noise of {name}, {declared.noise:g}, hides it: its standard deviation is {size:.3g}"
