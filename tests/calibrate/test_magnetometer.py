"""Magnetometer calibration: equations, recovery, twins, units, findings."""

import json
import re

import numpy as np
import pytest
from magnetometer_sets import (
    BODY,
    BODY_STD,
    FIELD,
    IRON,
    IRON_STD,
    G,
    made,
    normalised_squares,
    random_set,
    tilted,
)
from scipy import stats

from simval.calibrate import (
    MagnetometerFit,
    calibrate,
    calibrate_magnetometer,
    ellipsoid_then_rotation,
)
from simval.calibrate.magnetometer import equations, start
from simval.calibrate.magnetometer.calibration import Options, scale
from simval.calibrate.magnetometer.findings import even_poses
from simval.errors import ConvergenceError, InputError
from simval.sensor import MODELS, MagnetometerModel, forms

EPS = np.finfo(float).eps
NOISE = {"accelerometer_std": BODY_STD, "magnetometer_std": IRON_STD}
FORTY = random_set(40, 5)


def fitted(case, **options):
    given = {"field": FIELD, **NOISE, **options}
    return calibrate_magnetometer(case.body, case.iron, G, **given)


def noisy(case, seed=1):
    body, iron = case.noisy(1, np.random.default_rng(seed))
    return body[0], iron[0]


# the model


def test_correct_inverts_distort():
    field = np.random.default_rng(1).standard_normal((7, 2, 3)) * FIELD
    raw = IRON.distort(field, np.random.default_rng(0))
    # a backward stable solve and a product of 3 x 3: some eps times the condition
    limit = 16 * EPS * np.linalg.cond(IRON.M) * np.abs(raw).max() * np.abs(IRON.M).max()
    np.testing.assert_allclose(IRON.correct(raw), field, rtol=0, atol=limit)
    assert np.abs(raw - (field @ np.linalg.inv(IRON.M).T + IRON.b)).max() < 1e-10
    # power: another order of the two, or M transposed, is far off
    assert (
        np.abs(MagnetometerModel(M=IRON.M.T, b=IRON.b).correct(raw) - field).max() > 1
    )


def test_noise_has_its_size_and_its_stream():
    sensor = MagnetometerModel(M=IRON.M, b=IRON.b, noise_std=2.0)
    field = np.zeros((20_000, 3))
    raw = sensor.distort(field, np.random.default_rng(3)) - sensor.b
    # 60 000 squares: relative error of the variance sqrt(2/60000) = 0.6 %, 5 of them
    assert abs(np.mean(raw**2) / 4.0 - 1.0) < 5 * np.sqrt(2 / raw.size)
    again = sensor.distort(field, np.random.default_rng(3)) - sensor.b
    np.testing.assert_array_equal(raw, again)


def test_handedness():
    assert IRON.right_handed
    assert not MagnetometerModel(M=-IRON.M, b=IRON.b).right_handed
    assert MagnetometerModel(M=1e-40 * np.eye(3), b=np.zeros(3)).right_handed


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"M": np.zeros((3, 3))}, "has size 0"),
        ({"M": np.ones((3, 3))}, "singular"),
        ({"M": np.eye(2)}, "shape"),
        ({"b": np.zeros(2)}, "shape"),
        ({"b": np.zeros((4, 3))}, "shape"),
        ({"M": np.full((3, 3), np.nan)}, "non-finite"),
        ({"noise_std": -1.0}, "0 raw units or more"),
        ({"noise_std": "loud"}, "noise_std"),
    ],
)
def test_a_model_that_is_none_is_refused(change, words):
    with pytest.raises(InputError, match=words):
        MagnetometerModel(**({"M": IRON.M, "b": IRON.b} | change))


# the equations


def local_case(model):
    """Two noisy trials in scaled units, away from their solution."""
    rng = np.random.default_rng(2)
    body, iron = FORTY.noisy(2, rng)
    options = Options(
        g=G, field=1.0, model=model, hemisphere="unstated", max_iterations=9, known=None
    )
    noise = np.full(40, BODY_STD), np.full(40, IRON_STD)
    readings = scale((body, iron), noise, slice(0, 2), options).readings
    theta = start.start(model, readings, None)
    return readings, theta * (1.0 + 0.01 * rng.standard_normal(theta.shape))


@pytest.mark.parametrize("model", MODELS)
def test_jacobian_is_that_of_complex_steps(model, unchecked):
    readings, theta = local_case(model)
    found = equations.jacobian(
        model, theta, equations.corrected(model, theta, readings)
    )
    for k, e in enumerate(np.eye(22)):
        moved = theta + 1e-30j * e
        at = equations.corrected(model, moved, readings)
        exact = equations.residual(at, moved[:, 21]).imag / 1e-30
        # some products of numbers near 1
        np.testing.assert_allclose(found[..., k], exact, rtol=0, atol=1e-13)


@pytest.mark.parametrize("model", MODELS)
def test_whitener_makes_the_noise_of_the_equations_one(model, unchecked):
    readings, theta = local_case(model)
    at = equations.corrected(model, theta, readings)
    whiten = equations.whitener(at, readings)
    columns = []
    for sensor in ("accelerometer", "magnetometer"):
        for e in np.eye(3):
            moved = {k: getattr(readings, k) for k in readings.__slots__}
            moved[sensor] = moved[sensor] + 1e-30j * e
            there = equations.corrected(model, theta, equations.Readings(**moved))
            slope = equations.residual(there, theta[:, 21]).imag / 1e-30
            columns.append(slope * getattr(readings, f"{sensor}_std")[..., None])
    spread = np.stack(columns, axis=-1)
    covariance = whiten @ spread @ np.swapaxes(whiten @ spread, -1, -2)
    # two products whose factors reach 1e4 (1 / noise), cancelling to 1
    np.testing.assert_allclose(
        covariance, np.broadcast_to(np.eye(3), covariance.shape), rtol=0, atol=1e-9
    )
    # power: without the accelerometer's part of the third equation it is not one
    quiet = spread.copy()
    quiet[..., 2, :3] = 0.0
    less = whiten @ quiet @ np.swapaxes(whiten @ quiet, -1, -2)
    assert np.abs(less - np.eye(3)).max() > 1e-4


def test_readings_are_scaled_and_come_back():
    readings, _ = local_case("triangular")
    for z in (readings.accelerometer, readings.magnetometer):
        assert np.abs(z.mean(axis=1)).max() < 1e-13
        np.testing.assert_allclose(np.mean(np.sum(z * z, axis=2), axis=1), 1.0)


# recovery


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("count", [12, 40])
def test_the_start_is_exact_without_noise_and_the_fit_recovers(model, count):
    case = random_set(count, 5)
    found = fitted(case, model=model)
    assert found.status == "converged"
    assert found.iterations == 1  # a first step within 1e-8 of the error bars
    sensor = found.sensor()
    # the two sensors on the accelerometer's axes of that form: compared as what they
    # make of the readings, since forms differ by a rotation
    force = found.accelerometer().correct(case.body)
    field = sensor.correct(case.iron)
    # condition of the poses times rounding: 1e-16 times some hundreds
    np.testing.assert_allclose(np.linalg.norm(force, axis=1), G, rtol=1e-11)
    np.testing.assert_allclose(np.linalg.norm(field, axis=1), FIELD, rtol=1e-11)
    dots = np.sum(force * field, axis=1) / (G * FIELD)
    np.testing.assert_allclose(dots, -np.sin(np.radians(60.0)), rtol=1e-11)
    if model == "triangular":
        np.testing.assert_allclose(found.parameters, case.truth, rtol=0, atol=1e-9)


def test_a_batch_is_its_trials():
    body, iron = FORTY.noisy(3, np.random.default_rng(4))
    body, iron = np.tile(body, (50, 1, 1)), np.tile(iron, (50, 1, 1))  # two blocks
    batch = calibrate_magnetometer(body, iron, G, FIELD, **NOISE)
    for k in range(3):
        one = calibrate_magnetometer(body[k], iron[k], G, FIELD, **NOISE)
        np.testing.assert_array_equal(batch.parameters[k::3], [one.parameters] * 50)
        np.testing.assert_array_equal(batch.covariance[k], one.covariance)
        assert batch.chi_square[k] == one.chi_square


def test_a_trial_that_cannot_be_fitted_is_set_aside():
    body, iron = FORTY.noisy(4, np.random.default_rng(4))
    good = calibrate_magnetometer(body, iron, G, FIELD, **NOISE)
    body[1, 7, 2] = np.nan
    iron[2] = iron[2, 0] + 1e-3 * np.random.default_rng(1).standard_normal((40, 3))
    found = calibrate_magnetometer(body, iron, G, FIELD, **NOISE)
    assert found.status[1] == "refused: non-finite readings"
    assert found.status[2].startswith("refused")
    assert np.isnan(found.parameters[[1, 2]]).all()
    assert np.isnan(found.covariance[[1, 2]]).all()
    np.testing.assert_array_equal(found.parameters[[0, 3]], good.parameters[[0, 3]])
    with pytest.raises(ConvergenceError, match=r"2 trial.*trial 1"):
        found.require_converged()
    for method in (found.sensor, found.accelerometer, found.as_document):
        with pytest.raises(InputError, match="batch of 4"):
            method()


def test_units_change_units_only():
    body, iron = noisy(FORTY)
    one = calibrate_magnetometer(body, iron, G, FIELD, **NOISE)
    other = calibrate_magnetometer(
        1e3 * body, 1e-5 * iron, 1.0, 1.0,
        accelerometer_std=1e3 * BODY_STD, magnetometer_std=1e-5 * IRON_STD,
    )  # fmt: skip
    sizes = np.ones(22)
    sizes[3:6], sizes[6:9] = 1e-3 / G, 1e3
    sizes[9:18], sizes[18:21] = 1e5 / FIELD, 1e-5
    # the same numbers but for rounding, 1e-16 times the condition of the normal matrix
    np.testing.assert_allclose(other.parameters, one.parameters * sizes, rtol=1e-9)
    np.testing.assert_allclose(other.sd, one.sd * sizes, rtol=1e-8)
    assert other.chi_square == pytest.approx(one.chi_square, rel=1e-8)


@pytest.mark.ci
def test_any_order_of_the_axes_is_found():
    body, iron = noisy(FORTY)
    plain = calibrate_magnetometer(body, iron, G, FIELD, **NOISE)
    for turn in start._cube_turns():
        found = calibrate_magnetometer(body, iron @ turn.T, G, FIELD, **NOISE)
        np.testing.assert_allclose(found.M @ turn, plain.M, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.b, turn @ plain.b, rtol=0, atol=1e-7)
        assert found.dip == pytest.approx(plain.dip, abs=1e-9)


def test_the_twin_is_exact_and_the_hemisphere_picks_one():
    body, iron = noisy(FORTY)
    unstated = calibrate_magnetometer(body, iron, G, FIELD, **NOISE)
    assert "det M > 0" in unstated.assumption
    north, south = (
        calibrate_magnetometer(body, iron, G, FIELD, hemisphere=h, **NOISE)
        for h in ("north", "south")
    )
    np.testing.assert_array_equal(north.parameters, unstated.parameters)
    np.testing.assert_array_equal(south.M, -north.M)
    assert south.dip == -north.dip
    assert south.chi_square == pytest.approx(north.chi_square, rel=1e-12)
    np.testing.assert_allclose(south.sd, north.sd, rtol=1e-9)
    assert north.right_handed
    assert not south.right_handed
    assert "left-handed" in south.findings[-1]
    assert not north.findings
    # a left-handed order of columns: seen where the hemisphere is stated, only there
    mirrored = iron * [1.0, -1.0, 1.0]
    assert not calibrate_magnetometer(body, mirrored, G, FIELD, **NOISE).findings
    told = calibrate_magnetometer(body, mirrored, G, FIELD, hemisphere="north", **NOISE)
    assert "left-handed" in told.findings[-1]
    np.testing.assert_allclose(told.M[:, 1], -north.M[:, 1], rtol=1e-9)


@pytest.mark.ci
def test_a_known_accelerometer_joins_with_its_covariance():
    # 200 trials: another calibration of the accelerometer each, then twelve poses
    rng, other, twelve = np.random.default_rng(8), random_set(20, 1), random_set(12, 7)
    trials = 200
    own = calibrate(other.noisy(trials, rng)[0], G, noise_std=BODY_STD)
    body, iron = twelve.noisy(trials, rng)
    found = calibrate_magnetometer(body, iron, G, FIELD, known=own, **NOISE)
    assert found.dof == 3 * 12 + 9 - 22
    assert found.model == own.model
    assert found.converged.all()
    squares = normalised_squares(found.parameters - twelve.truth, found.covariance)
    # mean of chi-square(22) over 200: sd 0.47; one alarm in 1e4 is 3.9 of them
    assert abs(squares.mean() - 22.0) < 3.9 * np.sqrt(44.0 / trials)
    # it knows more than either alone
    assert np.all(found.sd[:, :9] <= own.sd * (1.0 + 1e-9))
    single = calibrate(other.noisy(1, rng)[0][0], G, noise_std=BODY_STD)
    one = calibrate_magnetometer(body[0], iron[0], G, FIELD, known=single, **NOISE)
    assert np.all(one.sd[:9] <= single.sd * (1.0 + 1e-9))


def test_an_accelerometer_without_covariance_is_not_known(unchecked):
    none = calibrate(noisy(random_set(20, 1))[0], G, covariance=False)
    with pytest.raises(InputError, match="no covariance"):
        fitted(FORTY, known=none)
    some = calibrate(noisy(random_set(20, 1))[0], 9.8, noise_std=BODY_STD)
    with pytest.raises(InputError, match=r"g = 9\.8 .*pass `g=known.g`"):
        fitted(FORTY, known=some)


# one trial, looked at


def test_the_weights_of_poses_are_used():
    rng = np.random.default_rng(11)
    sd = np.where(np.arange(40) < 20, 1.0, 10.0)
    body = FORTY.body + BODY_STD * rng.standard_normal((100, 40, 3))
    iron = FORTY.iron + sd[:, None] * rng.standard_normal((100, 40, 3))
    own = calibrate_magnetometer(
        body, iron, G, FIELD, accelerometer_std=BODY_STD, magnetometer_std=sd
    )
    flat = calibrate_magnetometer(body, iron, G, FIELD, **NOISE)
    square = [
        np.mean((found.parameters - FORTY.truth)[:, 9:21] ** 2, axis=0)
        for found in (own, flat)
    ]
    # half the poses are ten times as good: weighed alike they cost (1 + 100)/2 / 1.98,
    # 25 times the variance; 5 times is told from 1 in 100 trials beyond doubt
    assert np.median(square[1] / square[0]) > 5.0


@pytest.mark.ci
def test_a_disturbed_pose_is_named_and_a_clean_set_is_left_alone():
    named, clean = 0, 0
    for seed in range(40):
        body, iron = noisy(FORTY, seed)
        alone = calibrate_magnetometer(body, iron, G, FIELD, **NOISE)
        clean += bool(alone.disturbed)
        iron[[3, 17]] += [[30.0, 0.0, 0.0], [0.0, 0.0, -25.0]]  # 12 and 10 sigma
        found = calibrate_magnetometer(body, iron, G, FIELD, **NOISE)
        named += set(found.disturbed) == {3, 17}
        assert "poses 3 " in found.findings[0] or "17 " in found.findings[0]
        assert found.pose_chi_square[3] > 30.0
    # a false name in 1 of 100 clean sets: 4 or more of 40 has chance 7e-4
    assert clean < 4
    assert named >= 36  # the others name one more by chance


def test_two_disturbed_poses_are_named():
    body, iron = noisy(FORTY)
    iron[[3, 17]] += [[30.0, 0.0, 0.0], [0.0, 0.0, -25.0]]
    found = calibrate_magnetometer(body, iron, G, FIELD, **NOISE)
    assert set(found.disturbed) == {3, 17}
    rest = float(re.findall(r"without, .* is (\S+):", found.findings[0])[0])
    low, high = stats.chi2.ppf([5e-5, 1.0 - 5e-5], 92) / 92  # one alarm in 1e4
    assert low < rest < high


def test_pose_chi_squares_are_what_leaving_out_takes_off():
    body, iron = noisy(FORTY)
    whole = calibrate_magnetometer(body, iron, G, FIELD, **NOISE)
    for k in (0, 13, 39):
        keep = np.arange(40) != k
        less = calibrate_magnetometer(body[keep], iron[keep], G, FIELD, **NOISE)
        # exact for linear equations: the rest is of the order of the noise
        assert whole.chi_square - less.chi_square == pytest.approx(
            whole.pose_chi_square[k], rel=0.03, abs=0.02
        )


def test_a_field_that_is_disturbed_everywhere_is_said():
    rng = np.random.default_rng(5)
    body, iron = noisy(FORTY)
    found = calibrate_magnetometer(
        body, iron + 15.0 * rng.standard_normal((40, 3)), G, FIELD, **NOISE
    )
    assert found.status == "converged"
    assert not found.disturbed
    said = next(text for text in found.findings if "the field is disturbed" in text)
    assert "error bars would be" in said
    assert found.chi2_per_dof > 10.0


def varies_by(found):
    return float(
        re.findall(r"varies with time, by (\S+) percent", found.findings[0])[0]
    )


def test_a_field_that_varies_with_time_is_said():
    # a quiet sensor: the rise of 3 % is then known to 0.04 %
    std = {"accelerometer_std": BODY_STD, "magnetometer_std": 0.25}
    body, iron = (
        x[0] for x in FORTY.noisy(1, np.random.default_rng(1), BODY_STD, 0.25)
    )
    rising = IRON.correct(iron) * (1.0 + 0.03 * np.linspace(0.0, 1.0, 40)[:, None])
    raw = IRON.distort(rising, np.random.default_rng(0))
    found = calibrate_magnetometer(body, raw, G, FIELD, **std)
    # the trend is known to 0.1 %, and is small enough to be linear within a tenth
    assert 2.6 < varies_by(found) < 3.4
    assert not found.disturbed
    # poses in another order: the same set, and time says which
    order = np.random.default_rng(2).permutation(40)
    mixed = calibrate_magnetometer(body[order], raw[order], G, FIELD, **std)
    assert "varies with time" not in " ".join(mixed.findings)
    told = calibrate_magnetometer(
        body[order], raw[order], G, FIELD, time=60.0 * order, **std
    )
    assert varies_by(told) == varies_by(found)


@pytest.mark.ci
def test_a_steady_field_is_called_varying_as_rarely_as_stated():
    said = sum(
        "varies" in " ".join(
            calibrate_magnetometer(*noisy(FORTY, s), G, FIELD, **NOISE).findings
        )
        for s in range(100, 200)
    )  # fmt: skip
    assert said < 6  # of 100 at 1 %: twelve or more has chance 5e-4


@pytest.mark.ci
def test_strong_iron_and_poor_geometry_and_few_poses_are_said():
    body, iron = noisy(FORTY)
    shifted = calibrate_magnetometer(
        body, iron + np.array([400.0, 0.0, 0.0]), G, FIELD, **NOISE
    )
    assert "hard iron is" in shifted.findings[0]
    near = made(tilted(40, 45.0, 1))
    flat = calibrate_magnetometer(*noisy(near), G, FIELD, **NOISE)
    assert "the geometry is the limit" in flat.findings[0]
    few_poses = calibrate_magnetometer(*noisy(random_set(9, 3)), G, FIELD, **NOISE)
    assert "9 poses leave 5 degrees of freedom" in few_poses.findings[0]
    high = calibrate_magnetometer(
        body, iron, G, FIELD, accelerometer_std=BODY_STD, magnetometer_std=25.0
    )
    assert "overstated" in high.findings[0]


def test_even_poses_are_even():
    up, field = even_poses(0.8)
    np.testing.assert_allclose(np.linalg.norm(up, axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(field, axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(np.sum(up * field, axis=1), -0.8, rtol=1e-12)
    for v in (up, field):
        # 120 directions: a second moment of I/3, within some percent
        np.testing.assert_allclose(v.T @ v / len(v), np.eye(3) / 3.0, atol=0.03)


def test_the_document_is_json_and_says_all():
    case = FORTY
    body, iron = noisy(case)
    found = calibrate_magnetometer(body, iron, G, FIELD, **NOISE)
    text = json.loads(json.dumps(found.as_document(), allow_nan=False))
    assert list(text["parameters"]) == list(found.names)
    assert len(set(found.names)) == 22
    for name, value, sd in zip(found.names, found.parameters, found.sd, strict=True):
        assert text["parameters"][name] == {"value": value, "sd": sd}
    np.testing.assert_array_equal(text["M"], found.M)
    assert text["dip_deg"] == pytest.approx(60.0, abs=0.3)
    assert text["right_handed"] is True
    assert len(text["pose_chi_square"]) == 40


def test_intervals_have_their_level():
    found = fitted(FORTY)
    assert isinstance(found, MagnetometerFit)
    half = np.diff(found.confidence_intervals(0.9), axis=-1)[:, 0] / 2.0
    np.testing.assert_allclose(half, stats.norm.ppf(0.95) * found.sd, rtol=1e-9)
    with pytest.raises(InputError, match="between 0 and 1"):
        found.confidence_intervals(1.0)


# the recipe, and what is broken on purpose


def test_the_recipe_is_exact_without_noise_and_has_the_same_axes():
    found = ellipsoid_then_rotation(FORTY.body, FORTY.iron)
    expected = FORTY.truth[9:].copy()
    expected[:9] /= FIELD
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


@pytest.mark.ci
def test_broken_equations_are_seen(monkeypatch):
    """The dip's sign, M transposed, the accelerometer's noise: each moves something."""
    body, iron = FORTY.noisy(200, np.random.default_rng(3), 0.05, IRON_STD)
    noise = {"accelerometer_std": 0.05, "magnetometer_std": IRON_STD}
    sound = calibrate_magnetometer(body, iron, G, FIELD, **noise)
    squares = normalised_squares(sound.parameters - FORTY.truth, sound.covariance)
    limit = 4.5 * np.sqrt(44.0 / 200)
    assert abs(squares.mean() - 22.0) < limit
    turned = sound.parameters.copy()
    turned[:, 9:18] = np.swapaxes(sound.M, -1, -2).reshape(-1, 9)
    assert normalised_squares(turned - FORTY.truth, sound.covariance).mean() > 1e3

    original = equations.whitener

    def without_body(at, readings):
        own = original(at, readings)
        quiet = equations.Readings(
            **{k: getattr(readings, k) for k in readings.__slots__}
            | {"accelerometer_std": 1e-9 * readings.accelerometer_std}
        )
        own[..., 2, :] = original(at, quiet)[..., 2, :]
        own[..., 2, 0] = 0.0
        return own

    monkeypatch.setattr(equations, "whitener", without_body)
    broken = calibrate_magnetometer(body, iron, G, FIELD, **noise)
    squares = normalised_squares(broken.parameters - FORTY.truth, broken.covariance)
    assert squares.mean() - 22.0 > 2.0 * limit


def test_names_stand_for_their_parameters():
    found = fitted(FORTY)
    assert found.names[:9] == forms.names("triangular")
    assert found.names[9:12] == ("M_xx", "M_xy", "M_xz")
    assert found.parameters[found.names.index("M_xy")] == found.M[0, 1]
    assert found.parameters[found.names.index("b_z")] == found.b[2]
    np.testing.assert_allclose(
        found.accelerometer().matrix, BODY.matrix, rtol=1e-9, atol=1e-12
    )
