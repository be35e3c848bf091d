import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmu_models import quadrotor
from fmu_models.kernel import references


def test_step_changes_at_the_step_time():
    values = [references.step(t, 1.0, 2.0, 3.0) for t in (0.0, np.nextafter(3.0, 0), 3.0, 10.0)]
    assert values == [1.0, 1.0, 2.0, 2.0]


def test_sinusoid_comes_with_its_first_four_derivatives(oracles):
    oracles.check_sinusoid_against_spectral_differences(references)


def test_trajectory_comes_with_its_first_four_derivatives(oracles):
    oracles.check_trajectory_derivatives_against_spectral_differences(quadrotor)


def test_yaw_rates_are_those_of_the_smooth_branch_for_both(oracles):
    oracles.check_yaw_rates_against_spectral_differences(quadrotor)


def test_papers_yaw_is_the_atan2_with_its_limit_at_zero_and_jumps_by_pi(oracles):
    oracles.check_paper_yaw(quadrotor)


@pytest.mark.parametrize("yaw", ["paper", "smooth"])
def test_papers_start(yaw):
    d = quadrotor.sinusoid_trajectory(0.0, (4.0, 5.0, 2.0), 0.4, yaw)
    # r_d_dot(0) = (4 * 0.8, 5 * 0.4, 2 * 0.4), psi_d(0) = atan2(5, 8).
    assert_allclose([*d.r, *d.v, d.psi], [0, 0, 0, 3.2, 2.0, 0.8, np.arctan2(5, 8)], atol=1e-15)


def test_yaw_is_the_papers_unless_asked_otherwise():
    d = quadrotor.sinusoid_trajectory(9.0, (4.0, 5.0, 2.0), 0.4)
    assert d == quadrotor.sinusoid_trajectory(9.0, (4.0, 5.0, 2.0), 0.4, "paper")
    assert d != quadrotor.sinusoid_trajectory(9.0, (4.0, 5.0, 2.0), 0.4, "smooth")
