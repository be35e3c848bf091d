"""Evidence of a diagnosis for the record: the hypotheses that it has compared, and why it has ended a rest."""

from collections.abc import Sequence
from math import isfinite

import numpy as np

from ..events import Event
from ..hypotheses import Fit
from .resting import RestingResiduals


class Evidence:
    """Fits of the hypotheses that were compared last, until they are recorded.

    `nothing`: the parameters in force; `parameters`: changed ones; `disturbance`: one with the parameters before it;
    `both`: changed parameters and a constant disturbance; `lag`: inputs that arrive late or are limited; `inputs`: that
    are stuck since the onset, or arrive again; `friction`: one that the model lacks; `coloured`: noise that is
    correlated from sample to sample.
    """

    def __init__(self) -> None:
        self._n_samples = 0
        self._fits: dict[str, Fit] = {}
        self._rest_ended: tuple[Sequence[str], str] | None = None
        self._others: tuple[Event, ...] = ()

    def outgrown(self, names: Sequence[str], residuals: RestingResiduals) -> None:
        """Take the end of a rest whose residuals have outgrown all before in it; names (c,): of the channels."""
        largest = int(np.argmax(residuals.growth))
        growth = float(residuals.growth[largest])
        reason = f"the residual of {names[largest]} was {growth:.2g} times as large as any before in the rest"
        self.rest_ended([names[largest]], reason)

    def rest_ended(self, names: Sequence[str], reason: str) -> None:
        """Take the end of a rest before its time; names: of channels."""
        self._rest_ended = names, reason

    def add(self, event: Event) -> None:
        """Take the event of what is known from now on, although the suspicion goes on."""
        self._others = (*self._others, event)

    def note(self, n_samples: int, **fits: Fit) -> None:
        """Take fits of hypotheses to the newest n samples, in place of any to another number of samples."""
        known = self._fits if n_samples == self._n_samples else {}
        self._n_samples, self._fits = n_samples, known | fits

    def events(self, t: float) -> tuple[Event, ...]:
        """Return the events at t [s]; begin anew.

        A rest's end, those that were added, and a comparison of parameters with a disturbance.
        """
        n_samples, fits, rest_ended, others = self._n_samples, self._fits, self._rest_ended, self._others
        self._n_samples, self._fits, self._rest_ended, self._others = 0, {}, None, ()
        known = (*(() if rest_ended is None else (_end_of_rest(t, *rest_ended),)), *others)
        if not {"parameters", "disturbance"} <= fits.keys():
            return known
        scores = {name: float(f"{fit.score:.5g}") if isfinite(fit.score) else None for name, fit in fits.items()}
        tested = {name: fit for name, fit in fits.items() if name != "coloured"}  # whose size is fitted to the samples
        explained = [name for name, fit in tested.items() if fit.is_explained]
        return (*known, Event(t, "evidence", {"n_samples": n_samples, "scores": scores, "explained": explained}))


def _end_of_rest(t: float, names: Sequence[str], reason: str) -> Event:
    return Event(t, "rest", {"channels": [*names], "n_samples": 0, "reason": reason})
