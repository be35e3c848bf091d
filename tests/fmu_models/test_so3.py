import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from fmu_models.kernel import so3

numbers = st.floats(-100, 100, allow_subnormal=False)
small = st.floats(-0.05, 0.05, allow_subnormal=False)
angles = st.floats(-3, 3, allow_subnormal=False)
vectors = st.tuples(numbers, numbers, numbers)
rates = st.tuples(angles, angles, angles)
matrices = st.tuples(*[numbers] * 9)
errors = st.tuples(*[small] * 9)
untimed = settings(deadline=None)  # a busy machine is no failure


@untimed
@given(vectors, vectors, numbers)
def test_vector_algebra_is_numpys(oracles, a, b, s):
    oracles.check_vector_algebra(so3, a, b, s)


@untimed
@given(matrices, matrices, vectors)
def test_matrix_algebra_is_numpys_row_by_row(oracles, m, n, a):
    oracles.check_matrix_algebra(so3, m, n, a)


@untimed
@given(matrices, vectors)
def test_vee_is_the_vector_of_the_skew_part(oracles, m, a):
    oracles.check_vee(so3, m, a)


@untimed
@given(rates, rates, vectors)
def test_rotations_compose_and_act_as_scipys(a, b, v):
    A, B = Rotation.from_rotvec(a), Rotation.from_rotvec(b)
    m, n = tuple(A.as_matrix().ravel()), tuple(B.as_matrix().ravel())
    # Entries of at most 1 times numbers of at most 100.
    assert_allclose(so3.product(m, n), (A * B).as_matrix().ravel(), atol=1e-14)
    assert_allclose(so3.apply(m, v), A.apply(v), atol=1e-12)
    assert_allclose(so3.apply(so3.transpose(m), v), A.inv().apply(v), atol=1e-12)


@untimed
@given(rates)
def test_vee_of_a_rotation_is_its_axis_times_the_sine(rotvec):
    angle = np.linalg.norm(rotvec)
    R = Rotation.from_rotvec(rotvec).as_matrix()
    assert_allclose(so3.vee(tuple(R.ravel())), np.array(rotvec) * np.sinc(angle / np.pi), atol=1e-14)


@untimed
@given(rates, vectors, vectors)
def test_the_cross_product_turns_with_its_factors(rotvec, a, b):
    R = tuple(Rotation.from_rotvec(rotvec).as_matrix().ravel())
    turned = so3.cross(so3.apply(R, a), so3.apply(R, b))
    # Products of 1e4.
    assert_allclose(turned, so3.apply(R, so3.cross(a, b)), atol=1e-10)


@untimed
@given(rates, rates, rates)
def test_unit_derivatives_are_those_of_the_direction(oracles, a, a_dot, a_ddot):
    assume(np.linalg.norm(a) > 0.1)
    oracles.check_unit_derivatives(so3, a, a_dot, a_ddot)


def test_a_zero_vector_has_no_direction():
    with pytest.raises(ZeroDivisionError):
        so3.unit_derivatives((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@untimed
@given(rates, errors)
def test_what_an_integrator_leaves_becomes_a_rotation_by_gram_schmidt(oracles, rotvec, error):
    oracles.check_orthonormalized(so3, rotvec, error)


@untimed
@given(rates)
def test_a_rotation_stays_what_it_is(rotvec):
    R = tuple(Rotation.from_rotvec(rotvec).as_matrix().ravel())
    assert_allclose(so3.orthonormalized(R), R, atol=2e-15)


def test_the_identity_is_numpys():
    assert_allclose(so3.IDENTITY, np.eye(3).ravel(), atol=0)
