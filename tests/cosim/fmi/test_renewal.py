"""Renewal of instances that reset themselves, that forget to, and that cannot."""

from array import array

import pytest

from cosim.errors import SlaveError
from cosim.fmi.renewal import Renewal


class Integrator:
    """An instance that integrates what it is given, and what its reset does to it."""

    def __init__(self, log, how):
        self.log, self.how, self.sum = log, how, 0.0

    def reset(self):
        self.log.append("reset")
        if self.how == "fails":
            raise SlaveError("shadow", "reset", None, "returned error")
        if self.how == "whole":
            self.sum = 0.0

    def simulate(self, gain):
        self.sum += gain
        return array("d", [self.sum])


def renewed(how, gains, kind=Integrator):
    """What becomes of each gain after a renewal, and the renewals."""
    log = []

    def anew():
        log.append("anew")
        return kind(log, how)

    renewal, instance, found = Renewal(anew), kind(log, how), []
    instance.simulate(100.0)
    for gain in gains:
        instance, outputs = renewal.simulated(instance, lambda instance, gain=gain: instance.simulate(gain))
        found += outputs
    return found, log


def test_an_fmu_that_resets_itself_is_instantiated_anew_once():
    assert renewed("whole", [1.0, 2.0, 3.0]) == ([1.0, 2.0, 3.0], ["reset", "anew", "reset", "reset"])


@pytest.mark.parametrize("how", ["forgets", "fails"])
def test_one_that_does_not_is_instantiated_anew_each_time(how):
    assert renewed(how, [1.0, 2.0, 3.0]) == ([1.0, 2.0, 3.0], ["reset", "anew", "anew", "anew"])


def test_one_without_the_call_is_instantiated_anew_each_time():
    class Plain(Integrator):
        reset = property()

    assert renewed("", [1.0, 2.0], Plain) == ([1.0, 2.0], ["anew", "anew"])
