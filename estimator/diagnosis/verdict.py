"""Verdict of a comparison of hypotheses on the newest samples."""

from dataclasses import dataclass, replace

from .settings import Judgement


@dataclass(frozen=True)
class Verdict:
    """Judgement of changed parameters, and what it is founded on."""

    judgement: Judgement = "refuted"
    """Whether changed parameters are warranted: proven, possible beside a rival, or refuted."""
    is_certain: bool = False
    """True where it says that parameters are warranted, and could hardly have done so by chance."""
    n_spare: int = 0
    """Number of values in excess of those fitted."""
    n_explained: int = 0
    """Number of newest samples that it is about."""
    found_at: int = 0
    """Number of the sample at which it was found."""

    @property
    def is_refuted(self) -> bool:
        """True where changed parameters do not explain the samples, or too few of them to tell."""
        return self.judgement == "refuted"

    @property
    def is_warranted(self) -> bool:
        """True where changed parameters are proven."""
        return self.judgement == "warranted"

    def refuted(self) -> "Verdict":
        """Return the verdict that nothing speaks for changed parameters any more."""
        return replace(self, judgement="refuted")
