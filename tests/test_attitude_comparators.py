"""Established estimators behind the same signature, against each other."""

import numpy as np
import pytest
from random_attitudes import problems
from rounding import EPS
from scipy.spatial.transform import Rotation

from simval.attitude import two_vector_quaternion
from simval.attitude.comparators import ESTIMATORS, align_vectors, davenport, triad
from simval.errors import GeometryError, InputError
from simval.geometry import (
    attitude_error,
    attitude_matrix,
    normalize,
)


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_exact_without_noise(name):
    q, vectors, _ = problems(300, 1)
    sine = np.linalg.norm(np.cross(vectors[2], vectors[3]), axis=-1)
    found = ESTIMATORS[name](*vectors)
    assert found.shape == (300, 4)
    assert np.all(found[:, 3] >= 0.0)
    # an eigenvector or singular vector is good to eps over the gap, which is sine^2/2
    # for the q-method; align_vectors goes through a matrix too
    assert np.max(attitude_error(q, found) * sine**2) < 1e-14
    shaped = ESTIMATORS[name](*(v[:6].reshape(2, 3, 3) for v in vectors))
    assert np.max(attitude_error(q[:6], shaped.reshape(6, 4)) * sine[:6] ** 2) < 1e-14


def test_davenport_equals_align_vectors_with_noise():
    # both maximise the same gain, by eigenvalue and by singular value decomposition
    _, vectors, rng = problems(300, 2)
    noisy = vectors + 0.05 * rng.standard_normal(vectors.shape)
    gap = attitude_error(davenport(*noisy), align_vectors(*noisy))
    b1, b2, r1, r2 = normalize(noisy[:, 0])
    peer = Rotation.align_vectors([r1, r2], [b1, b2])[0].as_quat()
    # 40 operations each in two routines, over a sine squared of 0.1 or more
    assert attitude_error(davenport(b1, b2, r1, r2), peer) < 400 * EPS
    sine = np.linalg.norm(np.cross(noisy[2], noisy[3]), axis=-1)
    # an eigenvector is off by eps over the gap to the next eigenvalue, of order sine^2
    assert np.max(gap * sine**2) < 40 * EPS


def test_davenport_against_ahrs():
    ahrs = pytest.importorskip("ahrs")
    _, vectors, rng = problems(20, 3)
    noisy = vectors + 0.01 * rng.standard_normal(vectors.shape)
    ours = triad(*noisy)
    for i in range(20):
        b1, b2, r1, r2 = noisy[:, i]
        peer = ahrs.filters.TRIAD(w1=b1, w2=b2, v1=r1, v2=r2)
        # the peer's matrix takes one frame to the other; up to its direction
        A = np.asarray(peer.A).reshape(3, 3)
        mine = attitude_matrix(ours[i])
        gap = min(np.abs(A - mine).max(), np.abs(A - mine.T).max())
        # entries off by eps over the sine, here 0.1 or more, a dozen operations in each
        assert gap < 200 * EPS


def test_triad_takes_the_first_pair_exactly():
    _, vectors, rng = problems(200, 4)
    noisy = vectors + 0.05 * rng.standard_normal(vectors.shape)
    q = triad(*noisy)
    predicted = np.einsum("nij,nj->ni", attitude_matrix(q), normalize(noisy[2]))
    # entries below 1, a dozen operations
    np.testing.assert_allclose(predicted, normalize(noisy[0]), rtol=0, atol=20 * EPS)


def test_comparators_refuse_what_the_estimator_refuses():
    x, y, _ = np.eye(3)
    for estimator in ESTIMATORS.values():
        with pytest.raises(GeometryError, match="parallel"):
            estimator(x, x, y, y)
        with pytest.raises(InputError, match="finite"):
            estimator(x, y, x, np.array([0, np.nan, 1]))
        with pytest.raises(InputError, match="differ in length"):
            estimator(x, 9.8 * y, x, y)
    for weights in ((1.0, float("nan")), (0.0, 1.0), (1.0, float("inf"))):
        with pytest.raises(InputError, match="`weights`"):
            davenport(x, y, x, y, weights=weights)
    bad = np.tile(x, (6000, 1))
    bad[5000] = 0
    with pytest.raises(InputError, match=r"sample \(5000,\)"):
        davenport(bad, y, x, y)


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_pairs_in_different_units_weigh_the_same(name):
    _, vectors, rng = problems(50, 7)
    noisy = vectors + 0.01 * rng.standard_normal(vectors.shape)
    scale = np.array([9.8, 5e-5, 9.8, 5e-5])[:, None, None]
    sine = np.linalg.norm(np.cross(vectors[2], vectors[3]), axis=-1)
    gap = attitude_error(ESTIMATORS[name](*noisy), ESTIMATORS[name](*(scale * noisy)))
    # the lengths' own rounding, eps, over the gap of the eigenvalues
    assert np.max(gap * sine**2) < 40 * EPS


def test_all_agree_at_small_noise():
    # every estimator is consistent: at sigma 1e-6 they differ by some sigma
    _, vectors, rng = problems(100, 5)
    noisy = vectors + 1e-6 * rng.standard_normal(vectors.shape)
    sine = np.linalg.norm(np.cross(vectors[2], vectors[3]), axis=-1)
    reference = two_vector_quaternion(*noisy)
    for estimator in ESTIMATORS.values():
        gap = attitude_error(reference, estimator(*noisy)) * sine
        # at most five estimators' own sigma of the whole turn, sqrt(3) sigma / sine,
        # twice: 20 sigma is beyond 5 standard deviations of every sample
        assert np.max(gap) < 20e-6


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_empty_batches(name):
    none = np.empty((0, 3))
    assert ESTIMATORS[name](none, none, none, none).shape == (0, 4)
