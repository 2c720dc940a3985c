"""Two-vector estimators, ours and established ones: exactness, frames, bad input."""

from functools import partial

import numpy as np
import pytest
from random_attitudes import problems
from rounding import EPS
from scipy import stats

from simval.errors import GeometryError, InputError
from simval.geometry import (
    attitude_error,
    attitude_matrix,
    normalize,
)
from simval.imu.attitude import (
    Validity,
    estimate_attitude,
    sequential_quaternion,
    two_vector_quaternion,
    wahba_quaternion,
)
from simval.imu.attitude.comparators import ESTIMATORS, davenport


def by_wahba(b1, b2, r1, r2):
    b, r = (np.stack(np.broadcast_arrays(*pair), -2) for pair in ((b1, b2), (r1, r2)))
    return wahba_quaternion(b, r, [1.0, 3.0])


def sequential(*vectors):
    q = sequential_quaternion(*vectors).q
    return np.where(q[..., 3:] < 0.0, -q, q)


OURS = {
    "optimal": two_vector_quaternion,
    "best": partial(two_vector_quaternion, frame="best"),
    "combined": partial(two_vector_quaternion, frame="combined"),
    "weighted": partial(two_vector_quaternion, weights=[1.0, 3.0]),
    "sequential": sequential,
}
EVERY = OURS | dict(ESTIMATORS) | {"wahba": by_wahba}


@pytest.mark.parametrize("name", sorted(EVERY))
def test_exact_without_noise_in_every_shape(name):
    estimator = EVERY[name]
    q, vectors, _ = problems(5000 if name in OURS else 300, 1)
    sine = np.linalg.norm(np.cross(vectors[2], vectors[3]), axis=-1)
    found = estimator(*vectors)
    assert np.all(found[:, 3] >= 0.0)
    # ours: inputs rounded to eps turn by eps / sine, a dozen operations; an eigenvector
    # or singular vector is good to eps over the gap, which is sine^2/2
    off = attitude_error(q, found)
    if name in ("optimal", "best", "combined", "sequential"):
        assert np.max(off * sine) < 20 * EPS
    assert np.max(off * sine**2) < 1e-14
    shaped = estimator(*(v[:6].reshape(2, 3, 3) for v in vectors))
    np.testing.assert_allclose(shaped.reshape(6, 4), found[:6], rtol=0, atol=1e-12)
    one = vectors[2:, 0]  # a pair of references for all
    body = np.einsum("nij,kj->kni", attitude_matrix(q[:20]), one)
    broadcast = estimator(*body, *one)
    assert np.max(attitude_error(q[:20], broadcast) * sine[0] ** 2) < 1e-14
    none = np.empty((0, 3))
    assert estimator(np.empty((2, 0, 3)), none, none, none).shape == (2, 0, 4)


@pytest.mark.parametrize("name", sorted(EVERY))
def test_a_batch_is_a_loop_and_units_cancel(name):
    estimator, count = EVERY[name], 4200 if name in OURS else 50
    _, vectors, rng = problems(count, 7)
    noisy = vectors + 0.01 * rng.standard_normal(vectors.shape)
    whole = estimator(*noisy)
    for rows in ([0], [17, 18], range(17, 36), [count - 1]):
        part = estimator(*(v[rows] for v in noisy))
        if name in OURS:
            np.testing.assert_array_equal(part, whole[rows])
        np.testing.assert_allclose(part, whole[rows], rtol=0, atol=1e-11)
    sine = np.linalg.norm(np.cross(vectors[2], vectors[3]), axis=-1)
    for first, second in ((9.8, 5e-5), (1e-35, 1.0), (1e35, 3.0)):
        scale = np.array([first, second, first, second])[:, None, None]
        gap = attitude_error(whole[:50], estimator(*(scale * noisy)[:, :50]))
        # the lengths' own rounding, eps, over the gap of the eigenvalues
        assert np.max(gap * sine[:50] ** 2) < 40 * EPS


def test_bad_rows_are_named_and_lose_nothing_else():
    _, (b1, b2, r1, r2), _ = problems(5000, 5)
    b1[7, 1] = np.nan
    r2[4321] = 0.0
    b2[100] *= 9.8
    r2[2500], b2[2500] = -r1[2500], -b1[2500]
    with pytest.raises(InputError, match=r"4 of 5 000 .* sample \(7,\)"):
        two_vector_quaternion(b1, b2, r1, r2)
    estimate = estimate_attitude(b1, b2, r1, r2)
    expected = {
        7: Validity.NOT_FINITE,
        4321: Validity.LENGTH,
        100: Validity.LENGTHS_DISAGREE,
        2500: Validity.COLLINEAR,
    }
    bad = np.flatnonzero(~estimate.valid)
    assert {int(i): Validity(estimate.validity[i]) for i in bad} == expected
    assert np.isnan(estimate.q[bad]).all()
    good = estimate.valid
    clean = two_vector_quaternion(b1[good], b2[good], r1[good], r2[good])
    np.testing.assert_array_equal(estimate.q[good], clean)


X, Y, _ = np.eye(3)
REFUSED = {
    "parallel": ((X, X, Y, Y), {}, GeometryError, "parallel"),
    "plain": ((X, Y, X, Y), {"frame": "plain"}, GeometryError, "singular"),
    "shapes": ((np.ones((2, 3)), Y, np.ones((3, 3)), Y), {}, InputError, "shape"),
    "four": ((np.ones(4), Y, X, Y), {}, InputError, "`b1`"),
    "infinite": ((X, Y, X, np.full(3, np.inf)), {}, InputError, "sample"),
    "lengths": (
        (1.4 * X, Y, X, Y), {"length_tolerance": 0.2}, InputError, "differ in length"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_refusals(name):
    vectors, options, kind, words = REFUSED[name]
    with pytest.raises(kind, match=words):
        two_vector_quaternion(*vectors, **options)


def test_any_length_may_be_allowed():
    assert two_vector_quaternion(1.4 * X, Y, X, Y)[3] == pytest.approx(1.0)
    two_vector_quaternion(1e9 * X, Y, X, Y, length_tolerance=np.inf)


def test_the_mask_at_the_edges_of_its_limits():
    x, y, _ = np.eye(3)

    def code(b1, b2, r1, r2, frame="best"):
        return Validity(int(estimate_attitude(b1, b2, r1, r2, frame).validity))

    for sine, expected in ((2e-7, Validity.VALID), (5e-8, Validity.COLLINEAR)):
        near = np.array([np.sqrt(1 - sine**2), sine, 0.0])
        assert code(x, near, x, near) is expected
    # a turn by a about z, r1 and r2 in the plane normal to it: |qbar| = sin(a/2)
    for half, expected in ((2e-8, Validity.VALID), (5e-9, Validity.SINGULAR)):
        A = attitude_matrix(np.array([0, 0, np.sin(half), np.cos(half)]))
        assert code(A @ x, A @ y, x, y, "plain") is expected
        assert code(A @ x, A @ y, x, y) is Validity.VALID
    # ... and a sample near one that is singular is judged by itself
    q = np.array([[0, 0, np.sin(half), np.cos(half)] for half in (0.0, 1e-6)])
    A = attitude_matrix(q)
    found = estimate_attitude(A @ x, A @ y, x, y, "plain")
    assert found.valid.tolist() == [False, True]
    # the components of qbar, off by some eps, over |qbar| = sin(1e-6)
    assert attitude_error(q[1], found.q[1]) < 8 * EPS / 1e-6
    assert code(1e60 * x, y, 1e60 * x, y) is Validity.LENGTH
    assert code(1e-60 * x, y, 1e-60 * x, y) is Validity.LENGTH
    assert code(np.full(3, 1e300), y, np.full(3, 1e300), y) is Validity.LENGTH


def test_every_estimator_refuses():
    x, y, _ = np.eye(3)
    for name, estimator in EVERY.items():
        with pytest.raises(GeometryError, match="parallel"):
            estimator(x, x, y, y)
        with pytest.raises(InputError, match=r"finite|sample"):
            estimator(x, y, x, np.array([0, np.nan, 1]))
        if name != "wahba":  # which takes any lengths
            with pytest.raises(InputError, match="differ in length"):
                estimator(x, 9.8 * y, x, y)
    with pytest.raises(InputError, match="`weights`"):
        davenport(x, y, x, y, weights=(0.0, 1.0))
    bad = np.tile(x, (6000, 1))
    bad[5000] = 0
    with pytest.raises(InputError, match=r"sample \(5000,\)"):
        davenport(bad, y, x, y)


def test_a_length_that_noise_does_not_explain_is_inconsistent():
    """2 % too long turns a single frame by degrees; the optimum and directions not."""
    q = normalize(np.array([0.1, -0.4, 0.3, 0.9]))
    r1, r2 = [1.0, 0.0, 0.0], [np.cos(0.3), np.sin(0.3), 0.0]
    A = attitude_matrix(q)
    b1, b2 = 1.02 * A @ r1, A @ r2
    std = [0.002, 0.001, 0.0, 0.0]
    for frame, least, most in (
        ("optimal", 0.0, 1e-14), ("combined", 0.03, 0.04), ("best", 0.01, 0.2),
    ):  # fmt: skip
        off = attitude_error(two_vector_quaternion(b1, b2, r1, r2, frame), q)
        assert least <= off < most
        options = {"frame": frame, "noise_std": std}
        found = estimate_attitude([b1, b1 / 1.02], b2, r1, r2, **options)
        assert found.validity.tolist() == [Validity.INCONSISTENT, Validity.VALID]
        found = estimate_attitude(b1, b2, r1, r2, normalized=True, **options)
        assert found.valid
        assert attitude_error(found.q, q) < 1e-14
    # (K6): by cot(theta) e / 2
    assert attitude_error(
        two_vector_quaternion(b1, b2, r1, r2, "combined"), q
    ) == pytest.approx(0.01 / np.tan(0.3), rel=0.02)  # the next order in e


def test_good_samples_are_refused_at_the_stated_rate():
    """The three tests share it; of 20 000 samples, one run in 1e4 has more or fewer."""
    rng, count = np.random.default_rng(11), 20_000
    r = normalize(rng.standard_normal((2, 3)))
    std = np.array([0.01, 0.02, 0.005, 0.0])
    noisy = np.concatenate([r, r])[:, None] + std[:, None, None] * rng.standard_normal(
        (4, count, 3)
    )
    found = estimate_attitude(*noisy, noise_std=std, false_alarm=0.01)
    share = np.mean(~found.valid)
    few, many = stats.binom.ppf([1e-4, 1.0 - 1e-4], count, 0.01) / count
    assert few * 0.9 < share <= many  # the tests are not independent
    assert (
        np.mean(~estimate_attitude(*noisy, noise_std=std / 1.1, false_alarm=0.01).valid)
        > many
    )
