"""Comparison of hypotheses on samples after a jump of the parameters, and where they have jumped to."""

from ..arrival_cost import ArrivalCost
from ..contract import Estimate
from ..hypotheses import Weighing, disturbance_of, plain_fit
from ..space import Vector
from .jump import followed_jump, jump_to
from .residual_scale import TOO_SMALL
from .settings import QUIET
from .standardised_residuals import StandardisedResiduals
from .state import WINDOW, DiagnosisState


class JumpComparison:
    """Search for a jump in the samples since the onset of a suspicion."""

    def __init__(self, state: DiagnosisState, residuals: StandardisedResiduals) -> None:
        self._state, self._residuals, self._space = state, residuals, residuals.space

    def found(self, held: Vector, *, is_filter: bool) -> Estimate | None:
        """Return the parameters that explain the samples since the onset and are determined by them, or None.

        A filter can go on from parameters that only the newest samples explain, and that they do not determine, too.
        A search can where every sample contradicts what was in force by far: the nearest parameters that explain two
        samples, or one of a derivative filter, which lasts long, are written if they are predicted to do no harm. While
        the parameters drift there is nothing for a search: it seeks again after a quarter as many samples as that has
        lasted, 20 at most.
        """
        state = self._state
        if not is_filter and state.n_samples < state.next_jump and state.n_since >= QUIET:
            return None
        reference = state.reference_or(held)
        z = self._space.to_unit(reference)
        lengths = (*self._since_jump(state.n_since), *((state.verdict.n_explained,) if is_filter else ()))
        is_obvious = not is_filter and self._n_obvious(reference) == state.n_since
        if not (is_filter or is_obvious) and state.n_since < 2:
            return None
        may_be_exact = is_obvious and (state.n_since > 1 or bool(state.inputs.means))
        found = jump_to(self._residuals.at_newest, dict.fromkeys(lengths), z, self._space, may_be_exact=may_be_exact)
        restless = min(state.n_samples - state.restless_since, 4 * WINDOW)
        state.next_jump = state.n_samples + max(state.n_since, restless) // 4 if found is None else 0
        return found if found is None or is_filter or is_obvious or all(found.is_identifiable) else None

    def followed(self, held: Vector, drift: float) -> ArrivalCost | None:
        """Return what the samples after a jump of the parameters say of them, while they drift; None without a jump.

        Each of these samples contradicts what was in force by far, and nothing else explains them nearly as well. The
        suspicion goes on from the first of them: those before it are of other parameters.
        drift: standard deviation of a parameter's change from sample to sample, as a share of the scaled bounds.
        """
        state = self._state
        reference = state.reference_or(held)
        n_obvious = 0 if state.is_resting.any() else self._n_obvious(reference)
        for n in self._since_jump(n_obvious):
            found = self._followed(reference, n, drift) if 1 < n <= QUIET else None
            if found is not None:
                state.n_since = n
                return found
        return None

    def _followed(self, reference: Vector, n: int, drift: float) -> ArrivalCost | None:
        """Return what the newest n samples say of parameters that have jumped before them, if nothing else does."""
        found = followed_jump(self._residuals.at_newest(n), n, self._space.to_unit(reference), drift)
        if found is None:
            return None
        before = self._residuals.of_newest(reference, n)
        weighing = Weighing(found[1], disturbance_of(before).fit, plain_fit(before, 0))
        return found[0] if weighing.are_parameters_proven else None

    def _since_jump(self, n: int) -> range:
        """Return how many samples may be of the parameters since a jump, n having contradicted those before it.

        The first ones of a derivative filter may be means over the jump, which no parameters explain.
        """
        return range(n, max(n - self._state.inputs.means.n_mixed, 1) - 1, -1)

    def _n_obvious(self, theta: Vector) -> int:
        """Return how many newest samples since the onset contradict theta (d,), each even with ten times the noise."""
        rows = self._residuals.of_newest(theta, self._state.n_since) / TOO_SMALL
        explained = (i for i, row in enumerate(rows[::-1]) if plain_fit(row[None], 0).is_explained)
        return next(explained, len(rows))

    def may_be_over(self, reference: Vector, n: int) -> bool:
        """Return whether some of the newest n samples of a derivative filter may be from before a jump, or over it."""
        n_mixed = self._state.inputs.means.n_mixed
        return n_mixed > 0 and self._n_obvious(reference) < n + n_mixed
