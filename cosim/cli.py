"""The command `retune`. Exit codes: 0 done; 1 the run did not finish; 2 the input was refused; 130 interrupted."""

import argparse
import os
import signal
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from .result import Run
    from .scenario import Scenario

DONE, UNFINISHED, REFUSED, INTERRUPTED = 0, 1, 2, 130


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """One line, without the usage."""
        print(f"{self.prog}: {message}; see {self.prog} --help", file=sys.stderr)
        raise SystemExit(REFUSED)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # before NumPy: a second BLAS thread is slower and changes bits
    options = _parser().parse_args(arguments)
    signal.signal(signal.SIGTERM, _interrupt)
    from .errors import CosimError  # here and below: --help must not wait for NumPy and GPy

    try:
        return options.command(options)
    except CosimError as e:
        print(f"retune: {e}", file=sys.stderr)
        return REFUSED
    except KeyboardInterrupt:
        print("retune: interrupted; what there is so far is in the run folder", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our output has gone
        return UNFINISHED


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="retune", description="Re-tune a controller FMU while it runs.", allow_abbrev=False)
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=_Parser)

    build = commands.add_parser("build", help="build the FMUs that come with the package")
    build.add_argument("--out", type=Path, default=Path("fmus"), metavar="DIR", help="where to (default: fmus)")
    build.add_argument("--force", action="store_true", help="replace FMUs that differ")
    build.set_defaults(command=_build)

    run = commands.add_parser("run", help="simulate a scenario with its controller re-tuned", allow_abbrev=False)
    run.add_argument("scenario", metavar="SCENARIO", help="pendulum, quadrotor, or a TOML file")
    run.add_argument("--estimator", default="target", help="target (default), paper, none or true")
    run.add_argument("--seed", type=_seed, default=0, metavar="N", help="of noise and search (default: 0)")
    run.add_argument("--out", type=Path, metavar="DIR", help="run folder, absent or empty (default: runs/SCENARIO-n)")
    run.add_argument(
        "--set", action="append", default=[], type=_assignment, metavar="KEY=VALUE", dest="overrides",
        help="replace a scenario's setting, such as estimation.budget=60",
    )  # fmt: skip
    run.add_argument("--only", action="store_true", help="leave out the runs with nominal and true parameters")
    run.add_argument("--json", action="store_true", help="print one JSON object")
    run.set_defaults(command=_run)

    illustrate = commands.add_parser("illustrate", help="draw the one-dimensional illustration")
    illustrate.add_argument("--out", type=Path, default=Path("illustration.png"), metavar="FILE", help="PNG, new")
    illustrate.add_argument("--seed", type=_seed, default=0, metavar="N", help="of noise (default: 0)")
    illustrate.set_defaults(command=_illustrate)
    return parser


def _build(options: argparse.Namespace) -> int:
    from .library import build_into

    for path, verb in build_into(options.out, options.force):
        print(f"{path}  {verb}")
    return DONE


def _run(options: argparse.Namespace) -> int:
    from .estimators import check_estimator
    from .record import new_run_folder, to_json
    from .report import ending, report
    from .scenario import Scenario

    scenario = Scenario.load(options.scenario, dict(options.overrides))
    check_estimator(options.estimator, scenario)
    place = options.out or Path("runs")
    there = {path for path in (place, *place.parents) if path.exists()}
    folder = new_run_folder(scenario.scenario.name, options.out)
    try:
        result, baselines = _simulate(scenario, options, folder)
    except BaseException:
        _remove_empty(folder, there)
        raise
    if not options.only:
        from .plots import draw_run

        draw_run(result, baselines)
    print(to_json(result.summary()) if options.json else report(result, baselines))
    if why := ending(result):
        print(f"retune: {why}", file=sys.stderr)
        return UNFINISHED
    return DONE


def _simulate(scenario: "Scenario", options: argparse.Namespace, folder: Path) -> tuple["Run", Mapping[str, "Run"]]:
    """The run that was asked for and, unless told otherwise, those it is compared with."""
    from .progress import progress_bar
    from .simulation import run

    def simulate(estimator: str, out: Path) -> "Run":
        out.mkdir(exist_ok=True)
        with progress_bar(scenario, estimator) as progress:
            return run(scenario, estimator, options.seed, out, progress)

    result = simulate(options.estimator, folder)
    is_alone = options.only or options.estimator in ("none", "true")
    baselines = {} if is_alone else {name: simulate(name, folder / name) for name in ("none", "true")}
    return result, baselines


def _remove_empty(folder: Path, there: set[Path]) -> None:
    """Remove the folder and those above it that were not there, as long as nothing is in them."""
    for path in (folder, *folder.parents):
        if path in there or any(path.iterdir()):
            return
        path.rmdir()


def _illustrate(options: argparse.Namespace) -> int:
    from .illustrate import illustrate
    from .record import FolderError

    if options.out.exists():
        raise FolderError(f"{options.out} exists; give --out a new file.")
    print(illustrate(options.out, seed=options.seed))
    return DONE


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"must be a whole number from 0 on, got '{text}'")
    return int(text)


def _assignment(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise argparse.ArgumentTypeError(f"must be KEY=VALUE, got '{text}'")
    return key.strip(), value.strip()


def _interrupt(*_: object) -> NoReturn:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())
