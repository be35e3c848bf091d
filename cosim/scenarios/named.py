"""Names of the scenarios that come with the package. Imports nothing heavy."""

from importlib import resources


def named_scenarios() -> tuple[str, ...]:
    """Return the names of the scenarios that come with the package."""
    folder = resources.files("cosim") / "scenarios"
    return tuple(sorted(p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml")))
