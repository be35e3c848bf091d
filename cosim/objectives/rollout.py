"""Objective of roll-outs: a second FMU of the plant simulated over the samples, its outputs compared."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np

from estimator import Evaluation, Sample, SampleSequence, Vector

from ..errors import ScenarioError, StateTooLargeError
from ..slaves.slave import Slave
from .rollout_base import WindowStart
from .rollout_check import PROOF_STEPS, prove_restart, steps_like_the_plant
from .rollout_fmu import START_METHODS, RunningPlant, Shadow, StartMethod, obstacles_in_words
from .rollout_plan import History, Origin, Plan, inputs_of, plan_of
from .rollout_pool import Outputs, Pool

LARGEST: Final = 1e9
"""Residual [standard deviations] beyond which a simulation has diverged, however far."""

SMALL_STATE: Final = 65536
"""Size [bytes] up to which the plant's state is saved at every sample, so that a window may begin at any."""


_MOVED: Final = 1e-6
"""Change of an output, by itself or by its noise, with which a plant has left its rest."""
_LATER: Final = 1.25
"""Ratio of the numbers of samples of two proofs, while nothing moves."""


class _Followed(NamedTuple):
    """Progress of the roll-out that is continued from sample to sample."""

    theta: bytes
    origin: Any
    place: int
    """Place in the history of the newest sample that was reached."""
    outputs: Outputs
    """Outputs over the stretch so far."""


class RolloutObjective:
    """Objective of roll-outs: residuals (D,) are simulated minus measured outputs in standard deviations of the noise.

    They are in order output by output, and 0 where one was not measured (NaN).

    How roll-outs begin is decided once, by the first samples. Leaving the context ends the processes.
    """

    is_of_outputs = True
    made_anew: ClassVar = ("_pool", "_follower", "_followed", "_window_start")
    """Attributes that are in no checkpoint: processes, and the roll-out that one of them is at, which begins again."""

    def __init__(
        self, shadow: Shadow, theta: Vector, way: StartMethod | None, live: RunningPlant | None, jobs: int
    ) -> None:
        """theta (d,): the controller's present parameters; way: None for the first that is proved to work."""
        self._shadow, self._live, self._history = shadow, live, History(shadow.start_time, theta.tolist())
        self._noise = np.array(shadow.noise)
        self._obstacles: dict[StartMethod, str] = dict(shadow.obstacles) if way is None else {}
        self._open: list[StartMethod] = [way] if way else [w for w in START_METHODS if w not in shadow.obstacles]
        self._is_asked_for = way is not None
        self.way: StartMethod | None = None
        """Way in which roll-outs begin; None: not decided yet."""
        self._at_first: Vector | None = None
        """Outputs (c,) of the plant at the first sample."""
        self._proof_state: bytes | None = None
        self._n_bytes = 0
        self._first_samples: list[Sample] = []
        self._n_for_proof = PROOF_STEPS
        self._pool = Pool(self._opened, jobs, shadow.is_restartable)
        self._follower = Pool(self._opened, 1, shadow.is_restartable)
        self._followed: _Followed | None = None
        self._window_start = WindowStart(shadow) if live is None else None
        self._lost: Any = None
        self.why_lost: str | None = None
        """Reason why the roll-out with the present parameters failed when last tried; None: it did not."""

    def __enter__(self) -> "RolloutObjective":
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.__exit__()
        self._follower.__exit__()
        if self._window_start is not None:
            self._window_start.close()

    @property
    def is_ready(self) -> bool:
        """True where it is decided how roll-outs begin."""
        return self.way is not None

    def describe(self) -> str:
        """Return a description: the FMU, how roll-outs begin, and why in this way."""
        if self.way is None:
            return f"roll-outs of {self._shadow.fmu.name}"
        how = {
            "state": "from the plant's saved state",
            "measured": "from measured states",
            "replay": "simulated again from the start",
        }[self.way]
        reason = obstacles_in_words(self._obstacles) or "a repeated step was the plant's own"
        why = "as asked" if self._is_asked_for else reason
        return f"roll-outs of {self._shadow.fmu.name} {how} ({why})"

    def add_sample(self, sample: Sample) -> None:
        """Add the newest sample. Raises ScenarioError where no way to begin a roll-out is left."""
        if self.way is None:
            self._first_samples.append(sample)
        if self.way in (None, "replay"):
            self._history.add_sample(sample)
        if self.way is None:
            self._decide()

    def snapshot(self, is_needed: bool) -> Origin | None:
        """Return the newest sample's place, with the plant's state if needed or small; None where it is neither."""
        live = self._live if (self.way or self._open[0]) == "state" else None
        if live is None:
            return Origin(len(self._history.inputs), None)
        if not is_needed and self._n_bytes > SMALL_STATE:
            return None
        state = live.slave.get_state()
        self._n_bytes = len(state)
        return Origin(len(self._history.inputs), state)

    def evaluate(self, thetas: Sequence[Vector], stretch: SampleSequence) -> list[Evaluation]:
        """Evaluate the candidates over the stretch, several at a time."""
        outcomes = self._pool.simulate([self._plan(theta, stretch) for theta in thetas])
        return [
            Evaluation(np.array([np.nan]), outcome.reason)
            if outcome.result is None
            else self._judged(self._residual(outcome.result, stretch.samples[1:]))
            for outcome in outcomes
        ]

    def track(self, theta: Vector, stretch: SampleSequence) -> Vector:
        """Return the residual of theta over a stretch that grows from call to call; only new samples are simulated.

        It is empty before roll-outs can be made and, once one has failed, for the rest of the stretch.
        """
        if self.way is None or not stretch.n_steps or stretch.origin is self._lost:
            return np.empty(0)
        way, at = self.way, self._followed
        is_on_its_way = at is not None and at.theta == theta.tobytes()
        is_begun = is_on_its_way and (at.origin is stretch.origin or way == "replay") if at else False
        task = partial(self._go_on, theta, stretch, is_begun)
        (outcome,) = self._follower.map([task], is_renewed=not is_begun and way != "state")
        self.why_lost = outcome.reason
        if outcome.result is None:
            self._lost, self._followed = stretch.origin, None
            return np.empty(0)
        return self._residual(outcome.result[-stretch.n_steps :], stretch.samples[1:])

    def accept(self, theta: Vector, stretch: SampleSequence) -> None:
        """Use theta from the stretch's beginning on in simulations from the start."""
        if self.way == "replay":
            self._history.accept(stretch.origin.place, theta.tolist())
            self._go_back_to(stretch.origin.place)

    def revert(self, theta: Vector) -> None:
        """Use theta in place of what was accepted after it, in simulations from the start."""
        if self.way == "replay":
            self._go_back_to(self._history.revert(theta.tolist()))

    def move_inputs(self, moved: Vector, stretch: SampleSequence) -> None:
        """Move the inputs by (p,) from the stretch's beginning on in simulations from the start, and as followed."""
        if self.way == "replay":
            self._history.move_inputs(stretch.origin.place, moved.tolist())
        self._go_back_to(stretch.origin.place)

    def _go_back_to(self, place: int) -> None:
        """Simulate anew what comes after a place of the history."""
        if self._window_start is not None:
            self._window_start.forget(place)
        self._followed = None

    def _decide(self) -> None:
        """Try the ways in turn, each as soon as there are enough samples to prove that it works."""
        n = len(self._first_samples)
        while self.way is None and self._open:
            way: StartMethod = self._open[0]
            reason: str | None = None
            if way == "state" and self._live is not None:
                if self._proof_state is not None:
                    reason = steps_like_the_plant(self._shadow, self._live, self._proof_state, self._first_samples[-2:])
                elif self._has_moved(self._live) or n == 1:
                    try:
                        state = self._live.slave.get_state()
                    except StateTooLargeError as e:
                        reason = str(e)
                    else:
                        self._proof_state = state if n > 1 else None
                        return
                else:
                    return
            elif way == "measured" and not self._is_asked_for:
                if n < self._n_for_proof:
                    return
                reason, has_moved = prove_restart(self._shadow, self._history)
                if reason is None and not has_moved:
                    self._n_for_proof = int(np.ceil(_LATER * n))
                    return
            if reason is None:
                self.way = way
                self._first_samples.clear()
            else:
                self._obstacles[way] = reason
                self._open.pop(0)
        if self.way is None:
            obstacles = obstacles_in_words(self._obstacles)
            raise ScenarioError(f"estimation.rollout: no way to begin a roll-out: {obstacles}.")

    def _has_moved(self, live: RunningPlant) -> bool:
        """Return whether the outputs compared have changed since the first sample: at rest nothing hidden shows."""
        values = live.slave.get()
        now = np.array([values[live.outputs.index(name)] for name in self._shadow.outputs])
        first = self._at_first = now if self._at_first is None else self._at_first
        return bool(np.any(np.abs(now - first) > _MOVED * np.maximum(np.abs(first), self._noise)))

    def _opened(self) -> Slave:
        """Start a process of the FMU; where roll-outs begin in saved states, disturbances are inputs as others."""
        shadow = self._shadow
        if self.way == "state":
            shadow = replace(shadow, inputs=(*shadow.inputs, *shadow.undisturbed))
        return shadow.opened()

    def _decided(self) -> StartMethod:
        if self.way is None:
            raise RuntimeError("roll-outs need samples before the first.")
        return self.way

    def _plan(self, theta: Vector, stretch: SampleSequence) -> Plan:
        plan = plan_of(self._decided(), self._shadow, self._history, theta.tolist(), stretch)
        if self.way != "replay" or self._window_start is None:
            return plan
        begun = self._window_start.shortened(plan, self._history, stretch.origin.place, self._simulated)
        return begun or plan

    def _simulated(self, plan: Plan) -> Outputs | None:
        (outcome,) = self._pool.map([partial(plan.run, self._pool)])
        return outcome.result

    def _go_on(self, theta: Vector, stretch: SampleSequence, is_begun: bool, slave: Slave, is_new: bool) -> Outputs:
        """Return outputs up to the newest sample, stepping on from the last sample reached."""
        samples, at, tunables = stretch.samples, self._followed, None
        times: Sequence[float]
        inputs: Sequence[Sequence[float]]
        if at is None or is_new or not is_begun:
            plan = self._plan(theta, stretch)
            plan.begin(self._follower, slave, is_new)
            at = _Followed(theta.tobytes(), stretch.origin, stretch.origin.place, [])
            tunables = plan.last.tunables
        n = stretch.origin.place + stretch.n_steps - at.place
        if not n:
            return at.outputs
        if self.way == "replay":  # it may have begun before the stretch
            times, inputs = self._history.times[-n - 1 :], self._history.inputs[-n:]
        else:
            times = [s.t for s in samples[-n - 1 :]]
            inputs = inputs_of(self._decided(), self._shadow, samples[-n:])
        outputs = [*at.outputs, *self._follower.through(slave, times, inputs, tunables)]
        self._followed = at._replace(place=at.place + n, outputs=outputs[-stretch.n_steps :])
        return outputs

    def _judged(self, residual: Vector) -> Evaluation:
        return Evaluation(residual, None, np.sum(residual.reshape(len(self._noise), -1) ** 2, axis=0))

    def _residual(self, outputs: Outputs, samples: Sequence[Sample]) -> Vector:
        measured = np.array([s.y for s in samples])
        with np.errstate(over="ignore", invalid="ignore"):
            r = np.where(np.isnan(measured), 0.0, (np.array(outputs) - measured) / self._noise)
        return np.clip(r, -LARGEST, LARGEST).T.reshape(-1)
