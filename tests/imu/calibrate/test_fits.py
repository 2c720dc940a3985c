"""What holds of every calibration, whatever the sensors: one property, all fits.

False alarms: one in 1e4 for all cases of a test together, unless said otherwise.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from fits import (
    CASES,
    CLEAN,
    DIP,
    FIELD,
    FIELD_STD,
    MARGIN,
    MEANS,
    POSE_STD,
    RESTS,
    TIME,
    WALK,
    WALKING,
    H,
    drawn,
    parameters,
    sd,
    taken,
)
from magnetometer_sets import squares
from scipy import stats
from scipy.spatial.transform import Rotation

from simval.errors import ConvergenceError, InputError, SimvalError
from simval.imu.calibrate import load_calibration, save_calibration
from simval.imu.calibrate.files import load_others
from simval.imu.sensor import MODELS

EVERY = pytest.mark.parametrize("case", CASES.values(), ids=CASES)
SINGLE = [name for name, case in CASES.items() if case.estimator == "joint"]
ONE = pytest.mark.parametrize("case", [CASES[name] for name in SINGLE], ids=SINGLE)
POSES = [name for name, case in CASES.items() if "rates" not in case.sources]
STILL = pytest.mark.parametrize("case", [CASES[name] for name in POSES], ids=POSES)


@EVERY
def test_readings_without_noise_give_the_truth(case):
    readings = taken(drawn(case, 1, np.random.default_rng(0), times=0.0), 0)
    fit = case.fit(readings, times=1e-6)
    assert fit.status == "converged"
    size = case.units({"poses": 1.0, "rates": 1.0, "fields": 1000.0 / FIELD})
    # rounding of readings of 10, or of 500 counts, times a condition of some hundreds
    assert np.abs((parameters(fit) - case.truth) / size).max() < 1e-12
    assert np.all(fit.iterations <= 4)


@EVERY
def test_a_batch_is_its_trials(case):
    """Readings without noise, with some and with much, each as if it were alone."""
    readings = drawn(case, 4, np.random.default_rng(1))
    size = np.array([0.0 if case.known else 0.1, 1.0, 1.0, 30.0])[:, None, None]
    for name, values in readings.items():
        values[:] = CLEAN[name] + size * (values - CLEAN[name])
    batch = case.fit(readings)
    assert batch.converged.all()
    for k in range(4):
        alone = case.fit(taken(readings, slice(k, k + 1)))
        np.testing.assert_array_equal(parameters(batch)[k], parameters(alone)[0])
        np.testing.assert_array_equal(batch.covariance[k], alone.covariance[0])
    single = case.fit(taken(readings, 1))
    off = (parameters(single) - parameters(batch)[1]) / sd(batch)[1]
    assert np.abs(off).max() < 1e-6


@EVERY
def test_a_trial_that_cannot_be_fitted_is_set_aside(case):
    readings = drawn(case, 4, np.random.default_rng(2))
    good = case.fit(readings)
    if "rates" in case.sources:
        readings["rates"][1:3, :, 2] = 0.0  # an axis that reads nothing
    else:
        for values in readings.values():
            values[2] = np.linspace(0.0, 1.0, len(values[2]))[:, None] * values[2, 0]
        readings[case.sources[-1]][1, 7, 2] = np.nan
    found = case.fit(readings)
    assert list(found.converged) == [True, False, False, True]
    assert all(status.startswith("refused") for status in found.status[1:3])
    assert np.isnan(found.parameters[1:3]).any(axis=1).all()
    assert np.isnan(found.covariance[1:3]).all()
    np.testing.assert_array_equal(found.parameters[[0, 3]], good.parameters[[0, 3]])
    with pytest.raises(ConvergenceError, match=r"2 trials did not .*trial 1"):
        found.require_converged()
    if "rates" not in case.sources:
        with pytest.raises(InputError, match="batch of 4"):
            found.sensor()
        for k in (1, 2):
            with pytest.raises(SimvalError):
                case.fit(taken(readings, k))


@pytest.mark.parametrize("form", MODELS)
@pytest.mark.parametrize("name", ["accelerometer, triangular", "gyroscope, joint"])
def test_a_fit_in_another_form_is_that_of_the_form(name, form):
    readings = taken(drawn(CASES[name], 1, np.random.default_rng(5)), 0)
    own = replace(CASES[name], form=form).fit(readings)
    carried = CASES[name].fit(readings).to_form(form)
    assert carried.names == own.names
    if name.startswith("accelerometer"):
        inverse = np.linalg.inv(own.K) if form == "symmetric" else 1.0 / own.K
        np.testing.assert_array_equal(own.sensor_scale, inverse)
    # a gyroscope's stops 1e-5 of a standard deviation from the minimum
    assert np.abs((carried.parameters - own.parameters) / own.sd).max() < 1e-3
    size = np.sqrt(own.covariance.diagonal())
    off = (carried.covariance - own.covariance) / np.outer(size, size)
    assert np.abs(off).max() < 1e-4


@STILL
def test_the_order_of_poses_does_not_matter(case):
    readings = taken(drawn(case, 1, np.random.default_rng(3)), 0)
    order = np.random.default_rng(4).permutation(len(RESTS))
    one, other = case.fit(readings), case.fit(taken(readings, order))
    assert np.abs((one.parameters - other.parameters) / one.sd).max() < 1e-7
    np.testing.assert_allclose(other.sd, one.sd, rtol=1e-9)


@EVERY
def test_units_change_units_only(case):
    """Readings of each sensor in a unit of its own."""
    readings = drawn(case, 2, np.random.default_rng(5))
    scale = {"poses": 1670.3, "rates": 1.7e4, "fields": 3e-5}
    one = case.fit(readings)
    other = case.fit({k: scale[k] * v for k, v in readings.items()}, scale=scale)
    size = case.units(scale)
    off = parameters(other) / size - parameters(one)
    assert np.abs(off / sd(one)).max() < 1e-5  # where the iterations end
    np.testing.assert_allclose(sd(other) / size, sd(one), rtol=1e-6)


# what a turn of the accelerometer's axes does to another sensor is left out
TURNED = [
    (name, source)
    for name, case in CASES.items()
    for source in case.sources
    if source != "poses" or case.sources == ("poses",)
]


@pytest.mark.parametrize(("name", "source"), TURNED)
def test_a_turn_of_a_sensors_axes_turns_its_matrix(name, source):
    """And nothing else: of the accelerometer the ellipsoid, whose gauge is the form."""
    case = CASES[name]
    readings = drawn(case, 1, np.random.default_rng(6))
    R = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    turned = readings | {source: readings[source] @ R.T}
    one = case.fit(readings)
    if source == "poses":
        other = case.fit(turned)
        gram = [np.swapaxes(f.matrix, 1, 2) @ f.matrix for f in (one, other)]
        np.testing.assert_allclose(gram[1], R @ gram[0] @ R.T, atol=1e-9)
        np.testing.assert_allclose(other.B, one.B @ R.T, atol=1e-9)
        return
    other = case.fit(turned, start=R.T if source == "rates" else None)
    want = parameters(one)[0].copy()
    first = {"rates": 9, "fields": len(want) - 13}[source]
    own = slice(first, first + 9)
    want[own] = (want[own].reshape(3, 3) @ R.T).ravel()
    want[first + 9 : first + 12] = R @ want[first + 9 : first + 12]
    off = (parameters(other)[0] - want) / sd(other)[0]
    assert np.abs(off).max() < 1e-5


# the covariance, by what each noise moves

PIECES, LAST, ROWS = 6, len(RESTS) - 1, len(TIME)
# rows of each rest's mean, as `inter_rest_rotations` says; of its ends the rotations
# have some
KNOWN = [
    slice(a + MARGIN * (k > 0), b - MARGIN * (k < LAST))
    for k, (a, b) in enumerate(RESTS)
]
PARTS = np.split(np.arange(ROWS), [end for k in KNOWN for end in (k.start, k.stop)])
MOVES = [few for rows in PARTS[2:-1:2] for few in np.array_split(rows, PIECES)]


def on_axes(columns):
    """Each column of rows on each axis: (3 m, rows, 3)."""
    return np.einsum("mt,ab->matb", columns, np.eye(3)).reshape(-1, ROWS, 3)


def white(N, pieces):
    """Noise that each few rows, or those of a part of a rest, have in their sum."""
    rests = [few for rows in PARTS[1::2] for few in np.array_split(rows, pieces)]
    groups = [*rests, *MOVES]
    each = np.zeros((len(groups), ROWS))
    for column, rows in zip(each, groups, strict=True):
        column[rows] = N / np.sqrt(H * len(rows))
    return on_axes(each)


def walk(K):
    """Steps of the bias, less its weighted mean over the rests, which is `B`.

    It walks in the moves, and for a rest, whose mean counts in its middle, before and
    behind it.
    """
    at = np.arange(ROWS)
    each = [np.clip((at - few[0] + 0.5) / len(few), 0.0, 1.0) for few in MOVES]
    size = [np.sqrt(H * len(few)) for few in MOVES]
    for rest in KNOWN:
        each += [1.0 * (at >= rest.start), 1.0 * (at >= rest.stop)]
        size += [np.sqrt(0.5 * H * (rest.stop - rest.start))] * 2
    each = K * np.array(size)[:, None] * np.array(each)
    held = np.stack([each[:, rows].mean(axis=1) for rows in KNOWN], axis=1)
    weights = np.array([rest.stop - rest.start for rest in KNOWN])
    return on_axes(each - (held @ weights / weights.sum())[:, None])


def unit_noises(case):
    """Every noise that the readings have, one a trial, and before them none."""
    each = {"poses": POSE_STD, "fields": FIELD_STD}
    noises = {
        name: each[name] * np.eye(CLEAN[name].size).reshape(-1, *CLEAN[name].shape)
        for name in case.sources
        if name != "rates"
    }
    if "rates" in case.sources:
        # fifths of a rest leave the slope in it a variance 1/25 too small, which is a
        # quarter of that of a ramp
        rows = white(WALK, 5 if case.means else 1)
        noises["rates"] = (
            np.concatenate([rows, walk(case.drift)]) if case.drift else rows
        )
    count, first = 1 + sum(map(len, noises.values())), 1
    readings = {}
    for name, noise in noises.items():
        readings[name] = np.tile(CLEAN[name], (count, 1, 1))
        readings[name][first : first + len(noise)] += noise
        first += len(noise)
    return readings


# other forms are this one's, carried over
FEW = {k: v for k, v in CASES.items() if v.form == "triangular"}
BARS = {k: v for k, v in (FEW | WALKING | MEANS).items() if v.known}


LONG = "gyroscope that walks"  # that of a line between rests walks, too
EACH = [
    pytest.param(case, marks=getattr(pytest.mark, "slow" if name == LONG else "ci"))
    for name, case in BARS.items()
]


@pytest.mark.parametrize("case", EACH, ids=BARS)
def test_the_stated_covariance_is_what_each_noise_moves(case):
    """An independent route: the calibration is run again for each unit noise there is,
    and the squares of what the parameters move add up; no line of the fit's own
    linearisation, weights or noise is shared."""
    fit = case.fit(unit_noises(case))
    assert fit.converged.all()
    by = (parameters(fit)[1:] - parameters(fit)[0])[:, case.told]
    stated = fit.covariance[0][case.told, case.told]
    size = np.sqrt(np.diagonal(stated))
    off = (by.T @ by - stated) / np.outer(size, size)
    # of a walk in a move of up to 2.5 rad a mean is taken: a tenth where a move is as
    # long as a rest; white noise of a row at the end of a rest is in the move, too
    # lines between rests bend in their middles, which a ramp over the whole rest is
    # told as if it lay on one side of it
    walks = case.drift and case.bias != "line"
    rated = 0.04 if case.means and case.bias == "line" else 0.02
    close = 0.15 if walks else rated if "rates" in case.sources else 1e-3
    assert np.abs(off).max() < close


# the covariance, by Monte Carlo


@pytest.mark.ci
@pytest.mark.parametrize("case", FEW.values(), ids=FEW)
def test_error_bars_hold(case):
    """NEES, coverage and chi-square of many trials, each by its law."""
    trials = {"poses": 4000, "fields": 1500, "rates": 150}[case.sources[-1]]
    trials = 100 if len(case.sources) == 3 else trials
    fit = case.fit(drawn(case, trials, np.random.default_rng(7)))
    assert fit.converged.all()
    error = (parameters(fit) - case.truth)[:, case.told]
    covariance = fit.covariance[:, case.told, case.told]
    p, level = error.shape[1], 1e-4 / (3 * len(CASES))
    law = stats.chi2(p) if case.known else stats.f(p, fit.dof, scale=p)
    nees = squares(error, covariance)
    assert stats.kstest(nees, law.cdf).pvalue > level
    assert stats.kstest(1.6 * nees, law.cdf).pvalue < level  # power: bars 1.26 narrow
    low, high = np.moveaxis(fit.confidence_intervals(0.9), -1, 0)
    inside = (low <= case.truth[-low.shape[1] :]) & (
        case.truth[-low.shape[1] :] <= high
    )
    inside = inside[:, : low.shape[1] if case.bias == "constant" else 9].mean(axis=1)
    error = inside.std(ddof=1) / np.sqrt(trials)
    assert abs(inside.mean() - 0.9) < stats.norm.isf(level / 2) * error
    # of an accelerometer of unknown noise there is none
    if case.known and case.estimator != "unweighted":
        value = np.sum(fit.chi2_per_dof) * fit.dof
        cut = stats.chi2.isf([1 - level / 2, level / 2], fit.dof * trials)
        assert cut[0] < value < cut[1]


# what is said of a fit


@ONE
def test_a_fit_is_kept_in_json(case, tmp_path):
    path = tmp_path / "c.json"
    fit = case.fit(taken(drawn(case, 1, np.random.default_rng(10)), 0))
    if case.sources == ("poses",):
        save_calibration(path, fit)
        again = load_calibration(path)
        for name in ("parameters", "covariance", "T", "K", "B", "rms", "cost"):
            np.testing.assert_array_equal(getattr(again, name), getattr(fit, name))
        for name in ("model", "method", "residual", "g", "dof", "covariance_kind"):
            assert getattr(again, name) == getattr(fit, name)
        return
    own = {"gyroscope": "rates", "magnetometer": "fields"}
    parts = {k: getattr(fit, k, fit) for k, name in own.items() if name in case.sources}
    written = {
        name: part.as_object() if name == "gyroscope" else part.as_document()
        for name, part in parts.items()
    }
    path.write_text(json.dumps(written, allow_nan=False))
    for name, sensor in zip(own, load_others(path), strict=True):
        assert (sensor is None) == (name not in parts)
        if sensor is not None:
            values = (sensor.M, sensor.B if name == "gyroscope" else sensor.b)
            values = np.concatenate([each.ravel() for each in values])
            first = 0 if name == "gyroscope" else 9
            np.testing.assert_array_equal(
                values, parts[name].parameters[first : first + 12]
            )
    if "magnetometer" in parts:
        part, said = parts["magnetometer"], written["magnetometer"]
        for name, value, bar in zip(part.names, part.parameters, part.sd, strict=True):
            assert said["parameters"][name] == {"value": value, "sd": bar}
        assert said["dip_deg"] == pytest.approx(np.degrees(DIP), rel=1e-4)


@EVERY
def test_freedoms_and_intervals_and_results_that_cannot_be_written(case):
    fit, n = case.fit(drawn(case, 1, np.random.default_rng(11))), len(RESTS)
    # a norm of each pose, two directions or three angles of each move, less parameters
    dof = {"poses": n - 9, "fields": 3 * n - 22, "rates": 2 * (n - 1) - 9}
    both = dof["poses"] + dof["rates"] if case.estimator == "joint" else dof["rates"]
    dof["rates"] = both
    assert fit.dof == (6 * n - 34 if len(case.sources) == 3 else dof[case.sources[-1]])
    half = np.diff(fit.confidence_intervals(0.8), axis=-1)[..., 0] / 2.0
    law = stats.norm if case.known else stats.t(fit.dof)
    np.testing.assert_allclose(half, law.ppf(0.9) * fit.sd, rtol=1e-9)
    np.testing.assert_array_equal(fit.intervals, fit.confidence_intervals(0.95))
    for level in (0.0, 1.0, np.nan):
        with pytest.raises(InputError, match="`level`"):
            fit.confidence_intervals(level)
    with pytest.raises(ValueError, match="read-only"):
        fit.parameters[0] = 1.0
