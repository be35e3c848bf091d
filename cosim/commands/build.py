"""`retune build`."""

import argparse
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from fmu_models.build import build_all

from ..errors import ScenarioError
from ..estimator_fmu.build import build_estimator
from ..ssp.load import load_scenario
from ..system.fmu_cache import build_into
from ..terminal.consent import consented
from ..terminal.exit_codes import DONE
from ..terminal.next_step import tell_next


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    is_ours = options.fmi == 2 and not options.model_exchange
    if options.estimator and not is_ours:
        raise ScenarioError("--fmi and --model-exchange are of the built-in FMUs: leave out --estimator.")
    if not options.estimator and (options.method or options.overrides or options.trust):
        raise ScenarioError("--method, --set and --trust are of an estimator: give --estimator SCENARIO.")
    builder = _estimator_builder(options) if options.estimator else _builder(options)
    built: list[Path] = []
    for path, verb in build_into(options.out, options.force, builder):
        print(f"{path}  {verb}")
        built.append(path)
    tell_next("info", built[-1])
    return DONE


def _builder(options: argparse.Namespace) -> Callable[[Path], Mapping[str, Path]]:
    if options.model_exchange:
        return partial(build_all, fmi=3, interface="ModelExchange")
    return partial(build_all, fmi=options.fmi)


def _estimator_builder(options: argparse.Namespace) -> Callable[[Path], Mapping[str, Path]]:
    scenario = consented(load_scenario(options.estimator, dict(options.overrides)), options.trust)

    def builder(folder: Path) -> Mapping[str, Path]:
        path = build_estimator(scenario, folder, options.method or "target")
        return {path.stem: path}

    return builder
