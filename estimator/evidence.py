"""Evidence of the hypotheses that a diagnosis has compared, for the record."""

from math import isfinite

from .events import Event
from .hypotheses import Fit


class Evidence:
    """Fits of the hypotheses that were compared last, until they are recorded.

    `nothing`: the parameters in force; `parameters`: changed ones; `disturbance`: one with the parameters before it;
    `both`: changed parameters and a constant disturbance.
    """

    def __init__(self) -> None:
        self._n_samples = 0
        self._fits: dict[str, Fit] = {}

    def note(self, n_samples: int, **fits: Fit) -> None:
        """Take fits of hypotheses to the newest n samples, in place of any to another number of samples."""
        known = self._fits if n_samples == self._n_samples else {}
        self._n_samples, self._fits = n_samples, known | fits

    def events(self, t: float) -> tuple[Event, ...]:
        """Return the event of the comparison at t [s], if parameters and a disturbance were compared; begin anew."""
        n_samples, fits = self._n_samples, self._fits
        self._n_samples, self._fits = 0, {}
        if not {"parameters", "disturbance"} <= fits.keys():
            return ()
        scores = {name: fit.score if isfinite(fit.score) else None for name, fit in fits.items()}
        explained = [name for name, fit in fits.items() if fit.is_explained]
        return (Event(t, "evidence", {"n_samples": n_samples, "scores": scores, "explained": explained}),)
