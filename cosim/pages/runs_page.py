"""A page of one run or several, laid over one another."""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.embed import json_item

from ..errors import FolderError
from ..plots.overlay_texts import texts_of
from ..plots.palette import BASELINES, RUNS
from ..runs.manifest import Manifest, read_manifest
from ..runs.recorded_events import read_events
from ..runs.report import report
from ..runs.result import Run, read_run
from .frame import rendered, rendered_part, script_data
from .marks import refusals
from .pictures import draw_pictures
from .plant_changes import plant_changes
from .sketch import ShownRun
from .story import MOST_CHAPTERS, chapters, verdict
from .thinning import MOST_ROWS


@dataclass(frozen=True)
class PageOfRuns:
    """Runs as they are read from their folders at one time."""

    shown: tuple[ShownRun, ...]
    """Runs, each followed by those that it is compared with."""
    baselines: Mapping[str, Mapping[str, Run]]
    """Runs that each is compared with, by its key and their estimator."""
    manifests: Mapping[str, Manifest]
    """Manifests by key."""

    @property
    def is_final(self) -> bool:
        """True where no run on the page can grow any more."""
        return not any(s.run.status in ("running", "unfinished", "interrupted") for s in self.main)

    @property
    def main(self) -> list[ShownRun]:
        """The runs that are not only compared with."""
        return [s for s in self.shown if not s.is_baseline]

    def html(self, is_live: bool = False, version: str = "") -> str:
        """Return the page; is_live: one that asks for what is new since a version."""
        pictures = draw_pictures(self.shown)
        first = self.main[0].run
        settings = first.scenario.scenario
        data = {
            "item": json_item(pictures.layout), "renderers": pictures.renderers, "ranges": pictures.ranges,
            "structure": pictures.structure, "version": version, "is_live": is_live,
        }  # fmt: skip
        about = f"{settings.description}; {_about(self.main)}" if settings.description else _about(self.main)
        return rendered(
            "runs.html.j2", title=_title(self.main), about=about, data=script_data(data), has_plots=True,
            is_live=is_live, shown=self.shown, band=self.main[0].style.colour, provenance=self._provenance(),
            is_thinned=any(len(s.run.time) > MOST_ROWS for s in self.shown), **self._parts(),
        )  # fmt: skip

    def news(self) -> dict[str, Any]:
        """Return what a page that is open has to change, as JSON values."""
        pictures = draw_pictures(self.shown)
        return {
            "structure": pictures.structure, "columns": pictures.columns.to_json(), "ranges": pictures.ranges,
            "parts": self._parts(),
        }  # fmt: skip

    def _parts(self) -> dict[str, Any]:
        with np.errstate(all="ignore"):  # values of a run that diverged
            stories = [self._story(s) for s in self.main]
        return {name: rendered_part(f"{name}.html.j2", stories=stories) for name in ("above", "below")}

    def _story(self, s: ShownRun) -> dict[str, Any]:
        baselines, found = self.baselines[s.key], chapters(s.run, s.events)
        return {
            "text": s.text,
            "status": s.run.status,
            "is_retuned": s.run.estimator not in BASELINES,
            "verdict": verdict(s.run, baselines, s.events),
            "changes": plant_changes(s.run, s.events)[:MOST_CHAPTERS],
            "refusals": refusals(s.run, s.events)[:MOST_CHAPTERS],
            "chapters": found[:MOST_CHAPTERS],
            "n_left_out": max(0, len(found) - MOST_CHAPTERS),
            "table": report(s.run, baselines),
        }

    def _provenance(self) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = []
        for s in self.main:
            manifest = self.manifests[s.key]
            rows = [("estimator", manifest.estimator), ("seed", manifest.seed), ("folder", str(s.run.folder))]
            rows += [(f"version of {name}", version) for name, version in manifest.versions.items()]
            rows += [(f"SHA-256 of {name}", fmu["sha256"]) for name, fmu in manifest.fmus.items()]
            rows += [(f"SHA-256 of {Path(name).name}", digest) for name, digest in manifest.modules.items()]
            rows += [(f"SHA-256 of {name}", digest) for name, digest in manifest.sha256.items()]
            scenario = json.dumps(_without_nothing(manifest.scenario), indent=1)
            found.append({"text": s.text, "rows": rows, "scenario": scenario})
        return found


def read_page(folders: Sequence[Path]) -> PageOfRuns:
    """Return the runs of folders; of one run also those that it is compared with. Raises FolderError."""
    runs = [read_run(folder) for folder in folders]
    compared = [_baselines(folder, run) for folder, run in zip(folders, runs, strict=True)]
    texts = texts_of(runs) if len(runs) > 1 else [_role(runs[0].estimator)]
    shown: list[ShownRun] = []
    for k, (folder, run, text) in enumerate(zip(folders, runs, texts, strict=True)):
        if len(runs) == 1:
            shown += [
                ShownRun(f"r{k}-{name}", BASELINES[name][0], other, (), BASELINES[name][1], True)
                for name, other in compared[k].items()
                if len(other.time)
            ]
        shown.append(ShownRun(f"r{k}", text, run, read_events(folder), RUNS[k % len(RUNS)]))
    keys = [f"r{k}" for k in range(len(runs))]
    manifests = {key: read_manifest(folder) for key, folder in zip(keys, folders, strict=True)}
    return PageOfRuns(tuple(shown), dict(zip(keys, compared, strict=True)), manifests)


def _baselines(folder: Path, run: Run) -> dict[str, Run]:
    """Return the runs in a run's folder that it is compared with, as far as they have begun."""
    found: dict[str, Run] = {}
    for name in BASELINES:
        if name != run.estimator and (folder / name / "manifest.json").is_file():
            with suppress(FolderError):  # it has only just begun
                if _is_baseline(read_manifest(folder / name), name, read_manifest(folder)):
                    found[name] = read_run(folder / name)
    return found


def _is_baseline(manifest: Manifest, name: str, of: Manifest) -> bool:
    """Return whether a run is the baseline of that name, with the scenario and seed of another."""
    return (manifest.estimator, manifest.seed, manifest.scenario) == (name, of.seed, of.scenario)


def _role(estimator: str) -> str:
    return BASELINES[estimator][0] if estimator in BASELINES else f"re-tuned ({estimator})"


def _title(main: Sequence[ShownRun]) -> str:
    names = list(dict.fromkeys(s.run.scenario.scenario.name for s in main))
    return ", ".join(names) + (f": {len(main)} runs" if len(main) > 1 else "")


def _about(main: Sequence[ShownRun]) -> str:
    if len(main) > 1:
        return "laid over one another"
    return f"estimator {main[0].run.estimator}, seed {main[0].run.seed}"


def _without_nothing(value: Any) -> Any:
    """Return JSON values without the keys that are null, empty or false, which are defaults."""
    if isinstance(value, dict):
        return {k: _without_nothing(v) for k, v in value.items() if v not in (None, {}, [])}
    return [_without_nothing(v) for v in value] if isinstance(value, list) else value
