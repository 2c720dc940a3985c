"""Theory of a magnetometer's calibration: bias and the recipe, by other routes."""

import numpy as np
import pytest
from magnetometer_sets import (
    BODY,
    BODY_STD,
    FIELD,
    IRON,
    IRON_STD,
    G,
    compass_of,
    made,
    random_sensors,
    random_set,
    tilted,
)

from simval.errors import GeometryError, InputError
from simval.geometry import random_quaternions
from simval.imu.calibrate import ellipsoid_then_rotation
from simval.imu.sensor import MODELS, AccelerometerModel, MagnetometerModel
from simval.theory import magnetometer as own
from simval.theory import magnetometer_moments
from simval.theory.estimating import Block, Estimating

NOISE = {"accelerometer_std": BODY_STD, "magnetometer_std": IRON_STD}
UNITS = {"g": G, "field": FIELD}


def predicted(case, dip_deg=60.0, body=BODY, iron=IRON, **options):
    given = {**NOISE, **UNITS, **options}
    return magnetometer_moments(body, iron, case.q, np.radians(dip_deg), **given)


@pytest.mark.ci
def test_the_fit_states_the_same_covariance():
    case = random_set(40, 5)
    fit = compass_of(case.body, case.iron)
    found = predicted(case)
    outer = np.outer(found.sd, found.sd)
    np.testing.assert_allclose(
        fit.covariance / outer, found.covariance / outer, rtol=0, atol=1e-9
    )
    assert found.names == fit.names


@pytest.mark.parametrize("form", MODELS)
def test_other_forms_are_the_same_sensor(form):
    case = random_set(20, 5)
    fit = compass_of(case.body, case.iron, model=form)
    found = predicted(case, form=form)
    assert found.names == fit.names
    np.testing.assert_allclose(found.sd, fit.sd, rtol=1e-8)
    np.testing.assert_allclose(predicted(case).sd[-4:], found.sd[-4:], rtol=1e-8)


def antithetic(case, truth, trials, seed, body_std, iron_std):
    """Mean of pairs of opposite noise, and its standard error: odd terms cancel."""
    rng = np.random.default_rng(seed)
    shape = (trials, *case.body.shape)
    a, m = body_std * rng.standard_normal(shape), iron_std * rng.standard_normal(shape)
    pair = [
        compass_of(
            case.body + s * a, case.iron + s * m, pose_std=body_std, field_std=iron_std
        ).require_converged().parameters - truth
        for s in (1.0, -1.0)
    ]  # fmt: skip
    mean = (pair[0] + pair[1]) / 2.0
    return mean.mean(axis=0), mean.std(axis=0) / np.sqrt(trials), pair


@pytest.mark.ci
def test_second_order_bias_is_that_of_simulation():
    case = random_set(20, 5)
    found = predicted(case)
    mean, error, _ = antithetic(case, case.truth, 1000, 6, BODY_STD, IRON_STD)
    # 22 comparisons, one alarm in 1e4: 4.6 standard errors, and what theory leaves out
    limit = 4.6 * error + found.bias_remainder
    assert np.all(np.abs(mean - found.bias) < limit)
    # power: without it, or with the other sign, it is rejected
    assert np.any(np.abs(mean) > limit)
    assert np.any(np.abs(mean + found.bias) > limit)
    # the dip's own bias is the greatest beside its spread
    assert abs(found.bias[-1] / found.sd[-1]) > 3.0 * limit[-1] / found.sd[-1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("count", "body_std", "iron_std", "seed"),
    [
        (12, 0.01, 10.0, 1), (20, 0.01, 10.0, 2), (20, 0.2, 10.0, 3),
        (40, 0.01, 25.0, 4), (40, 0.2, 10.0, 5), (100, 0.01, 25.0, 6),
    ],
)  # fmt: skip
def test_what_is_left_out_is_within_its_statement(count, body_std, iron_std, seed):
    """Eqs. (M9), (M10) at up to ten times the usual noise, on random sensors."""
    rng = np.random.default_rng(seed)
    body, iron = random_sensors(rng)
    dip_deg = rng.uniform(0.0, 75.0)
    case = random_set(count, seed, dip_deg=dip_deg, body=body, iron=iron)
    found = predicted(
        case, dip_deg, body, iron, accelerometer_std=body_std, magnetometer_std=iron_std
    )
    trials = 80_000 // count
    mean, error, pair = antithetic(case, case.truth, trials, seed, body_std, iron_std)
    assert np.all(np.abs(mean - found.bias) < 4.6 * error + found.bias_remainder)
    square = (pair[0] ** 2 + pair[1] ** 2) / 2.0 / found.sd**2
    ratio = square.mean(axis=0) - (found.bias / found.sd) ** 2
    limit = 4.6 * square.std(axis=0) / np.sqrt(trials) + found.variance_remainder
    assert np.all(np.abs(ratio - 1.0) < limit)


def test_the_recipe_s_covariance_is_that_of_its_derivatives():
    """H^-1 B H^-T against the recipe itself, differentiated reading by reading."""
    case = random_set(20, 5)
    found = predicted(case)
    columns = []
    for sensor, std in ((0, BODY_STD), (1, IRON_STD)):
        size = (G, 500.0)[sensor] * 1e-5
        for pose in range(20):
            for axis in range(3):
                pair = []
                for sign in (1.0, -1.0):
                    moved = [case.body.copy(), case.iron.copy()]
                    moved[sensor][pose, axis] += sign * size
                    pair.append(moved)
                columns.append((pair, std / (2.0 * size)))
    stacks = [
        np.array([pair[s][k] for pair, _ in columns]) for s in (0, 1) for k in (0, 1)
    ]
    ends = [ellipsoid_then_rotation(stacks[2 * s], stacks[2 * s + 1]) for s in (0, 1)]
    slope = (ends[0] - ends[1]) * np.array([weight for _, weight in columns])[:, None]
    slope[:, :9] *= FIELD
    covariance = slope.T @ slope
    sd = found.sd[9:]
    # central differences: third derivatives times 1e-10, rounding 1e-11
    np.testing.assert_allclose(
        covariance / np.outer(sd, sd), found.recipe[9:, 9:] / np.outer(sd, sd),
        rtol=1e-5, atol=1e-5,
    )  # fmt: skip


@pytest.mark.ci
def test_what_the_recipe_costs_depends_on_the_dip():
    ratios = {}
    for dip_deg in (0.0, 66.0, 80.0):
        case = random_set(40, 3, dip_deg=dip_deg)
        found = predicted(case, dip_deg)
        ratio = np.diagonal(found.recipe) / np.diagonal(found.covariance)
        assert np.all(ratio[9:] > 1.0 - 1e-9)
        ratios[dip_deg] = ratio[9:18].mean()
    # the angle between the two vectors tells the more of M the steeper the field
    assert 1.2 < ratios[0.0] < 2.0
    assert 2.3 < ratios[66.0] < 3.5  # as published for middle latitudes: 2.9
    assert ratios[80.0] > 5.0


def test_eight_poses_have_rank_and_seven_have_not():
    case = random_set(8, 1)
    assert np.all(predicted(case).sd > 0.0)
    with pytest.raises(GeometryError, match="rank 21 of 22"):
        predicted(made(case.q[:7]))


@pytest.mark.parametrize(
    ("q", "rank"), [(tilted(40, 0.0, 1), 9), (random_set(7, 2).q, 21)]
)
def test_singular_sets_have_their_rank(q, rank):
    with pytest.raises(GeometryError, match=f"rank {rank} of 22"):
        predicted(made(q))


def test_what_no_theory_is_made_of_is_refused():
    case = random_set(12, 1)
    for change in ({"dip_deg": 90.0}, {"accelerometer_std": 0.0}):
        with pytest.raises(InputError, match=r"shows a heading|a noise is 0"):
            predicted(case, **change)


def test_even_attitudes_are_the_scale_of_what_is_left_out():
    body = AccelerometerModel(T=np.eye(3), K=np.ones(3), B=np.zeros(3))
    iron = MagnetometerModel(M=np.eye(3), b=np.zeros(3))
    for dip_deg in (0.0, 45.0, 89.0):
        q = random_quaternions(1000, np.random.default_rng(1))
        problem = own.problem_of(
            body, iron, q, np.radians(dip_deg), 1e-6, 1e-3,
            g=1.0, field=1.0, form="triangular",
        )  # fmt: skip
        covariance = own.inverse_of(own.equations_of(problem).information.sum(axis=0))
        carry = own._natural(problem)
        worst = np.sqrt(np.max(np.diagonal(carry @ covariance @ carry.T)))
        # the 2.4 of eq. (M9); 1000 random attitudes are even within some percent
        assert worst * np.sqrt(1000) / 1e-3 == pytest.approx(own.EVEN, rel=0.06)


@pytest.mark.parametrize("dip_deg", [60.0, -35.0])
def test_the_dip_is_as_biased_as_one_that_is_a_parameter(dip_deg):
    """Rows in the dip itself: its bias needs no second derivative of an arcsine."""
    case, dip = random_set(20, 5, dip_deg=dip_deg), np.radians(dip_deg)
    problem = own.problem_of(
        BODY, IRON, case.q, dip, BODY_STD, IRON_STD, form="triangular", **UNITS
    )

    def rows(theta, y):
        sine = np.sin(theta[:, 21:])
        return own.equations(problem, np.concatenate([theta[:, :21], sine], axis=1), y)

    block = Block(rows=rows, y=problem.y, sigma=problem.sigma)
    direct = Estimating(blocks=(block,), theta=np.append(problem.theta[:21], dip))
    found = predicted(case, dip_deg)
    np.testing.assert_allclose(direct.bias / found.sd, found.bias / found.sd, atol=1e-9)
    # power: the arcsine's part, of the bias in standard deviations
    assert abs(np.tan(dip) * found.sd[-1]) > 1e-5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("count", "body_std", "iron_std"),
    [(12, 0.012, 0.005), (15, 0.08, 0.055), (20, 0.01, 10.0), (40, 0.2, 10.0)],
)
def test_the_square_of_all_errors_is_within_what_the_second_order_adds(
    count, body_std, iron_std
):
    """Eq. (E4) of `estimating`: noises alike add nothing, unlike ones much."""
    case = random_set(count, 5)
    noise = {"accelerometer_std": body_std, "magnetometer_std": iron_std}
    found = predicted(case, **noise)
    rng, shape = np.random.default_rng(count), (4000, *case.body.shape)
    fit = compass_of(
        case.body + body_std * rng.standard_normal(shape),
        case.iron + iron_std * rng.standard_normal(shape),
        pose_std=body_std, field_std=iron_std,
    ).require_converged()  # fmt: skip
    error = fit.parameters - case.truth
    ratio = (error - error.mean(axis=0)) / found.sd
    unit = found.covariance / np.outer(found.sd, found.sd)
    square = np.vecdot(ratio, np.linalg.solve(unit, ratio.T).T)
    off = square.mean() * 4000 / 3999 - 22.0
    # one alarm in 1e4
    limit = 3.9 * square.std() / np.sqrt(4000)
    left = own.SQUARE_NEXT * found.bent + 22.0 * found.variance_remainder
    assert abs(off) < limit + left
    if found.bent > own.RANGE:  # power: beyond the range it is seen
        assert off > limit + 0.3 * found.bent
