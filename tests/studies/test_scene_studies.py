"""The detector scored against true rest, and the error budget from end to end."""

from math import comb

import numpy as np
import pytest
from cells import rows_of

from simval.errors import SimvalError
from simval.geometry import attitude_error, compose, conjugate, normalize
from simval.imu.attitude import two_vector_quaternion
from simval.imu.calibrate import Recording, fit
from simval.imu.sensor import AccelerometerModel, MagnetometerModel
from simval.scene import simulate
from simval.studies import end_to_end
from simval.studies.detector import (
    STILL_FORCE,
    Rests,
    pure,
    score,
    squares_of,
    thinned,
)
from simval.studies.scene import few_faces
from simval.sweep import load_run
from simval.theory.magnetometer import magnetometer_moments
from simval.theory.propagation import PARTS, UP, calibration_parts, carrier


@pytest.fixture(autouse=True, scope="module")
def folder(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SIMVAL_CACHE", str(tmp_path_factory.mktemp("kept")))
        yield


def scored(intervals, *truth):
    # of one of two trials; the other has no intervals
    scores = score([intervals[:0], intervals], *truth)
    assert not any(values[0] for values in scores.values())
    return {family.name: values[1] for family, values in scores.items()}


def test_the_score_of_a_case_by_hand():
    still = np.array([1, 1, 1, 1, 0, 0, 1, 1, 1, 0, 0, 1, 0], bool)
    hold = np.array([0, 0, 0, -1, -1, -1, 1, 1, 1, -1, -1, -1, -1])
    intervals = np.array([[1, 3], [3, 6], [7, 10]])
    assert scored(intervals, still, hold) == {
        "precision": 5 / 8,  # rows 1 2 3 7 8 of 1 2 3 4 5 7 8 9
        "recall": 4 / 6,  # rows 1 2 7 8 of 0 1 2 6 7 8
        "rests_found": 1.0,
        "intervals": 3.0,
        "impure": 2.0,  # the second and the third
        "outside": 1.0,  # the second
    }
    np.testing.assert_array_equal(pure(intervals, still), [True, False, False])
    assert scored(intervals[:2], still, hold)["rests_found"] == 1 / 2
    assert scored(np.array([[2, 7]]), still, hold)["rests_found"] == 1.0
    nothing = scored(np.zeros((0, 2), int), still, hold)
    assert nothing["recall"] == nothing["precision"] == nothing["intervals"] == 0.0


def test_what_is_still_is_the_simulations_own_rest():
    trajectory = simulate("gimbal", poses=4)
    truth = thinned(trajectory)
    assert len(truth.time) == -(-len(trajectory.time) // 5)
    assert truth.still[truth.hold >= 0].all()
    moving = ~truth.still
    assert 0.3 < moving.mean() < 0.9
    off = np.abs(np.linalg.norm(truth.force[truth.still], axis=1) - truth.g)
    assert off.max() <= STILL_FORCE


def test_a_fit_that_cannot_be_had_is_not_a_number():
    sensor = AccelerometerModel(T=np.eye(3), K=np.ones(3), B=np.zeros(3), noise_std=1.0)
    none = Rests(np.zeros((0, 3)), np.zeros(0, int), np.zeros(0))
    assert np.isnan(squares_of([none], sensor, 9.8)).all()


@pytest.mark.ci
def test_the_parts_of_the_budget_add_up(smoke_run):
    (cell,) = load_run(smoke_run).of("end_to_end")
    rows = {str(row.statistic): row for row in cell.rows}
    assert rows["impure"].value == 0.0
    parts = [rows[f"budget[{part}]"] for part in PARTS]
    assert all(row.remainder < 1e-4 * row.prediction for row in parts)
    predicted = [row.prediction**2 for row in parts]
    # the mean over trials of a sum is the sum of the means: rounding only
    assert sum(predicted[:4]) == pytest.approx(predicted[4], rel=1e-12, abs=0)
    measured = [row.value**2 for row in parts]
    spread = [2 * row.value * row.standard_error for row in parts]
    # the cross terms of independent sources average to zero; 4.4 sigma, 1e-5
    assert abs(sum(measured[:4]) - measured[4]) < 4.4 * np.linalg.norm(spread)


def rotation_between(q, truth):
    step = compose(conjugate(truth), q)
    return 2.0 * step[:3] * np.sign(step[3])


def case(poses=12, attitudes=5):
    """Both sensors on their tumbles, and the truth of the calibration."""
    trajectory, wanted = end_to_end.tumbles(poses, attitudes)
    scenario = end_to_end.Scenario(trajectory, wanted)
    return scenario, wanted, scenario.problem(wanted.q, (1.0, 1.0))


def sensors_of(theta):
    body = AccelerometerModel.from_parameters(theta[:9])
    return body, MagnetometerModel(M=theta[9:18].reshape(3, 3), b=theta[18:21])


@pytest.mark.ci
def test_the_carriers_jacobian_is_the_derivative_of_the_whole_chain():
    """Against central differences through correction and estimator, no formula."""
    _, wanted, problem = case()
    body, iron = sensors_of(problem.theta)
    quiet = np.random.default_rng(0)
    raw = body.distort(wanted.force, quiet), iron.distort(wanted.field, quiet)

    def turned(theta, noise, k):
        models = sensors_of(theta)
        seen = [
            normalize(model.correct(rows[k] + part))
            for model, rows, part in zip(models, raw, np.split(noise, 2), strict=True)
        ]
        q = two_vector_quaternion(*seen, UP, wanted.field_world, "best")
        return rotation_between(q, wanted.q[k])

    h = 1e-5
    for k in range(5):
        by_theta, by_noise = (
            np.stack([(f(h * e) - f(-h * e)) / (2 * h) for e in np.eye(n)], axis=1)
            for n, f in (
                (22, lambda d, k=k: turned(problem.theta + d, np.zeros(6), k)),
                (6, lambda d, k=k: turned(problem.theta, d, k)),
            )
        )
        got = carrier(problem, wanted, k, 2.0, 3.0)
        # central differences: h^2 of curvature and eps / h of rounding, 1e-10 each,
        # relative to gains of up to 10
        np.testing.assert_allclose(got.jacobian, by_theta, rtol=0, atol=1e-8)
        parts = (got.force, 2.0, by_noise[:, :3]), (got.field, 3.0, by_noise[:, 3:])
        for covariance, std, gain in parts:
            expected = std**2 * gain @ gain.T
            np.testing.assert_allclose(covariance, expected, rtol=0, atol=1e-7)


@pytest.mark.ci
def test_the_calibrations_parts_are_what_moves_the_fit():
    """Against the weighted fit itself, moved one reading at a time; they add up."""
    scenario, wanted, _ = case()
    q = np.concatenate([wanted.q, end_to_end.tumbles(12, 24)[1].q])
    std = np.linspace(1e-3, 3e-3, len(q)), np.linspace(2e-3, 1e-3, len(q))
    problem = scenario.problem(q, std)
    (parts,) = calibration_parts(problem)

    def fitted(y):
        recording = Recording(
            poses=y[..., :3], fields=y[..., 3:], g=scenario.tumble.g, pose_std=std[0],
            field_std=std[1],
        )  # fmt: skip
        return fit(recording).parameters

    h = 1e-4
    steps = h * np.eye(problem.y.size).reshape(-1, *problem.y.shape)
    # the weights are taken where the readings are: a second-order change
    slopes = (fitted(problem.y + steps) - fitted(problem.y - steps)) / (2.0 * h)
    slopes = slopes.reshape(*problem.y.shape, 22)
    slopes[..., 21] *= np.cos(scenario.dip)  # of the sine
    moved = slopes * problem.sigma[..., None]
    for part, own in zip(parts, (moved[:, :3], moved[:, 3:]), strict=True):
        rows = own.reshape(-1, 22)
        size = np.sqrt(np.diagonal(parts.sum(axis=0)))
        # the solver stops at 1e-9 of a step; h^2 of curvature beside it
        expected = rows.T @ rows / np.outer(size, size)
        found = part / np.outer(size, size)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4)
    whole = magnetometer_moments(
        *scenario.sensors, q, scenario.dip,
        accelerometer_std=std[0], magnetometer_std=std[1], g=scenario.tumble.g,
    ).covariance  # fmt: skip
    scale = np.append(np.ones(21), np.cos(scenario.dip))
    bound = whole * np.outer(scale, scale)
    size = np.sqrt(np.diagonal(bound))
    off = (parts.sum(axis=0) - bound) / np.outer(size, size)
    # inverses of a matrix of condition 1e4 after scaling
    assert np.abs(off).max() < 1e-9


def test_the_true_attitude_is_what_the_true_vectors_give():
    _, wanted = end_to_end.tumbles(12, 24)
    q = two_vector_quaternion(
        normalize(wanted.force), normalize(wanted.field), UP, wanted.field_world
    )
    # rests are exact to 1e-12 of g; the estimator's condition is below 1e2
    assert attitude_error(q, wanted.q).max() < 1e-10
    with pytest.raises(SimvalError):
        end_to_end.tumbles(0, 5)


@pytest.mark.ci
def test_what_the_linear_budget_leaves_out():
    # At a relative noise of 1e-3 the two vectors' own part is off by a few squares of
    # it. The difference to the linear error of the same noise, in antithetic pairs, has
    # a standard error of 0.8 squares over all poses; `NEXT_ORDER` allows 30.
    _, wanted = end_to_end.tumbles(12, 24)
    rng, size, n = np.random.default_rng(60), 1e-3, 1000
    scale = size * np.repeat([9.80665, 1.0], 3)
    _, _, real = case(12, 24)
    ideal = real._replace(theta=np.concatenate(
        [np.zeros(3), np.ones(3), np.zeros(3), np.eye(3).ravel(), np.zeros(3), [0.0]]
    ))  # fmt: skip
    extra, linear, squares = [], [], []
    for k, q in enumerate(wanted.q):

        def error(noise, k=k, q=q):
            b1 = normalize(wanted.force[k] + noise[:, :3])
            b2 = normalize(wanted.field[k] + noise[:, 3:])
            r1, r2 = (np.broadcast_to(r, b1.shape) for r in (UP, wanted.field_world))
            step = compose(conjugate(q), two_vector_quaternion(b1, b2, r1, r2))
            return 2.0 * step[:, :3] * np.sign(step[:, 3:])

        h = 1e-2 * np.diag(scale)
        J = (error(h) - error(-h)).T / 2.0 / (1e-2 * scale)
        noise = scale * rng.standard_normal((n, 6))
        first, both = noise @ J.T, np.stack([error(noise), error(-noise)])
        carried = carrier(ideal, wanted, k, scale[0], scale[3])
        covariance = carried.parts(np.zeros((2, 22, 22)))[4]
        extra.append(np.mean(np.sum(both**2, axis=-1)) - np.mean(np.sum(first**2, -1)))
        linear.append(np.trace(covariance))
        inverse = np.linalg.inv(covariance)
        nees = [np.einsum("...i,ij,...j->...", v, inverse, v) for v in (both, first)]
        squares.append((np.mean(nees[0]) - np.mean(nees[1])) / 3.0)
    assert abs(np.mean(extra) / np.mean(linear)) / 2.0 < end_to_end.NEXT_ORDER * size**2
    assert abs(np.mean(squares)) < end_to_end.NEXT_ORDER * size**2


@pytest.mark.parametrize("throws", [9, 22, 40])
def test_faces_of_a_die_by_counting(throws):
    """Sets of k faces, less what misses some of them (inclusion and exclusion)."""
    few = sum(
        comb(14, k) * sum((-1) ** j * comb(k, j) * (k - j) ** throws for j in range(k))
        for k in range(1, 9)
    )
    assert few_faces(throws) == pytest.approx(few / 14**throws, rel=1e-9)


@pytest.mark.ci
@pytest.mark.parametrize(("poses", "check"), [(12, "record"), (40, "exact")])
def test_the_rank_of_a_few_throws_is_no_promise(poses, check):
    rank = rows_of("scene", 1, scene="die", poses=poses)["rank"]
    assert (rank.check, bool(rank.outside)) == (check, check == "record")
