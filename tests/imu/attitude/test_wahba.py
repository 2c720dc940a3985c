"""The weighted attitude of n vectors: estimator, moments, bound, test of the loss."""

import mpmath
import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from simval.errors import GeometryError, InputError
from simval.geometry import (
    attitude_matrix,
    cross,
    cross_matrix,
    normalize,
)
from simval.imu.attitude import (
    Validity,
    consistency,
    estimate_attitude,
    kernel,
    two_vector_quaternion,
    wahba_covariance,
    wahba_estimate,
    wahba_quaternion,
)
from simval.imu.attitude.estimator import MIN_SINE
from simval.imu.attitude.wahba import profile_matrix
from simval.streams import Streams
from simval.studies import attitude_vectors
from simval.studies.attitude_vectors import closed_form_square
from simval.theory import (
    cubature_moments,
    wahba_bound,
    wahba_moments,
)


def problem(seed, n):
    """True quaternion, scalar positive, body and reference vectors."""
    rng = np.random.default_rng(seed)
    q = normalize(rng.standard_normal(4))
    q *= np.sign(q[3])
    r = normalize(rng.standard_normal((n, 3)))
    return rng, q, r @ attitude_matrix(q).T, r


def rotation_covariance(q, covariance):
    """Of the body-frame angles, from that of the quaternion."""
    xi = np.vstack([q[3] * np.eye(3) + cross_matrix(q[:3]), -q[:3]])
    return 4.0 * xi.T @ covariance @ xi


@pytest.mark.parametrize("n", [2, 3, 7])
def test_agrees_with_scipy(n):
    rng, _, b, r = problem(n, n)
    b = b + 0.1 * rng.standard_normal((50, n, 3))
    weights = rng.uniform(0.1, 3.0, (50, n))
    q = wahba_quaternion(b, np.broadcast_to(r, b.shape), weights)
    for i in range(50):
        unit = b[i] / np.linalg.norm(b[i], axis=1, keepdims=True)
        other = Rotation.align_vectors(r, unit, weights[i])[0].as_quat()
        # SciPy's svd and our eigh: eps over the gap of the eigenvalues
        assert abs(q[i] @ other) == pytest.approx(1.0, abs=1e-13)


@pytest.mark.parametrize(("n", "form"), [(2, "one"), (3, "each"), (4, "full")])
def test_moments_against_cubature(n, form):
    """The estimator as a black box; what second order leaves out falls as sigma^4."""
    rng, q, b, r = problem(10 + n, n)
    weights = rng.uniform(0.5, 2.0, n)
    if form == "full":
        roots = rng.standard_normal((2 * n, 3, 3))
        unit = roots @ roots.swapaxes(1, 2) / 3.0
    else:
        std = np.ones(2 * n) if form == "one" else rng.uniform(0.3, 2.0, 2 * n)
        unit = std[:, None, None] ** 2 * np.eye(3)

    def estimator(*vectors):
        body, reference = np.stack(vectors[:n], 1), np.stack(vectors[n:], 1)
        return wahba_quaternion(body, reference, weights)

    differences = []
    sigmas = np.array([0.005, 0.01])
    for sigma in sigmas:
        noise = sigma**2 * unit
        truth = cubature_moments(estimator, np.vstack([b, r]), noise, q, degree=5)
        predicted = wahba_moments(q, r, noise, weights)
        differences.append(
            [
                np.linalg.norm(truth.bias - predicted.bias),
                np.linalg.norm(truth.covariance - predicted.covariance),
            ]
        )
    slopes = np.log2(np.divide(differences[1], differences[0]))
    assert slopes == pytest.approx([4.0, 4.0], abs=0.05)  # the next even order
    assert differences[1][0] < 0.01 * np.linalg.norm(predicted.bias)


@pytest.mark.parametrize("n", [2, 3, 6])
def test_best_weights_reach_the_bound(n):
    rng, q, b, r = problem(20 + n, n)
    std = rng.uniform(0.001, 0.1, (2, n))
    weights = 1.0 / np.sum(std**2, axis=0)
    bound = wahba_bound(q, r, std.reshape(-1)).rotation
    reached = rotation_covariance(
        q, wahba_moments(q, r, std.reshape(-1), weights).covariance
    )
    scale = np.abs(bound).max()
    assert reached == pytest.approx(bound, abs=1e-9 * scale)  # condition 1e4, eps
    measured = wahba_covariance(b, r, std)
    assert measured == pytest.approx(bound, abs=1e-9 * scale)
    # other weights are worse, in every direction
    equal = rotation_covariance(q, wahba_moments(q, r, std.reshape(-1)).covariance)
    assert np.linalg.eigvalsh(equal - bound).min() > -1e-9 * scale
    assert np.trace(equal) > 1.001 * np.trace(bound)
    assert wahba_covariance(b, r, std, np.ones(n)) == pytest.approx(
        equal, abs=1e-9 * scale
    )


@pytest.mark.ci
@pytest.mark.parametrize("n", [2, 3, 6])
def test_the_loss_is_chi_square(n):
    """Kolmogorov-Smirnov over 20 000 samples at a false-alarm rate of 1e-3."""
    rng, _, b, r = problem(30 + n, n)
    std = rng.uniform(1e-4, 1e-3, (2, n))
    noise = std[..., None] * rng.standard_normal((20_000, 2, n, 3))
    tested = consistency(b + noise[:, 0], r + noise[:, 1], std)
    assert tested.freedom == 2 * n - 3
    assert stats.kstest(tested.probability, "uniform").pvalue > 1e-3
    # the test has power: 3 % more noise than stated is seen
    less = consistency(b + noise[:, 0], r + noise[:, 1], std / 1.03)
    assert stats.kstest(less.probability, "uniform").pvalue < 1e-3


BAD = {
    "one vector": ([[1.0, 0, 0]], [[1.0, 0, 0]], InputError, "two or more"),
    "other number": (np.eye(3), np.eye(3)[:2], InputError, "same number"),
    "zero": ([[1.0, 0, 0], [0, 0, 0]], np.eye(3)[:2], InputError, "is zero or"),
    "NaN": ([[1.0, 0, 0], [0, np.nan, 0]], np.eye(3)[:2], InputError, "finite"),
    "parallel": ([[1.0, 0, 0], [-2.0, 0, 0]], np.eye(3)[:2], GeometryError, "parallel"),
    "flat": (np.eye(3)[:2, :2], np.eye(3)[:2], InputError, "last axes"),
    "batches": (np.ones((2, 2, 3)), np.ones((3, 2, 3)), InputError, "leading axes"),
    "ambiguous": (np.eye(3), -np.eye(3), GeometryError, "fit equally well"),
}


def test_refusals():
    for b, r, kind, words in BAD.values():
        with pytest.raises(kind, match=words):
            wahba_quaternion(b, r)
    pairs = np.eye(3)[:2], np.eye(3)[:2]
    for weights, words in (
        ([1.0, 0.0], r"is 0 at index \(1,\)"),
        ([[-1.0, 1.0]], r"is -1 at index \(0, 0\)"),
        (np.ones((3, 2)), "has shape"),
    ):
        for call in (wahba_quaternion, estimate_attitude):
            given = pairs if call is wahba_quaternion else (*pairs[0], *pairs[1])
            with pytest.raises(InputError, match=f"`weights` {words}"):
                call(*given, weights=weights)


def test_one_bad_sample_leaves_the_others_alone():
    rng, _, b, r = problem(80, 3)
    body = b + 1e-3 * rng.standard_normal((2, 4, 3, 3))
    reference = np.broadcast_to(r, body.shape).copy()
    whole = wahba_estimate(body, reference, noise_std=1e-3)
    assert whole.validity.shape == (2, 4)
    assert whole.valid.all()
    std = np.full((2, 3), 1e-3)
    weights = 1.0 / np.hypot(*std) ** 2
    assert np.array_equal(whole.q, wahba_quaternion(body, reference, weights))
    assert np.array_equal(whole.covariance, wahba_covariance(body, reference, std))
    tested = consistency(body, reference, std)
    assert np.array_equal(whole.consistency.probability, tested.probability)
    body[0, 0, 1, 2] = np.nan
    body[0, 1, 2] = 0.0
    reference[0, 2] = reference[0, 2, :1]
    body[1, 0], reference[1, 0] = np.eye(3), -np.eye(3)
    body[1, 1, 0] = -body[1, 1, 0]
    found = wahba_estimate(body, reference, noise_std=1e-3)
    bad = Validity
    expected = [[bad.NOT_FINITE, bad.LENGTH, bad.COLLINEAR, bad.VALID],
                [bad.AMBIGUOUS, bad.INCONSISTENT, bad.VALID, bad.VALID]]  # fmt: skip
    assert found.validity.tolist() == expected
    for array, before in (
        (found.q, whole.q), (found.covariance, whole.covariance),
    ):  # fmt: skip
        assert np.array_equal(array[found.valid], before[found.valid])
        assert np.isnan(array[~found.valid]).all()
    # what the test was made of says so, where it was made
    assert found.consistency.probability[1, 1] < 1e-300
    assert np.isnan(found.consistency.statistic).sum() == 4
    alone = wahba_estimate(body, reference)
    assert alone.validity[1, 1] == Validity.VALID  # cannot be judged without the noise
    assert alone.covariance is alone.consistency is None
    for refusing in (wahba_quaternion, lambda *given: consistency(*given, std)):
        with pytest.raises(InputError, match=r"^[45] of 8 .* \(0, 0\).*`wahba_estim"):
            refusing(body, reference)


def eigenvector(b, r, weights):
    """The eigenvector of K of 40 digits, from the same numbers."""
    with mpmath.workdps(40):
        unit_b, unit_r = (
            mpmath.matrix([list(v / mpmath.norm(v)) for v in map(mpmath.matrix, given)])
            for given in (b.tolist(), r.tolist())
        )
        B = unit_b.T * mpmath.diag(weights.tolist()) * unit_r
        trace = B[0, 0] + B[1, 1] + B[2, 2]
        z = [B[2, 1] - B[1, 2], B[0, 2] - B[2, 0], B[1, 0] - B[0, 1]]
        K = mpmath.matrix(4)
        for i, j in np.ndindex(3, 3):
            K[i, j] = B[i, j] + B[j, i] - (trace if i == j else 0)
        for i in range(3):
            K[i, 3] = K[3, i] = -z[i]
        K[3, 3] = trace
        q = mpmath.eigsy(K)[1][:, 3]
        return q * mpmath.sign(q[3])


@pytest.mark.parametrize("sine", [1e-5, 1e-6, 1e-8])
@pytest.mark.parametrize("sigma", [0.0, 0.3])
def test_two_pairs_keep_their_digits_near_a_parallel(sine, sigma):
    """Rounding costs eps over the sine; by the eigenvectors of K over its square.

    Each vector is known to eps, a normalisation and a difference to as much: of four
    vectors 8 eps in all, over the sine. Below a sine of 1e-7 the faces refuse.
    """
    rng, q, _, r = problem(80, 2)
    lost = []
    for _ in range(8):
        across = normalize(cross(r[0], rng.standard_normal(3)))
        vectors = np.stack([r[0], r[0] + sine * across])
        body = vectors @ attitude_matrix(q).T
        body[1] += sigma * sine * rng.standard_normal(3)
        weights = rng.uniform(0.1, 3.0, 2)
        true = eigenvector(body, vectors, weights)
        block = np.concatenate([*body, *vectors]).repeat(2).reshape(12, 2)
        kernel.normalize_vectors(block)
        kernel.fit_pairs(block, weights[:, None].repeat(2, 1))
        raw = kernel.best_quaternion(kernel.column_matrix(block, symmetric=False))
        found = [kernel.normalize_columns(raw)[:, 0]]
        found[0] *= np.sign(found[0][3])
        if sine > MIN_SINE:
            found += [
                wahba_quaternion(body, vectors, weights),
                two_vector_quaternion(*body, *vectors, weights=weights),
            ]
        K = profile_matrix(normalize(body), normalize(vectors), weights)
        top = np.linalg.eigh(K)[1][:, 3]
        *errors, by_K = (
            float(mpmath.norm(mpmath.matrix(each) - true))
            for each in (*found, top * np.sign(top[3]))
        )
        assert max(errors) < 8 * 2.0**-52 / sine
        lost.append(by_K)
    assert max(lost) > 1000 * 8 * 2.0**-52 / sine  # the test has power


@pytest.mark.parametrize("frame", ["optimal", "best", "combined", "plain"])
@pytest.mark.parametrize("sigma", [1e-7, 0.3])
def test_weighted_closed_form_is_the_optimum(frame, sigma):
    rng, _, b, r = problem(60, 2)
    body = b + sigma * rng.standard_normal((500, 2, 3))
    weights = rng.uniform(0.01, 10.0, (500, 2))
    options = {"weights": weights, "length_tolerance": np.inf}
    closed = two_vector_quaternion(body[:, 0], body[:, 1], *r, frame, **options)
    K = profile_matrix(unit(body), np.broadcast_to(r, body.shape), weights)
    optimum = np.linalg.eigh(K)[1][..., 3]
    cosine = np.abs(np.sum(closed * optimum, axis=1))
    # angles below 1e-7 do not show in a cosine
    assert 1.0 - cosine.min() < 1e-13
    # by the loss, to which an attitude error of d adds d^2
    loss = [
        np.sum(weights * np.sum((unit(body) - turned(q, r)) ** 2, axis=2), axis=1)
        for q in (closed, optimum)
    ]
    # residuals of sigma, each rounded by eps, times weights up to 10
    assert loss[0] == pytest.approx(loss[1], abs=40 * 2.0**-52 * sigma * 10)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def turned(q, r):
    return np.einsum("nij,kj->nki", attitude_matrix(q), r)


def test_a_bound_with_a_reference_that_is_known():
    """The bound with almost no reference noise tends to that with none."""
    _, q, _, r = problem(70, 3)
    body = [0.01, 0.02, 0.03]
    known = wahba_bound(q, r, [*body, 0.0, 0.0, 0.0]).rotation
    nearly = wahba_bound(q, r, [*body, 1e-8, 1e-8, 1e-8]).rotation
    assert nearly == pytest.approx(known, rel=1e-9)  # (1e-8 / 0.01)^2 and rounding
    with pytest.raises(InputError, match="without noise"):
        wahba_bound(q, r, [0.0, 0.02, 0.03, 0.0, 0.0, 0.0])


def test_where_first_order_fails_a_covariance_is_not_judged():
    parameters = attitude_vectors.Parameters(ratio=100.0, samples=4096)
    found = attitude_vectors.run(parameters, Streams(1, (1,))).rows
    rows = {str(row.statistic): row for row in found}
    assert rows["nees[weighted]"].check == rows["nees[best of four]"].check == "nees"
    failed = rows["nees[combined]"]
    assert failed.check == "record"
    assert failed.remainder > attitude_vectors.MOST_LEFT_OUT


def test_a_frame_that_is_singular_at_an_estimate_counts_nothing():
    setting = attitude_vectors.Setting(attitude_vectors.Parameters())
    r1, _ = setting.references
    place = ["x", "y", "z", "plain"].index(frame := setting.frames["best of four"])
    # a half turn about axis k leaves column k nothing, one about r1 the plain one
    empty = np.append(r1 if place == 3 else np.eye(3)[place], 0.0)
    found = closed_form_square(
        np.stack([setting.q, empty]), np.full((2, 3), 1e-4), setting.references,
        np.full(4, 0.01), frame,
    )  # fmt: skip
    assert found[0] > 0.0
    assert found[1] == 0.0
