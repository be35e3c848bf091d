"""Digests of the series that the named scenarios give: equal digests mean equal runs, bit for bit.

python -m benchmarks.bits > before.json      # with one version of the code
python -m benchmarks.bits before.json        # with another: exit code 1, and the runs that differ, where any does
"""

import argparse
import json
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from hashlib import sha256
from itertools import product
from pathlib import Path

from cosim import Scenario, run

SCENARIOS = ("pendulum", "quadrotor", "stiction", "rigid-body")


def digest(scenario: str, seed: int) -> str:
    """SHA-256 of the series.arrow of a guarded run of `target`."""
    with tempfile.TemporaryDirectory() as folder:
        run(Scenario.load(scenario), seed=seed, out=Path(folder))
        return sha256((Path(folder) / "series.arrow").read_bytes()).hexdigest()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path, nargs="?", help="what another version has printed")
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="seeds 0 to N - 1 (default: 3)")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="runs at a time (default: 2)")
    options = parser.parse_args()
    cases = list(product(SCENARIOS, range(options.seeds)))
    with ProcessPoolExecutor(options.jobs) as pool:
        digests = pool.map(digest, *zip(*cases, strict=True))
        found = {f"{scenario} {seed}": value for (scenario, seed), value in zip(cases, digests, strict=True)}
    if options.before is None:
        print(json.dumps(found, indent=2))
        return 0
    before = json.loads(options.before.read_text(encoding="utf-8"))
    different = [name for name, value in found.items() if before.get(name) != value]
    print(f"{len(found) - len(different)} of {len(found)} runs are the same bits")
    for name in different:
        print(f"{name} differs")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
