"""The command `retune`. Exit codes: 0 done; 1 the run did not finish; 2 the input was refused; 130 interrupted."""

import argparse
import logging
import os
import signal
import sys
import traceback
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from .offline.estimate_options import request_of
from .options import REFUSED, parser_of

if TYPE_CHECKING:
    from .offline.estimate import Request
    from .results.result import Run
    from .scenarios.scenario import Scenario
    from .simulation import Progress

DONE, UNFINISHED, INTERRUPTED = 0, 1, 130
BASELINES = ("none", "true")
"""What a run is compared with, each in a folder of its name inside the run's."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # before NumPy: a second BLAS thread is slower and changes bits
    options = parser_of(_COMMANDS).parse_args(arguments)
    _take_signals()
    from .errors import CosimError, UnfinishedError  # here and below: --help must not wait for NumPy and GPy

    try:
        with _everything_logged() if options.debug else nullcontext():
            return options.command(options)
    except CosimError as e:
        return _end(options, str(e), UNFINISHED if isinstance(e, UnfinishedError) else REFUSED)
    except KeyboardInterrupt:
        return _end(options, "interrupted; what there is so far is in the run folder", INTERRUPTED)
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our output has gone
        return UNFINISHED
    except Exception as e:  # nothing that we know of; it must not look like success, nor like a refusal
        return _end(options, f"{type(e).__name__}: {e}; --debug shows where", UNFINISHED)


def _end(options: argparse.Namespace, why: str, code: int) -> int:
    """Say in one line why a command ends; the exit code."""
    from .errors import one_line

    if options.debug:
        traceback.print_exc()
    print(f"retune: {one_line(why, longest=4000)}", file=sys.stderr)
    return code


def _take_signals() -> None:
    """What ends a process politely interrupts the command, so that it clears up: also a terminal that is closed."""
    signal.signal(signal.SIGTERM, _interrupt)
    if sys.platform != "win32" and signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:  # nohup has it ignored
        signal.signal(signal.SIGHUP, _interrupt)


@contextmanager
def _everything_logged() -> Generator[None]:
    """Show what the FMUs log that is no warning, too."""
    log, handler = logging.getLogger(__package__), logging.StreamHandler()
    level = log.level
    log.setLevel(logging.DEBUG)
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.setLevel(level)


def _build(options: argparse.Namespace) -> int:
    from .errors import ScenarioError
    from .scenarios.library import build_into

    is_ours = options.fmi == 2 and not options.model_exchange
    if options.estimator and not is_ours:
        raise ScenarioError("--fmi and --model-exchange are of the built-in FMUs: leave out --estimator.")
    if not options.estimator and (options.method or options.overrides):
        raise ScenarioError("--method and --set are of an estimator: give --estimator SCENARIO.")
    builder = _estimator_builder(options) if options.estimator else _builder(options)
    for path, verb in build_into(options.out, options.force, builder):
        print(f"{path}  {verb}")
    return DONE


def _builder(options: argparse.Namespace) -> Callable[[Path], Mapping[str, Path]]:
    from fmu_models.build import build_all

    if options.model_exchange:
        return partial(build_all, fmi=3, interface="ModelExchange")
    return partial(build_all, fmi=options.fmi)


def _estimator_builder(options: argparse.Namespace) -> Callable[[Path], Mapping[str, Path]]:
    from .estimator_fmu.build import build_estimator
    from .scenarios.scenario import Scenario

    scenario = Scenario.load(options.estimator, dict(options.overrides))

    def builder(folder: Path) -> Mapping[str, Path]:
        path = build_estimator(scenario, folder, options.method or "target")
        return {path.stem: path}

    return builder


def _run(options: argparse.Namespace) -> int:
    from .errors import SspError
    from .results.lock import locked
    from .results.record import ESTIMATES, write_bytes
    from .scenarios.estimators import check_estimator
    from .scenarios.scenario import Scenario
    from .scenarios.start_values import with_start_values
    from .simulation import run

    is_package = options.scenario.lower().endswith(".ssp") and Path(options.scenario).is_file()
    if is_package and not options.tables and _has_no_scenario(Path(options.scenario)):
        return _run_plainly(options)
    if options.tables and not is_package:
        raise SspError(f"--scenario goes with an SSP package, got '{options.scenario}'.")
    source, system = (options.tables, options.scenario) if options.tables else (options.scenario, None)
    scenario = Scenario.load(source, dict(options.overrides), system)
    scenario = with_start_values(scenario, options.start_values)
    check_estimator(options.estimator, scenario)
    _must_be_new(options.ssv, "--ssv")
    is_alone = options.only or options.estimator in BASELINES
    with _new_folder(scenario.scenario.name, options.out) as folder, locked(folder):
        estimators = {folder: options.estimator} | ({} if is_alone else {folder / name: name for name in BASELINES})
        for path in estimators:
            path.mkdir(exist_ok=True)  # empty: a run that is still to be made, also by `resume`
        runs = {
            path: _simulated(scenario, name, partial(run, scenario, name, options.seed, path))
            for path, name in estimators.items()
        }
        if options.ssv and len(runs[folder].time):
            write_bytes(options.ssv, (folder / ESTIMATES).read_bytes())
        return _tell(folder, runs, options.json, not options.only)


def _resume(options: argparse.Namespace) -> int:
    from .results.lock import locked
    from .results.manifest import read_manifest, scenario_of
    from .results.record import FolderError
    from .results.result import read_run
    from .results.unfinished import has_begun, has_ended
    from .simulation import resume, run

    folder: Path = options.run
    begun = read_manifest(folder)
    scenario = scenario_of(folder, begun)
    estimators = {folder: begun.estimator} | {folder / n: n for n in BASELINES if (folder / n).is_dir()}
    if all(map(has_ended, estimators)):
        raise FolderError(f"{folder} cannot be resumed: it is {begun.status}.")
    runs: dict[Path, Run] = {}
    with locked(folder):
        for path, name in estimators.items():
            if has_ended(path):
                runs[path] = read_run(path)
                continue
            go_on = partial(resume, path) if has_begun(path) else partial(run, scenario, name, begun.seed, path)
            runs[path] = _simulated(scenario, name, go_on)
        return _tell(folder, runs, options.json, len(runs) > 1 or begun.estimator in BASELINES)


def _tell(folder: Path, runs: "Mapping[Path, Run]", is_json: bool, is_drawn: bool) -> int:
    """Draw and print the run of a folder, and those that it is compared with; the exit code."""
    from .errors import UnfinishedError
    from .results.record import FolderError, to_json
    from .results.report import ending, report

    result, baselines = runs[folder], {path.name: run for path, run in runs.items() if path != folder}
    if is_drawn:
        from .plots.runs import draw_run

        try:
            draw_run(result, baselines)
        except FolderError as e:  # the disk is full
            raise UnfinishedError(str(e)) from e
    print(to_json(result.summary()) if is_json else report(result, baselines))
    if why := ending(result):
        print(f"retune: {why}", file=sys.stderr)
        return UNFINISHED
    return DONE


def _has_no_scenario(package: Path) -> bool:
    from .ssp.scenario import scenario_in

    return scenario_in(package) is None


def _run_plainly(options: argparse.Namespace) -> int:
    """A package made elsewhere, of which nobody has said what to estimate."""
    from .errors import SspError
    from .results.record import to_json
    from .ssp.package import System
    from .ssp.run import report, simulate
    from .ssp.settings import overridden

    if options.ssv or options.estimator not in ("target", "none"):
        raise SspError(f"{options.scenario} holds no scenario: nothing is estimated in it; give --scenario FILE.")
    system, settings = overridden(System.from_ssp(options.scenario), dict(options.overrides), options.start_values)
    with _new_folder(settings.name, options.out) as folder:
        result = simulate(system, settings, folder)
    print(to_json(result.summary()) if options.json else report(result))
    if result.error:
        print(f"retune: {result.error}; rows so far are in {folder}.", file=sys.stderr)
        return UNFINISHED
    return DONE


def _simulated(scenario: "Scenario", estimator: str, simulate: "Callable[[Progress], Run]") -> "Run":
    from .progress import progress_bar

    with progress_bar(scenario, estimator) as progress:
        return simulate(progress)


def _compare(options: argparse.Namespace) -> int:
    from .progress import bar_of_runs
    from .results.compare import compare
    from .results.record import recording
    from .scenarios.scenario import Scenario

    scenario = Scenario.load(options.scenario, dict(options.overrides))
    name = scenario.scenario.name
    with (
        _new_folder(f"{name}-compare", options.out) as folder,
        recording(folder),
        bar_of_runs(f"compare {name}") as progress,
    ):
        result = compare(scenario, options.estimators, options.seeds, options.jobs, folder, options.keep, progress)
    print(result.to_json() if options.json else result.table())
    return DONE


def _replay(options: argparse.Namespace) -> int:
    from .results.replay import replay

    with _new_folder("replay", options.out) if options.out else nullcontext():
        result = replay(options.run, options.estimator, options.seed, options.out)
    print(result.to_json() if options.json else result.table())
    return DONE


def _figures(options: argparse.Namespace) -> int:
    from .plots.figures import figures
    from .progress import bar_of_runs

    with _new_folder("figures", options.out) as folder, bar_of_runs("figures") as progress:
        paths = figures(folder, options.seed, options.jobs, progress)
    for path in paths:
        print(path)
    return DONE


def _new(options: argparse.Namespace) -> int:
    from .authoring.draft import draft
    from .results.record import write_text

    _must_be_new(options.out, "-o")
    given = {"plant": options.plant, "controller": options.controller, "reference": options.reference}
    written = draft({name: path for name, path in given.items() if path}, options.out.parent, options.model)
    write_text(options.out, written.text)
    print(f"{options.out}  written")
    for mark, what in (("FILL", "to fill in"), ("GUESS", "to look at")):
        for number, line in written.lines(mark):
            print(f"{options.out}:{number}: {what}: {' '.join(line.split())}")
    print(f"then: retune check {options.out}")
    return DONE


def _check(options: argparse.Namespace) -> int:
    from .authoring.check import check
    from .authoring.check_fmu import check_fmu
    from .errors import ScenarioError

    is_fmu = options.scenario.lower().endswith(".fmu")
    if is_fmu and options.overrides:
        raise ScenarioError("--set is of a scenario, not of an FMU.")
    findings = check_fmu(Path(options.scenario)) if is_fmu else check(options.scenario, dict(options.overrides))
    for finding in findings:
        print(f"{options.scenario}: {finding}")
    n_errors = sum(finding.is_error for finding in findings)
    n_warnings = sum(not (finding.is_error or finding.is_note) for finding in findings)
    plural = ["" if n == 1 else "s" for n in (n_errors, n_warnings)]
    print(f"{options.scenario}: {n_errors} error{plural[0]}, {n_warnings} warning{plural[1]}")
    return REFUSED if n_errors else DONE


def _info(options: argparse.Namespace) -> int:
    from dataclasses import asdict

    from .authoring.info import info
    from .results.record import to_json

    found = info(options.fmu)
    print(to_json(asdict(found)) if options.json else found)
    return DONE


def _doctor(options: argparse.Namespace) -> int:
    from .authoring.doctor import diagnose

    diagnosis = diagnose(options.fmu)
    print(diagnosis)
    return DONE if diagnosis.is_well else UNFINISHED


@contextmanager
def _new_folder(name: str, out: Path | None) -> Generator[Path]:
    """The folder to write in, removed again where that fails before anything is in it."""
    from .results.record import new_run_folder

    place = out or Path("runs")
    there = {path for path in (place, *place.parents) if path.exists()}
    folder = new_run_folder(name, out)
    try:
        yield folder
    except BaseException:
        below = list(folder.iterdir())
        if not any(path.is_file() or any(path.iterdir()) for path in below):
            for path in below:
                path.rmdir()
        for path in (folder, *folder.parents):
            if path in there or any(path.iterdir()):
                break
            path.rmdir()
        raise


def _export(options: argparse.Namespace) -> int:
    from .results.record import FolderError, write_bytes
    from .scenarios.scenario import Scenario
    from .scenarios.start_values import with_start_values
    from .ssp.write import to_ssp

    content = to_ssp(with_start_values(Scenario.load(options.scenario, dict(options.overrides)), options.start_values))
    verb = "written"
    if options.ssp.exists():
        verb = "unchanged" if options.ssp.is_file() and options.ssp.read_bytes() == content else "replaced"
    if verb == "replaced" and not options.force:
        raise FolderError(f"{options.ssp} exists and differs; give --force or another --ssp.")
    if verb != "unchanged":
        write_bytes(options.ssp, content)
    print(f"{options.ssp}  {verb}")
    return DONE


def _estimate(options: argparse.Namespace) -> int:
    from .offline.estimate import FailedError, estimate
    from .offline.fit_plot import draw_fit
    from .offline.fit_report import estimates_ssv, report, summary, write_files
    from .progress import bar_of_rollouts
    from .results.record import to_json, write_text

    request = request_of(options)
    _must_be_new(options.ssv, "--ssv")
    if options.online:
        return _online(options, request)
    try:
        with _new_folder(f"{request.fmu.stem}-estimate", options.out) as folder:
            with bar_of_rollouts(request.fmu.stem, request.evaluations) as progress:
                found = estimate(request, progress)
            write_files(found, folder)
            draw_fit(found, folder / "fit.png")
    except FailedError as e:
        print(f"retune: {e}", file=sys.stderr)
        return UNFINISHED
    except KeyboardInterrupt:
        print("retune: interrupted; there is no estimate yet", file=sys.stderr)
        return INTERRUPTED
    if options.ssv:
        write_text(options.ssv, estimates_ssv(found))
    print(to_json(summary(found)) if options.json else f"{report(found)}\n\nwritten to {folder}")
    return DONE


def _online(options: argparse.Namespace, request: "Request") -> int:
    from .offline.online import run_online
    from .offline.online_report import estimates_ssv, report, summary, write_files
    from .progress import bar_of_samples
    from .results.record import to_json, write_text

    try:
        with _new_folder(f"{request.fmu.stem}-online", options.out) as folder:
            with bar_of_samples(request.fmu.stem) as progress:
                found = run_online(request, options.samples or 50, progress)
            write_files(found, folder)
    except KeyboardInterrupt:
        print("retune: interrupted; nothing is written", file=sys.stderr)
        return INTERRUPTED
    if options.ssv:
        write_text(options.ssv, estimates_ssv(found))
    print(to_json(summary(found)) if options.json else f"{report(found)}\n\nwritten to {folder}")
    if found.failure is not None:
        print(f"retune: {found.failure}; what there is so far is in {folder}", file=sys.stderr)
        return UNFINISHED
    return DONE


def _must_be_new(path: Path | None, option: str) -> None:
    """Raises FolderError, before anything is computed, where a file of the user's would be lost."""
    from .results.record import FolderError

    if path is not None and (path.exists() or not path.parent.is_dir()):
        problem = "exists" if path.exists() else "is in no folder that there is"
        raise FolderError(f"{path} {problem}; give {option} a new file.")


def _illustrate(options: argparse.Namespace) -> int:
    from .plots.illustrate import illustrate

    _must_be_new(options.out, "--out")
    print(illustrate(options.out, seed=options.seed))
    return DONE


def _interrupt(*_: object) -> NoReturn:
    raise KeyboardInterrupt


_COMMANDS = {
    "build": _build,
    "run": _run,
    "resume": _resume,
    "compare": _compare,
    "replay": _replay,
    "figures": _figures,
    "new": _new,
    "check": _check,
    "info": _info,
    "doctor": _doctor,
    "export": _export,
    "estimate": _estimate,
    "illustrate": _illustrate,
}


if __name__ == "__main__":
    sys.exit(main())
