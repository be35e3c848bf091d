"""Parameters that searches have found, one soon after the other, and those in force: which differ, and from when on."""

import numpy as np

from estimator.diagnosis.wandering import Findings, InForce


def found(places, std, every=10):
    """Findings of these places, one every so many samples, determined to a standard deviation each."""
    findings = Findings()
    for k, (z, s) in enumerate(zip(places, std, strict=True)):
        findings = findings.take(every * (k + 1), np.array(z), np.array(s))
    return findings


PLACES = [[0.2, 0.5], [0.5, 0.5], [0.2, 0.5], [0.6, 0.5]]


def test_three_searches_that_find_other_parameters_are_restless():
    assert found(PLACES, [[0.01, 0.01]] * 4).are_restless
    assert not found(PLACES[:3], [[0.01, 0.01]] * 3).are_restless


def test_parameters_that_the_samples_do_not_determine_do_not_differ():
    assert not found(PLACES, [[0.5, 0.01]] * 4).are_restless
    assert found(PLACES, [[0.01, 0.5]] * 4).are_restless


def test_the_first_search_that_determines_them_is_no_other_finding():
    findings = found([[0.8, 0.5], [0.3, 0.5]], [[0.4, 0.4], [0.01, 0.01]])
    assert not findings.has_moved
    assert findings.take(30, np.array([0.8, 0.5]), np.full(2, 0.01)).has_moved


def test_what_is_found_again_or_by_a_drift_has_not_moved():
    assert not found([[0.2, 0.5]] * 4, [[0.01, 0.01]] * 4).has_moved
    assert not found([[0.2, 0.5], [0.23, 0.5]], [[0.001, 0.001]] * 2).has_moved


def test_after_many_samples_the_moves_so_far_are_forgotten():
    findings = found(PLACES, [[0.01, 0.01]] * 4)
    assert not findings.take(400, np.array([0.2, 0.5]), np.full(2, 0.01)).are_restless


def test_when_others_came_after_parameters_in_force_is_known():
    one, two, three = (np.full(2, v) for v in (1.0, 2.0, 3.0))
    in_force = InForce()
    assert in_force.left_at(one) == 0
    for n, theta in enumerate((one, one, two, one, three), 5):
        in_force = in_force.take(n, theta)
    assert [in_force.left_at(theta) for theta in (one, two)] == [9, 8]
