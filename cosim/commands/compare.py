"""`retune compare`."""

import argparse

from ..campaigns.compare import compare, comparison_study
from ..runs.record import recording
from ..scenarios.overrides import sweep, toml_value
from ..ssp.load import load_scenario
from ..studies.definition import checked_definition
from ..studies.plan import Study
from ..terminal.consent import consented
from ..terminal.exit_codes import DONE
from ..terminal.folders import new_folder
from ..terminal.next_step import set_options, tell_next
from ..terminal.progress import bar_of_runs
from ..terminal.run_output import BASELINES
from ..terminal.streams import answer
from ..terminal.study_output import telling_how_to_go_on
from .study import make


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    if any(len(sweep(text)) > 1 for _, text in options.overrides):
        return make(_swept(options), options)
    scenario = consented(load_scenario(options.scenario, dict(options.overrides)), options.trust)
    name = scenario.scenario.name
    with (
        new_folder(f"{name}-compare", options.out) as folder,
        telling_how_to_go_on(folder),
        recording(folder),
        bar_of_runs(f"compare {name}") as progress,
    ):
        result = compare(
            scenario, options.estimators, options.seeds, options.jobs, folder, options.keep, progress, options.on,
            options.plain,
        )  # fmt: skip
    answer(result.to_json() if options.json else result.table())
    if not options.json:
        name = next((name for name in result.estimators if name not in BASELINES), "target")
        tell_next("run", options.scenario, "--estimator", name, *set_options(options.overrides))
    return DONE


def _swept(options: argparse.Namespace) -> Study:
    """Return the study over the settings that have several values. Raises CosimError."""
    values = {key: [toml_value(part) for part in sweep(text)] for key, text in options.overrides}
    scenario = consented(load_scenario(options.scenario), options.trust)
    study = comparison_study(scenario, options.estimators, options.seeds, options.keep)
    settings = study.definition.study.model_dump() | {
        "scenarios": [options.scenario],
        "settings": {key: found[0] for key, found in values.items() if len(found) == 1},
    }
    factors = {key: {"set": key, "list": found} for key, found in values.items() if len(found) > 1}
    definition = checked_definition({"study": settings, "factors": factors}, "--set")
    return Study(definition, study.sources, (options.scenario,))
