"""References and true parameters of several runs, which mostly have them in common."""

import numpy as np

from ..runs.result import Run, Series


def is_own(run: Run, values: Series, first: Run, of_first: Series) -> bool:
    """Return whether a run's values (n,) differ from the first run's at times that both have, or go on after its end.

    No run has an end as long as it is running: of two that grow, now one is ahead and now the other.
    """
    common, own, other = np.intersect1d(run.time, first.time, return_indices=True)
    if not len(common):
        return len(run.time) > 0
    is_longer = first.status != "running" and run.time[-1] > first.time[-1]
    return is_longer or not np.array_equal(values[own], of_first[other], equal_nan=True)
