"""Check that two versions of the code run the named scenarios alike, bit for bit: digests of the series they write.

    python -m benchmarks.bits > before.json     # with one version
    python -m benchmarks.bits before.json       # with the other: names the runs that differ; exit code 1 if any does

Guard and estimator are the scenarios' own, and every FMU has a process of its own. Digests are compared on one machine:
another's linear algebra rounds otherwise.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from hashlib import sha256
from itertools import product
from pathlib import Path

from pyarrow.ipc import open_stream

from cosim import Scenario, run

SCENARIOS = ("pendulum", "quadrotor", "stiction", "rigid-body")


def main() -> int:
    """Print the digests, or their differences from those of another version; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path, nargs="?", help="what another version has printed")
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="seeds 0 to N - 1 (default: 3)")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="runs at a time (default: 2)")
    options = parser.parse_args()
    before = options.before and json.loads(options.before.read_text(encoding="utf-8"))
    digests = all_digests(options.seeds, options.jobs)
    if before is None:
        print(json.dumps(digests, indent=2))
        return 0
    different = differences(before, digests)
    print("\n".join([f"{len(digests) - len(different)} of {len(digests)} runs are the same bits", *different]))
    return 1 if different else 0


def all_digests(n_seeds: int, jobs: int) -> dict[str, str]:
    """Return the digest of each scenario with each seed, by "SCENARIO SEED"."""
    cases = list(product(SCENARIOS, range(n_seeds)))
    with ProcessPoolExecutor(jobs) as pool:
        digests = list(pool.map(digest, *zip(*cases, strict=True)))
    return {f"{scenario} {seed}": value for (scenario, seed), value in zip(cases, digests, strict=True)}


def digest(scenario: str, seed: int) -> str:
    """Return the SHA-256 of the series of one run: of its names and doubles, however the file holds them."""
    with tempfile.TemporaryDirectory() as folder:
        run(Scenario.load(scenario), seed=seed, out=Path(folder))
        with open_stream(str(Path(folder) / "series.arrow")) as series:
            table = series.read_all()
        digest = sha256()
        for name in sorted(table.column_names):
            digest.update(name.encode() + table[name].to_numpy().tobytes())
        return digest.hexdigest()


def differences(before: Mapping[str, str], digests: Mapping[str, str]) -> list[str]:
    """Return a line for each run whose digest is not that of before."""
    return [
        f"{name} differs" if name in before else f"{name} was not run before"
        for name, value in digests.items()
        if before.get(name) != value
    ]


if __name__ == "__main__":
    sys.exit(main())
