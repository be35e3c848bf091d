"""Texts that tell runs from one another."""

from collections.abc import Sequence

from ..runs.result import Run


def texts_of(runs: Sequence[Run]) -> list[str]:
    """Return a text for each run by which it differs from the others: estimator, seed, scenario, folder as need be."""
    parts = [
        (r.estimator, f"seed {r.seed}", r.scenario.scenario.name, str(r.folder or f"run {k}"))
        for k, r in enumerate(runs)
    ]
    places = [i for i in range(3) if len({p[i] for p in parts}) > 1] or [0]
    short = [", ".join(p[i] for i in places) for p in parts]
    return short if len(set(short)) == len(short) else [f"{s} ({p[3]})" for s, p in zip(short, parts, strict=True)]


def shared_by(runs: Sequence[Run]) -> str:
    """Return what runs have in common of scenario, estimator and seed, for a title; else their number."""
    parts = zip(*((r.scenario.scenario.name, r.estimator, f"seed {r.seed}") for r in runs), strict=True)
    return (", ".join(of[0] for of in parts if len(set(of)) == 1) or f"{len(runs)} runs").replace("$", r"\$")
