"""Friction that a model lacks, found by sparse regression on plants written here."""

import numpy as np
import pytest

from estimator.effects import friction
from tests.estimator import oracles
from tests.estimator.oracles import joint_residuals, samples_of_joints


@pytest.mark.parametrize("check", ["friction_in_drives", "drag_on_one_derivative"])
def test_friction_is_found_and_taken_out(check):
    getattr(oracles, f"check_{check}_is_found_and_taken_out")(friction)


def test_dry_friction_is_not_known_near_rest():
    oracles.check_dry_friction_is_not_known_near_rest(friction)


def found_in(**plant):
    return friction.find_friction(joint_residuals, [*samples_of_joints(**plant)], (2, 3)).friction


@pytest.mark.parametrize(
    "plant",
    [
        {},
        {"torques": lambda w: np.array([0.7, -0.4])},
        {"torques": lambda w: -0.5 * w},
        {"drag": lambda w: 0.3 * np.sin(7.0 * w)},
    ],
    ids=["nothing", "a constant torque", "what drives the motion", "no law of friction"],
)
def test_what_is_no_friction_is_not_taken_for_it(plant):
    assert not found_in(**plant)


def test_speeds_in_one_direction_do_not_tell_dry_friction_from_a_constant():
    samples = [s for s in samples_of_joints(torques=lambda w: np.array([np.sign(w[0]), 0.0]), n=80) if s.x[2] > 0.5]
    found = friction.find_friction(joint_residuals, samples, (2, 3)).friction
    assert "dry" not in {term.law for term in found.terms}


def test_a_constant_speed_tells_no_friction_from_a_constant():
    drag = lambda w: np.array([0.5 * w[0], 0.0])  # noqa: E731
    samples = [s for s in samples_of_joints(drag=drag, n=200) if 2.0 < s.x[2] < 2.9]
    assert not friction.find_friction(joint_residuals, samples, (2, 3)).friction.terms


def test_friction_on_a_derivative_that_is_no_state_of_the_sample_is_not_sought():
    samples = [*samples_of_joints(drag=lambda w: 0.5 * w)]
    found = friction.find_friction(joint_residuals, samples, (2, 9)).friction
    assert {term.velocity for term in found.terms} <= {2}
