"""The command `retune`. Exit codes: 0 done; 1 the run did not finish; 2 the input was refused; 130 interrupted."""

import argparse
import os
import signal
import sys
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
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
    build.add_argument("--fmi", type=int, choices=(2, 3), default=2, help="FMI version (default: 2)")
    build.add_argument("--model-exchange", action="store_true", help="the plants for model exchange, FMI 3.0")
    build.set_defaults(command=_build)

    run = commands.add_parser("run", help="simulate a scenario with its controller re-tuned", allow_abbrev=False)
    run.add_argument("scenario", metavar="SCENARIO", help="pendulum, quadrotor, or a TOML file")
    run.add_argument("--estimator", default="target", help="target (default), none, true, another, or module:Class")
    run.add_argument("--seed", type=_seed, default=0, metavar="N", help="of noise and search (default: 0)")
    run.add_argument("--out", type=Path, metavar="DIR", help="run folder, absent or empty (default: runs/SCENARIO-n)")
    _add_set(run)
    run.add_argument("--only", action="store_true", help="leave out the runs with nominal and true parameters")
    run.add_argument("--json", action="store_true", help="print one JSON object")
    run.set_defaults(command=_run)

    compare = commands.add_parser("compare", help="every estimator on the same plant, noise and seeds")
    compare.add_argument("scenario", metavar="SCENARIO", help="a named scenario or a TOML file")
    compare.add_argument(
        "--estimators", type=_names, metavar="A,B,C", help="default: all that the scenario and this machine allow"
    )
    compare.add_argument("--seeds", type=_count, default=10, metavar="N", help="seeds 0 to N - 1 (default: 10)")
    compare.add_argument("--jobs", type=_count, metavar="N", help="runs at a time (default: one a processor)")
    compare.add_argument("--out", type=Path, metavar="DIR", help="absent or empty (default: runs/SCENARIO-compare-n)")
    compare.add_argument("--keep", action="store_true", help="keep a run folder for each run")
    _add_set(compare)
    compare.add_argument("--json", action="store_true", help="print one JSON object")
    compare.set_defaults(command=_compare)

    replay = commands.add_parser("replay", help="other estimators on the recorded samples of a run, open loop")
    replay.add_argument("run", type=Path, metavar="RUN", help="run folder")
    replay.add_argument("--estimator", type=_names, required=True, metavar="A,B,C", help="one or several")
    replay.add_argument("--seed", type=_seed, metavar="N", help="of the search (default: the run's)")
    replay.add_argument("--out", type=Path, metavar="DIR", help="write the tables there too: absent or empty")
    replay.add_argument("--json", action="store_true", help="print one JSON object")
    replay.set_defaults(command=_replay)

    figures = commands.add_parser("figures", help="the paper's figures and table from runs of ours")
    figures.add_argument("--out", type=Path, default=Path("figures"), metavar="DIR", help="absent or empty")
    figures.add_argument("--seed", type=_seed, default=0, metavar="N", help="of noise and search (default: 0)")
    figures.add_argument("--jobs", type=_count, metavar="N", help="runs at a time (default: one a processor)")
    figures.set_defaults(command=_figures)

    illustrate = commands.add_parser("illustrate", help="draw the one-dimensional illustration")
    illustrate.add_argument("--out", type=Path, default=Path("illustration.png"), metavar="FILE", help="PNG, new")
    illustrate.add_argument("--seed", type=_seed, default=0, metavar="N", help="of noise (default: 0)")
    illustrate.set_defaults(command=_illustrate)
    return parser


def _add_set(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set", action="append", default=[], type=_assignment, metavar="KEY=VALUE", dest="overrides",
        help="replace a scenario's setting, such as estimation.budget=60",
    )  # fmt: skip


def _build(options: argparse.Namespace) -> int:
    from .library import build_into

    fmi, interface = (3, "ModelExchange") if options.model_exchange else (options.fmi, "CoSimulation")
    for path, verb in build_into(options.out, options.force, fmi, interface):
        print(f"{path}  {verb}")
    return DONE


def _run(options: argparse.Namespace) -> int:
    from .estimators import check_estimator
    from .record import to_json
    from .report import ending, report
    from .scenario import Scenario

    scenario = Scenario.load(options.scenario, dict(options.overrides))
    check_estimator(options.estimator, scenario)
    with _new_folder(scenario.scenario.name, options.out) as folder:
        result, baselines = _simulate(scenario, options, folder)
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


def _compare(options: argparse.Namespace) -> int:
    from .compare import compare
    from .progress import bar_of_runs
    from .scenario import Scenario

    scenario = Scenario.load(options.scenario, dict(options.overrides))
    name = scenario.scenario.name
    with _new_folder(f"{name}-compare", options.out) as folder, bar_of_runs(f"compare {name}") as progress:
        result = compare(scenario, options.estimators, options.seeds, options.jobs, folder, options.keep, progress)
    print(result.to_json() if options.json else result.table())
    return DONE


def _replay(options: argparse.Namespace) -> int:
    from .replay import replay

    with _new_folder("replay", options.out) if options.out else nullcontext():
        result = replay(options.run, options.estimator, options.seed, options.out)
    print(result.to_json() if options.json else result.table())
    return DONE


def _figures(options: argparse.Namespace) -> int:
    from .figures import figures
    from .progress import bar_of_runs

    with _new_folder("figures", options.out) as folder, bar_of_runs("figures") as progress:
        paths = figures(folder, options.seed, options.jobs, progress)
    for path in paths:
        print(path)
    return DONE


@contextmanager
def _new_folder(name: str, out: Path | None) -> Generator[Path]:
    """The folder to write in, removed again where that fails before anything is in it."""
    from .record import new_run_folder

    place = out or Path("runs")
    there = {path for path in (place, *place.parents) if path.exists()}
    folder = new_run_folder(name, out)
    try:
        yield folder
    except BaseException:
        for path in (folder, *folder.parents):
            if path in there or any(path.iterdir()):
                break
            path.rmdir()
        raise


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


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number from 1 on, got '{text}'")
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


def _interrupt(*_: object) -> NoReturn:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())
