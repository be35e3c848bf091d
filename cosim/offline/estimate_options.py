"""Options of `retune estimate`. Imports nothing heavy: --help must not wait."""

import argparse
import os
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .request import Request

_Pair = tuple[str, str]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that `request_of` reads to the parser."""
    add = parser.add_argument
    add("fmu", type=Path, metavar="FMU", help="the plant")
    add("logs", type=Path, metavar="LOG", nargs="+", help=".csv, .parquet, .mat or .mf4; units in brackets")
    add("--parameter", action="append", type=_sought, required=True, metavar="NAME=LOW:HIGH[:log]", dest="parameters",
        help="parameter or start value of the FMU to estimate; may be repeated")  # fmt: skip
    add("--own", action="append", default=[], metavar="NAME",
        help="a --parameter with a value of its own in each log; may be repeated")  # fmt: skip
    add(
        "--measured",
        action="append",
        type=_pair,
        required=True,
        metavar="OUTPUT=COLUMN",
        help="output that was measured; may be repeated",
    )
    add(
        "--input",
        action="append",
        type=_pair,
        default=[],
        metavar="INPUT=COLUMN",
        dest="inputs",
        help="input that was recorded; may be repeated",
    )
    add("--start", action="append", type=_pair, default=[], metavar="VARIABLE=COLUMN|VALUE",
        help="start value: a known parameter, or a state at the window's first row")  # fmt: skip
    add("--noise", action="append", type=_noise, default=[], metavar="OUTPUT=STD",
        help="standard deviation, in the FMU's unit (default: from the log)")  # fmt: skip
    add("--time", metavar="COLUMN", help="time stamps (default: the column 'time' or 't')")
    add("--time-unit", metavar="UNIT", help="unit of the time stamps, such as ms (default: the log's, or s)")
    add("--window", action="append", type=_window, default=[], metavar="FROM:TO", dest="windows",
        help="part of each log to use [s]; may be repeated")  # fmt: skip
    add("--validate", action="append", type=Path, default=[], metavar="LOG", help="a log that is held out as a whole")
    add("--holdout", type=_number, metavar="SHARE", help="last rows held out (default: 0.25; 0 with --validate)")
    add("--step", type=_number, metavar="S", help="communication step (default: from row to row)")
    add("--method", default="target", help="target (default), least-squares or multi-start")
    add("--evaluations", type=_count, metavar="N",
        help="candidates to simulate in the search (default: 60), or, --online, in an episode (30)")  # fmt: skip
    add("--loss", default="linear", metavar="NAME",
        help="linear (default), huber, soft_l1 or cauchy, as SciPy's: outliers count for less")  # fmt: skip
    add("--f-scale", type=_number, default=1.0, metavar="C",
        help="with --loss: from how many standard deviations on (default: 1)")  # fmt: skip
    add("--profile", action="store_true", help="profile likelihoods decide what is identifiable; takes more roll-outs")
    add("--online", action="store_true",
        help="sample by sample, as if the loop ran: when it triggers, what it writes")  # fmt: skip
    add("--samples", type=_count, metavar="N", help="with --online: samples a candidate is judged on (default: 50)")
    add("--evaluations-per-sample", type=_count, metavar="N", dest="per_sample",
        help="with --online: candidates evaluated at each sample, up to a whole episode's (default: 1)")  # fmt: skip
    add("--seed", type=_count, default=0, metavar="N", help="seed of the search (default: 0)")
    add("--jobs", type=_count, metavar="N", help="roll-outs at a time (default: one per processor)")
    add("--timeout", type=_number, default=10.0, metavar="S", help="for each call of the FMU (default: 10)")
    add("--environment", action="append", default=[], metavar="NAME",
        help="environment variable that the FMU needs (* for any text); may be repeated")  # fmt: skip
    add("--out", type=Path, metavar="DIR", help="absent or empty (default: runs/FMU-estimate-n)")
    add("--ssv", type=Path, metavar="FILE", help="also write the estimates to this new SSV file")
    add("--json", action="store_true", help="print one JSON object")


def request_of(options: argparse.Namespace) -> "Request":
    """Return the request that the options make. Raises EstimateError."""
    from .request import EstimateError, Request, Sought

    if options.samples is not None and not (options.online and options.samples):
        raise EstimateError("--samples must be 1 or more, and goes with --online.")
    if options.per_sample is not None and not (options.online and options.per_sample):
        raise EstimateError("--evaluations-per-sample must be 1 or more, and goes with --online.")
    if options.profile and options.online:
        raise EstimateError("--profile is of a fit to the whole log, not --online.")
    if options.own and (options.online or options.ssv):
        raise EstimateError("--own is of a fit to all logs, not --online; and --ssv has one value for a parameter.")
    if options.online and options.loss != "linear":
        raise EstimateError("--loss is of a fit to the whole log, not --online, which screens its samples.")
    evaluations = options.evaluations if options.evaluations is not None else 30 if options.online else 60
    return Request(
        fmu=options.fmu,
        logs=tuple(options.logs),
        parameters=tuple(Sought(*p) for p in options.parameters),
        measured=_unique(options.measured, "--measured"),
        inputs=_unique(options.inputs, "--input"),
        start={name: _value(text) for name, text in _unique(options.start, "--start").items()},
        noise=dict(options.noise),
        time=options.time,
        time_unit=options.time_unit,
        windows=tuple(options.windows),
        validation=tuple(options.validate),
        holdout=options.holdout,
        step=options.step,
        method=options.method,
        evaluations=evaluations,
        seed=options.seed,
        jobs=(os.cpu_count() or 1) if options.jobs is None else options.jobs,
        timeout=options.timeout,
        environment=tuple(options.environment),
        own=tuple(dict.fromkeys(options.own)),
        loss=options.loss,
        f_scale=options.f_scale,
    )


def _unique(pairs: Sequence[_Pair], option: str) -> dict[str, str]:
    from .request import EstimateError

    names = [name for name, _ in pairs]
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise EstimateError(f"{option} {repeated} is given twice.")
    return dict(pairs)


def _value(text: str) -> str | float:
    """Return the text as a number if it is one, else as it is, the name of a column."""
    try:
        value = float(text)
    except ValueError:
        return text
    return value if isfinite(value) else text


def _pair(text: str) -> _Pair:
    name, equals, value = text.partition("=")
    if not (equals and name.strip() and value.strip()):
        raise argparse.ArgumentTypeError(f"must be NAME=..., got '{text}'")
    return name.strip(), value.strip()


def _sought(text: str) -> tuple[str, float, float, str]:
    name, bounds = _pair(text)
    low, *rest = bounds.split(":")
    if len(rest) not in (1, 2) or (len(rest) == 2 and rest[1] not in ("log", "linear")):
        raise argparse.ArgumentTypeError(f"must be NAME=LOW:HIGH or NAME=LOW:HIGH:log, got '{text}'")
    return name, _number(low), _number(rest[0]), "log" if rest[1:] == ["log"] else "linear"


def _noise(text: str) -> tuple[str, float]:
    name, value = _pair(text)
    return name, _number(value)


def _window(text: str) -> tuple[float, float]:
    low, colon, high = text.partition(":")
    if not colon:
        raise argparse.ArgumentTypeError(f"must be FROM:TO, got '{text}'")
    return _number(low), _number(high)


def _number(text: str) -> float:
    value = _value(text)
    if isinstance(value, str):
        raise argparse.ArgumentTypeError(f"must be a number, got '{text}'")
    return value


def _count(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"must be a whole number from 0 on, got '{text}'")
    return int(text)
