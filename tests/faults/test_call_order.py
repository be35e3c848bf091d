"""Calls of a Slave in any order: each does what it says, or raises what it says, and the FMU is never harmed by it.

The model beside it is the state machine of FMI 2.0.4, section 4.2.4, as far as the master uses it.
"""

import sys

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test

from cosim.errors import SlaveError, WiringError
from cosim.slaves.slave import open_slave

pytestmark = [pytest.mark.fmu, pytest.mark.skipif(sys.platform != "linux", reason="a library of Linux")]
H = 0.01  # s
FAULTS = ["", "", "discard", "nan"]


class CallOrder(RuleBasedStateMachine):
    """`phase` is made, initializing, running, stepping, failed or closed."""

    fmu, isolation = None, "none"

    @initialize()
    def open(self):
        self.slave = open_slave(self.fmu, "plant", isolation=self.isolation)
        self.phase, self.is_bound, self.k, self.y, self.how = "made", False, 0, 0.0, ""

    def call(self, allowed, function, *arguments, fails=False):
        """Call; where it is not allowed, or fails, it must be told so. Returns the result, or None."""
        if self.phase not in allowed:
            with pytest.raises(RuntimeError, match=r"^plant"):
                function(*arguments)
            return None
        if fails:
            with pytest.raises(SlaveError, match=r"^plant: (get|do_step) at t = \d\.\d{3} s"):
                function(*arguments)
            self.phase = "failed"
            return None
        return function(*arguments)

    @rule()
    def bind(self):
        allowed = ("made", "initializing", "running")
        self.call(allowed, self.slave.bind, ["u"], [], ["y"])
        self.is_bound |= self.phase in allowed

    @rule(names=st.sampled_from([["y"], ["nothing"], ["how"], ["u", "u"]]))
    def bind_what_is_no_input(self, names):
        with pytest.raises(WiringError):
            self.slave.bind(inputs=names)
        if self.phase in ("made", "initializing", "running"):
            self.slave.bind(["u"], [], ["y"])
            self.is_bound = True

    @rule(how=st.sampled_from(FAULTS))
    def initialize_slave(self, how):
        self.call(("made",), self.slave.initialize, {"how": how, "where": "do_step"})
        if self.phase == "made":
            self.phase, self.how, self.k, self.y = "running", how, 0, 0.0

    @rule()
    def enter_initialization(self):
        self.call(("made",), self.slave.enter_initialization, {})
        if self.phase == "made":
            self.phase, self.how, self.k, self.y = "initializing", "", 0, 0.0

    @rule(inputs=st.sampled_from([None, 3.0]))
    def propagate(self, inputs):
        values = None if inputs is None or not self.is_bound else [inputs]
        result = self.call(("initializing",), self.slave.propagate, values)
        assert result is None or len(result) == self.is_bound

    @rule()
    def exit_initialization(self):
        self.call(("initializing",), self.slave.exit_initialization)
        if self.phase == "initializing":
            self.phase = "running"

    @rule(u=st.floats(-100.0, 100.0))
    def begin_step(self, u):
        self.call(("running",), self.slave.begin_step, [u] * self.is_bound, self.k * H, H)
        if self.phase == "running":
            self.phase = "stepping"
            self.next = u if self.is_bound else None

    @rule()
    def end_step(self):
        fails = (self.how == "discard" and self.k >= 2) or (self.how == "nan" and self.k >= 2 and self.is_bound)
        result = self.call(("stepping",), self.slave.end_step, fails=fails)
        if self.phase == "stepping":
            self.phase, self.k = "running", self.k + 1
            if self.is_bound:
                self.y = self.next if self.next is not None else self.y
                assert result == (self.y,)

    @rule(u=st.sampled_from([101.0, float("nan"), float("inf")]))
    def step_with_what_the_fmu_does_not_take(self, u):
        if self.phase == "running" and self.is_bound:
            with pytest.raises(SlaveError, match=r"^plant: set at t = .* input 'u'"):
                self.slave.begin_step([u], self.k * H, H)

    @rule(n=st.integers(0, 3))
    def step_with_another_number_of_values(self, n):
        if self.phase == "running" and n != self.is_bound:
            with pytest.raises(ValueError, match="values must be set"):
                self.slave.begin_step([0.0] * n, self.k * H, H)

    @rule()
    def get(self):
        result = self.call(("running",), self.slave.get)
        if result and self.how != "nan":
            assert result == (self.y,)

    @rule()
    def ask_for_a_state(self):
        if self.phase in ("made", "initializing", "running", "stepping"):
            with pytest.raises(SlaveError, match="cannot save and restore its state"):
                self.slave.get_state()

    @rule()
    def restart(self):
        allowed = ("made", "initializing", "running")
        self.call(allowed, self.slave.restart)
        if self.phase in allowed:
            self.phase, self.how = "made", ""

    @rule()
    def close(self):
        self.slave.close()
        self.phase = "closed"

    @invariant()
    def it_is_told_by_its_name(self):
        assert not hasattr(self, "slave") or self.slave.name == "plant"

    def teardown(self):
        self.slave.close()
        self.slave.close()


@pytest.mark.parametrize(("isolation", "n"), [("none", 60), ("process", 6)], ids=["none", "process"])
def test_calls_in_any_order(native, isolation, n):
    machine = type("Machine", (CallOrder,), {"fmu": native, "isolation": isolation})
    limits = settings(
        max_examples=n, stateful_step_count=30, deadline=None, derandomize=True, database=None,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    run_state_machine_as_test(machine, settings=limits)
