"""The whole singular set: best, combined, direct solutions, sequential rotations."""

import numpy as np
import pytest
from hypothesis import example, given
from rounding import EPS
from scipy.spatial.transform import Rotation
from strategies_attitude import Problem, problems

from simval.geometry import attitude_error, attitude_matrix, normalize
from simval.imu.attitude import estimate_attitude, two_vector_quaternion
from simval.imu.attitude.kernel import FRAMES, raw_quaternion
from simval.imu.attitude.singular import (
    Case,
    case_quaternion,
    sequential_quaternion,
    singular_solution,
    turn_is_singular,
)

X, Y, _ = np.eye(3)
HALF_TURN = Problem(np.array([1.0, 0, 0, 0]), np.stack([X, -Y, X, Y]))
IDENTITY = Problem(np.array([0, 0, 0, 1.0]), np.stack([X, Y, X, Y]))


def norms(problem):
    block = problem.vectors.reshape(12, 1)
    return np.array([np.linalg.norm(raw_quaternion(block, f)) for f in FRAMES])


@pytest.mark.ci
@given(problem=problems())
@example(problem=IDENTITY)
@example(problem=HALF_TURN)
def test_near_any_singular_attitude(problem):
    lengths = norms(problem)
    # vectors of length 1 + 2 eps at most; each norm is good to 4 eps
    assert lengths.max() >= problem.sine / 2 - 8 * EPS
    np.testing.assert_allclose(
        np.sum(lengths**2), problem.sine**2, rtol=0, atol=20 * EPS
    )
    for frame in ("best", "combined"):
        q = two_vector_quaternion(*problem.vectors, frame)
        # rounding of the inputs (2 eps each of 12) over a norm of sine / 2
        assert attitude_error(problem.q, q) * problem.sine < 50 * EPS
        assert q[3] >= 0.0
    for frame, norm in zip(FRAMES, lengths, strict=True):
        estimate = estimate_attitude(*problem.vectors, frame)
        # refused below 1e-8 of the lengths, up to rounding of the norm itself
        assert bool(estimate.valid) == (norm >= 1e-8) or abs(norm - 1e-8) < 8 * EPS
        if estimate.valid:
            assert attitude_error(problem.q, estimate.q) * norm < 50 * EPS
    found = sequential_quaternion(*problem.vectors)
    assert attitude_error(problem.q, found.q) * problem.sine < 50 * EPS
    if lengths[3] < 0.49 * problem.sine:
        assert found.turn > 0
    limit = 1e-9 * problem.sine
    for k in range(3):  # a column vanishes where its turn is singular
        singular = turn_is_singular(*problem.vectors, k, tolerance=1e-9)
        # the same length computed in another order: 8 eps apart
        assert bool(singular) == (lengths[k] <= limit) or abs(lengths[k] - limit) < (
            8 * EPS
        )


# a small turn about the normal: d1 x d2 is tiny, yet d1 and d2 are not parallel
SMALL = np.array([0.0, 0.0, np.sin(5e-10), 1.0])
SMALL_TURN = Problem(
    SMALL, np.stack([attitude_matrix(SMALL) @ X, attitude_matrix(SMALL) @ Y, X, Y])
)


@pytest.mark.ci
@given(problem=problems())
@example(problem=IDENTITY)
@example(problem=HALF_TURN)
@example(problem=SMALL_TURN)
def test_direct_solutions(problem):
    found = singular_solution(*problem.vectors)
    plain = norms(problem)[FRAMES.index("plain")]
    if found.valid:
        # within tolerance of a singular case: off by 1e-12 over the sine, times two
        # for the half angle; half turns have two equal answers
        limit = (4e-12 + 50 * EPS) / problem.sine**2
        assert attitude_error(problem.q, found.q) < limit
    else:
        assert np.isnan(found.q).all()
        # refused only where none of the singular cases holds to 1e-12, half of that
        # angle and a margin of five
        assert plain > 1e-13 * problem.sine


def cases():
    r1, r2 = normalize(np.array([[1.0, 2, -1], [0.5, -1, 2]]))
    plane = normalize(r1 + 0.3 * r2)
    for name, axis in (("B", r1), ("C", r2), ("D", plane)):
        for angle in (1e-3, 2.0, np.pi - 1e-6, np.pi, -0.3, np.pi + 1e-6):
            yield Case[name], axis, angle, r1, r2
    yield Case.A, r1, 0.0, r1, r2
    yield Case.REGULAR, np.cross(r1, r2), 1.0, r1, r2


@pytest.mark.parametrize(("case", "axis", "angle", "r1", "r2"), list(cases()))
def test_table_of_cases(case, axis, angle, r1, r2):
    axis = normalize(axis)
    q = np.append(np.sin(angle / 2) * axis, np.cos(angle / 2))
    A = attitude_matrix(q)
    found = singular_solution(A @ r1, A @ r2, r1, r2)
    assert Case(int(found.case)) is case
    if case is not Case.REGULAR:
        # rounding of the normals: 4 eps over the sine (0.85)
        assert attitude_error(q, found.q) < 40 * EPS


def test_a_half_turn_is_about_its_axis():
    """(u, 0) of b = 2 u (u r) - r: u anywhere, in the plane of r1 and r2, near one."""
    r1, r2, free = np.random.default_rng(3).standard_normal((3, 60, 3))
    r1, r2 = normalize(r1), normalize(r2)
    sine = np.linalg.norm(np.cross(r1, r2), axis=1)
    r1, r2, free = r1[sine > 0.3], r2[sine > 0.3], free[sine > 0.3]
    weights = [(1, 0), (0, 1), (1, 1e-4), (1e-4, 1), (1, 0.4), (0.4, -1), (-1, 1)]
    planes = [normalize(a * r1 + b * r2) for a, b in weights]
    plain = [normalize(free), *(np.tile(e, (len(r1), 1)) for e in np.eye(3))]
    for k, u in enumerate([*planes, *plain]):
        b1, b2 = (2.0 * u * np.vecdot(u, r)[:, None] - r for r in (r1, r2))
        half_turn = np.append(u, np.zeros((len(u), 1)), axis=1)
        found = [two_vector_quaternion(b1, b2, r1, r2, f) for f in ("best", "combined")]
        found.append(sequential_quaternion(b1, b2, r1, r2).q)
        found.append(case_quaternion(b1, b2, r1, r2))
        if k < len(planes):
            found.append(singular_solution(b1, b2, r1, r2).q)
        for q in found:
            # to either sign; rounding over the sine, and over the longer difference
            sign = np.sign(np.vecdot(q, half_turn))[:, None]
            np.testing.assert_allclose(sign * q, half_turn, rtol=0, atol=100 * EPS)


@pytest.mark.parametrize(("share", "case"), [(0.099, Case.D), (0.101, Case.REGULAR)])
@pytest.mark.parametrize("sine", [1.0, 0.3])
def test_the_tolerance_is_a_share_of_the_lengths(share, case, sine):
    # a turn about the normal has |qbar| / |n| = the sine of its half angle; d1 and d2
    # are as long, and short of the tolerance's zero only for the smaller turn
    r1, r2 = X, np.array([np.sqrt(1 - sine**2), sine, 0.0])
    A = attitude_matrix(np.array([0.0, 0.0, share, np.sqrt(1 - share**2)]))
    found = singular_solution(A @ r1, A @ r2, r1, r2, tolerance=0.1)
    assert Case(int(found.case)) is (case if case is Case.REGULAR else Case.A)


def test_the_table_is_the_smallest_turn_of_the_normals_within_its_border():
    """SciPy's smallest rotation between two vectors; beyond the border, eq. (8)."""
    rng = np.random.default_rng(7)
    r = normalize(rng.standard_normal((2, 3)))
    axis, n = normalize(r[0] + 0.4 * r[1]), np.cross(*r)
    q = np.append(np.sin(0.5) * axis, np.cos(0.5))
    vectors = np.stack([*(r @ attitude_matrix(q).T), *r])[:, None]
    vectors = vectors + 0.01 * rng.standard_normal((4, 200, 3))
    b1, b2, r1, r2 = vectors
    qbar = np.concatenate(
        [np.cross(b1 - r1, b2 - r2), np.vecdot(b1 + r1, b2 - r2)[:, None]], axis=1
    )
    far = np.linalg.norm(qbar / 4, axis=1) / np.linalg.norm(n)
    inside = case_quaternion(*vectors, 0.2)
    turns = [
        Rotation.align_vectors(r3[None], b3[None])[0].as_quat()
        for b3, r3 in zip(np.cross(b1, b2), np.cross(r1, r2), strict=True)
    ]
    assert far.max() < 0.15  # of vectors as they are; normalised ones differ by 5 %
    # one vector leaves SciPy a turn about it, which it sets to zero: 1e-8 by its root
    assert np.max(attitude_error(inside, np.array(turns))) < 1e-7
    outside = case_quaternion(*vectors, 1e-9)
    assert np.max(attitude_error(outside, normalize(qbar))) < 50 * EPS / far.min()
    assert np.all(np.stack([inside, outside])[..., 3] >= 0.0)
    # both are covariant: no axis of the frames is special, as it is to half turns
    C = Rotation.from_rotvec([0.3, -2.0, 1.0])
    turned = vectors @ C.as_matrix().T
    for border, answer in ((0.2, inside), (1e-9, outside)):
        found = case_quaternion(*turned, border)
        known = np.concatenate([C.apply(answer[:, :3]), answer[:, 3:]], axis=1)
        assert np.max(attitude_error(found, known)) < 200 * EPS / far.min()
