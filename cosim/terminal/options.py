"""Command-line options of `retune`. Imports nothing heavy, so that --help is fast."""

import argparse
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final, NoReturn

from .. import __version__
from ..errors import one_line
from ..names import did_you_mean
from ..offline.estimate_options import add_options
from ..scenarios.named import named_scenarios
from .completion import SHELLS, estimators, scenarios
from .exit_codes import REFUSED


class Parser(argparse.ArgumentParser):
    """Argument parser that reports errors in one line."""

    def error(self, message: str) -> NoReturn:
        """Report an error in one line, without the usage, and exit."""
        message = _with_hint(message)
        print(f"{self.prog}: {message}; see {self.prog} --help", file=sys.stderr)
        raise SystemExit(REFUSED)


def _with_hint(message: str) -> str:
    """Return argparse's message on an unknown command with the one that may be meant."""
    choice = re.fullmatch(r"argument COMMAND: invalid choice: '(.*)' \(choose from .*\)", message, re.DOTALL)
    return f"no command '{one_line(choice[1])}'{did_you_mean(choice[1], _OPTIONS)}" if choice else message


def make_parser() -> Parser:
    """Return the parser of all commands; `command` of the parsed options is the name of the command chosen."""
    parser = Parser(prog="retune", description="Re-tune a controller FMU while it runs.", allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"fmu-retune {__version__}")
    table = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=Parser)
    for name, (text, add) in _OPTIONS.items():
        one = table.add_parser(name, help=text, allow_abbrev=False)
        add(one)
        one.add_argument("--debug", action="store_true", help="show tracebacks, and all that the FMUs log")
        one.set_defaults(command=name)
    return parser


def _build(parser: Parser) -> None:
    parser.add_argument("--out", type=Path, default=Path("fmus"), metavar="DIR", help="folder to write (default: fmus)")
    parser.add_argument("--force", action="store_true", help="replace FMUs that differ")
    parser.add_argument("--estimator", metavar="SCENARIO", help="build this scenario's estimator instead, as one FMU")
    parser.add_argument("--method", metavar="NAME", help="the estimator's method (default: target)")
    _add_set(parser)
    _add_trust(parser, "an SSP package")
    parser.add_argument("--fmi", type=int, choices=(2, 3), default=2, help="FMI version (default: 2)")
    parser.add_argument("--model-exchange", action="store_true", help="the plants for model exchange, FMI 3.0")


def _run(parser: Parser) -> None:
    _add_scenario(parser, ", an SSP package")
    text = "target (default), another estimator, none, true, or module:Class"
    _completed(parser.add_argument("--estimator", default="target", help=text), estimators)
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="seed of noise and search (default: 0)")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="run folder, absent or empty (default: runs/SCENARIO-n)"
    )
    _add_set(parser)
    _add_trust(parser, "an SSP package")
    parser.add_argument("--scenario", type=Path, metavar="FILE", dest="tables", help="TOML file for an SSP without one")
    _add_start_values(parser)
    parser.add_argument("--ssv", type=Path, metavar="FILE", help="also write the estimates to this new SSV file")
    parser.add_argument("--only", action="store_true", help="leave out the runs with nominal and true parameters")
    parser.add_argument("--view", action="store_true", help="show the run in a browser while it goes on")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _resume(parser: Parser) -> None:
    text = "folder of a run that was killed, interrupted or faulted; or of a study or a comparison"
    parser.add_argument("run", type=Path, metavar="RUN", help=text)
    _add_engine(parser)
    _add_trust(parser, "a run folder that you did not make")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _compare(parser: Parser) -> None:
    _add_scenario(parser)
    text = "default: all that the scenario and the installed packages allow"
    _completed(parser.add_argument("--estimators", type=_names, metavar="A,B,C", help=text), estimators)
    parser.add_argument("--seeds", type=_count, default=10, metavar="N", help="seeds 0 to N - 1 (default: 10)")
    _add_engine(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="absent or empty (default: runs/SCENARIO-compare-n)")
    parser.add_argument("--keep", action="store_true", help="keep a run folder for each run")
    _add_set(parser, "; several values, KEY=A,B,C, are a study over them")
    _add_trust(parser, "an SSP package")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _study(parser: Parser) -> None:
    text = "TOML file of a study; or `status` and the folder of one, to see how far it is"
    parser.add_argument("study", nargs="+", metavar="STUDY", help=text)
    text = "absent, empty, or the folder of this study, of which only what is new is run (default: runs/STUDY-study-n)"
    parser.add_argument("--out", type=Path, metavar="DIR", help=text)
    text = "only these of the study's estimators"
    _completed(parser.add_argument("--estimators", type=_names, metavar="A,B,C", help=text), estimators)
    parser.add_argument("--seeds", type=_count, metavar="N", help="only the first N of its seeds")
    _add_engine(parser)
    text = "run one run of each scenario and estimator, and say how many runs there are, how long and how large"
    parser.add_argument("--dry-run", action="store_true", help=text)
    _add_trust(parser, "an SSP package")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _add_engine(parser: Parser) -> None:
    parser.add_argument("--jobs", type=_count, metavar="N", help="runs at a time here (default: one per processor)")
    text = "make the runs elsewhere: tls://HEAD:8786 of a Dask scheduler, a file with its address, or mpi"
    parser.add_argument("--on", metavar="ADDRESS", help=text)
    text = "talk to a Dask scheduler elsewhere without TLS: whoever reaches its port runs code"
    parser.add_argument("--plain", action="store_true", help=text)


def _replay(parser: Parser) -> None:
    parser.add_argument("run", type=Path, metavar="RUN", help="run folder")
    text = "one estimator or several"
    _completed(parser.add_argument("--estimator", type=_names, required=True, metavar="A,B,C", help=text), estimators)
    parser.add_argument("--seed", type=_seed, metavar="N", help="seed of the search (default: the run's)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="also write the tables there, absent or empty")
    _add_trust(parser, "a run folder that you did not make, or of code that has changed")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _figures(parser: Parser) -> None:
    parser.add_argument("--out", type=Path, default=Path("figures"), metavar="DIR", help="absent or empty")
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="seed of noise and search (default: 0)")
    parser.add_argument("--jobs", type=_count, metavar="N", help="runs at a time (default: one per processor)")


def _report(parser: Parser) -> None:
    parser.add_argument("folders", type=Path, nargs="+", metavar="RUN", help="run folder, or a folder of runs; several")
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        metavar="FILE",
        help="HTML file (default: report.html, in the run folder; of several here)",
    )
    parser.add_argument("--force", action="store_true", help="replace a file")


def _csv(parser: Parser) -> None:
    parser.add_argument("run", type=Path, metavar="RUN", help="run folder")
    parser.add_argument("-o", "--out", type=Path, metavar="FILE", help="new CSV file (default: series.csv in RUN)")


def _view(parser: Parser) -> None:
    parser.add_argument("folders", type=Path, nargs="+", metavar="RUN", help="run folder, or a folder of runs; several")
    parser.add_argument("--no-browser", action="store_true", help="print the address, and open no browser")
    parser.add_argument("--until-end", action="store_true", help="end when the runs have ended and the page has it all")


def _plot(parser: Parser) -> None:
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="run folder, one or several")
    parser.add_argument(
        "-o", "--out", type=Path, default=Path("plot.png"), metavar="FILE", help="PNG or SVG, new (default: plot.png)"
    )


def _new(parser: Parser) -> None:
    parser.add_argument("--plant", type=Path, required=True, metavar="FMU", help="the plant")
    parser.add_argument("--controller", type=Path, metavar="FMU", help="the controller that is to be re-tuned")
    parser.add_argument("--reference", type=Path, metavar="FILE", help="its set points: CSV file, or FMU")
    parser.add_argument("--model", metavar="MODEL", help="its equations: module:function, or a model-exchange FMU")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="FILE", help="TOML file to write, new")


def _check(parser: Parser) -> None:
    _add_scenario(parser, ", an FMU")
    parser.add_argument(
        "--dry-run", action="store_true",
        help="also run the scenario's FMUs for 100 macro steps, and compare the model with the plant's derivatives",
    )  # fmt: skip
    _add_set(parser)
    _add_trust(parser, "an SSP package and, with --dry-run, its FMUs")


def _info(parser: Parser) -> None:
    parser.add_argument("fmu", type=Path, metavar="FMU", help="any FMU, ours or not")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _doctor(parser: Parser) -> None:
    parser.add_argument("fmu", type=Path, metavar="FMU", help="any FMU, ours or not")


def _export(parser: Parser) -> None:
    _add_scenario(parser)
    parser.add_argument("--ssp", type=Path, required=True, metavar="FILE", help="SSP package to write")
    parser.add_argument("--force", action="store_true", help="replace a file that differs")
    _add_set(parser)
    _add_start_values(parser)


def _completed(action: argparse.Action, completer: Callable[..., Iterable[str]]) -> None:
    """Set the completions of an argument's value; those of others are files."""
    option: Any = action
    option.completer = completer


def _completion(parser: Parser) -> None:
    parser.add_argument("shell", choices=SHELLS, help="the shell to switch completion on in")


def _schema(parser: Parser) -> None:
    parser.add_argument("-o", "--out", type=Path, metavar="FILE", help="JSON file to write, new (default: print it)")


def _illustrate(parser: Parser) -> None:
    parser.add_argument("--out", type=Path, default=Path("illustration.png"), metavar="FILE", help="PNG, new")
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="seed of the noise (default: 0)")


def _add_scenario(parser: argparse.ArgumentParser, also: str = "") -> None:
    text = f"{', '.join(named_scenarios())}{also}, or a TOML file"
    _completed(parser.add_argument("scenario", metavar="SCENARIO", help=text), scenarios)


def _add_set(parser: argparse.ArgumentParser, also: str = "") -> None:
    parser.add_argument(
        "--set", action="append", default=[], type=_assignment, metavar="KEY=VALUE", dest="overrides",
        help=f"replace a scenario's setting, such as estimation.budget=60{also}",
    )  # fmt: skip


def _add_trust(parser: argparse.ArgumentParser, of: str) -> None:
    parser.add_argument("--trust", action="store_true", help=f"run the Python code of {of}")


def _add_start_values(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--start-values", action="append", default=[], type=_start_values, metavar="[COMPONENT=]SSV",
        help="start values named component.variable, or the component's own as `retune estimate` writes them; several",
    )  # fmt: skip


def _start_values(text: str) -> tuple[str | None, Path]:
    component, equals, path = text.partition("=")
    if (equals and not path) or not text:
        raise argparse.ArgumentTypeError(f"must be [COMPONENT=]SSV, got '{text}'")
    return (component, Path(path)) if equals and not Path(text).exists() else (None, Path(text))


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"must be a whole number from 0 on, got '{text}'")
    return int(text)


def _count(text: str) -> int:
    if not text.isdecimal() or len(text) > 9 or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number from 1 to 999999999, got '{text}'")
    return int(text)


def _names(text: str) -> list[str]:
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise argparse.ArgumentTypeError(f"must be names separated by commas, got '{text}'")
    return names


def _assignment(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise argparse.ArgumentTypeError(f"must be KEY=VALUE, got '{text}'")
    return key.strip(), value.strip()


_OPTIONS: Final[Mapping[str, tuple[str, Callable[[Parser], None]]]] = {
    "build": ("build the FMUs that come with the package, or an estimator", _build),
    "run": ("simulate a scenario with its controller re-tuned", _run),
    "resume": ("go on with a run from its last checkpoint, to the same bits", _resume),
    "compare": ("run every estimator on the same plant, noise and seeds", _compare),
    "study": ("make many runs over factors, estimators and seeds, and go on whatever happens", _study),
    "replay": ("give the recorded samples of a run to other estimators, open loop", _replay),
    "report": ("write what a run did into one HTML file, to send and to look at", _report),
    "view": ("show runs in a browser, on a page that grows with them", _view),
    "csv": ("write the series of a run as CSV", _csv),
    "plot": ("draw outputs, inputs and parameters of runs over one another", _plot),
    "figures": ("draw the paper's figures and table from runs made here", _figures),
    "new": ("write a scenario for your own FMUs, to look over", _new),
    "check": ("list what is wrong or risky in a scenario or an FMU, before it runs", _check),
    "info": ("list the parameters, inputs, outputs, states and capabilities of an FMU", _info),
    "doctor": ("say what an FMU needs on this machine, and how to start an importer for it", _doctor),
    "export": ("write a scenario's system for other tools, as an SSP package", _export),
    "estimate": ("estimate a plant's parameters from logs", add_options),
    "schema": ("print the JSON Schema of scenario files, for editors", _schema),
    "completion": ("print what switches completion on in a shell", _completion),
    "illustrate": ("draw the one-dimensional illustration", _illustrate),
}
