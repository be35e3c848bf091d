"""Consent to what a stranger's file would do: by `--trust`, or by an answer on a terminal."""

import sys

from ..scenarios.scenario import Scenario
from ..scenarios.trust import check_trust, distrusted, trusted


def consented(scenario: Scenario, is_trusted: bool) -> Scenario:
    """Return the scenario, as the user's own where `is_consented`. Raises ScenarioError."""
    return trusted(scenario) if is_consented(scenario, is_trusted) else scenario


def is_consented(scenario: Scenario, is_trusted: bool, estimator: str = "") -> bool:
    """Return whether the user trusts a scenario, and what its file names: by `--trust`, or when asked on a terminal.

    estimator: name of one that a stranger's file names too. Raises ScenarioError where trust is needed and not given.
    """
    if is_trusted or ((found := distrusted(scenario, estimator)) and _is_granted(scenario.origin.stranger, found)):
        return True
    check_trust(scenario, estimator)
    return False


def _is_granted(stranger: str, found: list[str]) -> bool:
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    print(f"{stranger}: {' and '.join(found)}? [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")
