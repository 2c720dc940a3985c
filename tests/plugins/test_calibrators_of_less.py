"""Calibrators that estimate fewer than nine parameters, measured by what they leave."""

import dataclasses

import numpy as np
import pytest
import rows_by_name
from places import EXAMPLES

from simval.plugins import Calibrator, PluginError, find_plugin, probe_calibrator
from simval.plugins.probe import G
from simval.poses import cube_faces
from simval.streams import Streams
from simval.studies import calibrator
from simval.verdict import judge, overall

SIX = str(EXAMPLES / "six.py")
STREAMS = Streams(1, (1,))


def fit(poses, noise_std, places):
    """Scales and biases by lengths, weighted by their noise, and their covariance."""
    theta = np.array([1.0, 1.0, 1.0, *poses.mean(axis=0)])
    if 0 in places:
        theta[:3] = 2.0 * G / np.ptp(poses, axis=0)
    for _ in range(5):  # Gauss-Newton: quadratic from a few per cent
        x = poses - theta[3:]
        length = np.linalg.norm(theta[:3] * x, axis=1)
        rows = np.concatenate([theta[:3] * x**2, -(theta[:3] ** 2) * x], axis=1)
        size = np.linalg.norm(theta[:3] ** 2 * x, axis=1)  # of the noise it carries
        J = (rows / size[:, None])[:, places]
        step = np.linalg.lstsq(J, (G - length) * length / size, rcond=None)[0]
        theta[places] += step
    return theta, noise_std**2 * np.linalg.inv(J.T @ J)


def lengths(estimates, factor=1.0, off=0.0):
    places = list(range(6)) if "scale" in estimates else [3, 4, 5]

    def calibrate(poses, g, noise_std):
        theta, covariance = fit(poses, noise_std, places)
        theta[places[-1]] += off * (noise_std > 1e-6)
        return np.diag(theta[:3]), theta[3:], factor * covariance

    return Calibrator(
        name="lengths", calibrate=calibrate, estimates=estimates, noise_std=True
    )


def rows_of(plugin, **values):
    parameters = calibrator.Parameters(algorithm="any", **values)
    return calibrator.outcome(plugin, parameters, STREAMS).rows


def named(rows):
    return {(str(row.statistic), row.predictor): row for row in rows}


LESS = (("scale", "bias"), ("bias",))


@pytest.mark.ci
@pytest.mark.parametrize("pose_set", ["sphere", "faces"])
@pytest.mark.parametrize("estimates", LESS)
def test_a_sound_calibrator_of_less_passes_in_its_own_class(estimates, pose_set):
    values = {"sensor": "own class", "pose_set": pose_set, "trials": 1024}
    rows = rows_of(lengths(estimates), **values)
    judged = judge(rows_by_name.named(rows))
    assert {v.answer for v in judged if v.row.check != "record"} == {"pass"}
    found = named(rows)
    count = 3 * len(estimates)
    assert found["nees", "claim"].prediction == count
    assert len([name for name, _ in found if name.startswith("bias[")]) == count
    share = found["efficiency[B_x]", ""]
    # on faces it does not use what it knows of the directions: of six readings two see
    # the bias of an axis along it, and all six would tell of it
    expected = 1.0 if pose_set == "sphere" else 1.0 / 3.0
    assert abs(share.value - expected) < 4 * share.standard_error
    left = found["left", "Cramer-Rao"]
    if pose_set == "sphere":  # the bound itself, but for the next order in the noise
        assert abs(left.value - left.prediction) < 4 * left.standard_error
    assert left.value > left.prediction - 4 * left.standard_error


@pytest.mark.ci
@pytest.mark.parametrize(
    ("wrong", "what"),
    [({"factor": 1.3}, "nees"), ({"off": 2e-3}, "bias[B_z]")],
)
def test_a_wrong_calibrator_of_less_fails(wrong, what):
    plugin = lengths(("scale", "bias"), **wrong)
    assert what in failed(plugin, sensor="own class", trials=512)


@pytest.mark.ci
@pytest.mark.parametrize("pose_set", ["sphere", "faces"])
@pytest.mark.parametrize("estimates", LESS)
def test_of_the_full_sensor_it_is_judged_by_what_its_class_converges_to(
    estimates, pose_set
):
    plugin = lengths(estimates)
    rows = rows_of(plugin, pose_set=pose_set, trials=256)
    verdicts = judge(rows_by_name.named(rows))
    assert overall(verdicts) != "fail"
    found = named(rows)
    least = found["left", "best of its class"]
    assert least.value > least.prediction  # an inequality, not a test
    assert least.value < 1.01 * least.prediction
    nees = found["nees", "claim"]
    assert nees.check == "record"
    # what a right covariance of noise alone makes of the misalignment, as documented
    told = {("scale", "sphere"): 89.0, ("scale", "faces"): 20.0}
    expected = told.get((estimates[0], pose_set))
    assert expected is None or abs(nees.value - expected) < 4 * nees.standard_error + 1
    nine = found.get(("left", "Cramer-Rao, nine parameters"))
    assert (nine is None) == (pose_set == "faces")
    if nine is not None:
        assert nine.value > 20 * nine.prediction
    settled = [row for name, row in found.items() if name[0].startswith("settled")]
    assert len(settled) == len(estimates) * 3
    assert all(row.value <= row.prediction for row in settled)
    # power: a tenth of what is left, put into one bias
    off = lengths(estimates, off=0.02)
    assert "settled[B_z]" in failed(off, pose_set=pose_set, trials=32)


def failed(plugin, **values):
    rows = rows_of(plugin, **values)
    verdicts = judge(rows_by_name.named(rows))
    return {str(v.row.statistic) for v in verdicts if v.answer == "fail"}


@pytest.mark.ci
def test_what_goes_wrong_in_noise_alone_is_seen_of_the_full_sensor():
    sound, calls = lengths(("scale", "bias")), []

    def late(poses, g, noise_std):
        matrix, bias, covariance = sound.calibrate(poses, g, noise_std)
        calls.append(poses)
        return matrix, bias + 2e-3 * (len(calls) > 2), covariance

    plugin = dataclasses.replace(sound, calibrate=late)
    found = failed(plugin, trials=512)
    assert {"bias[B_x]", "bias[B_y]", "bias[B_z]"} <= found
    assert not any(name.startswith("settled") for name in found)


def test_all_nine_are_set_beside_what_they_leave():
    plugin = find_plugin(str(EXAMPLES / "ellipsoid.py"), Calibrator)
    found = named(rows_of(plugin, trials=512))
    left = found["left", "Cramer-Rao"]
    # linear least squares weighs scales of 7 % difference wrongly, by 2 % at the most
    assert left.prediction * 0.98 < left.value < 1.06 * left.prediction


@pytest.mark.ci
def test_six_positions_are_the_example_of_the_documentation():
    plugin = find_plugin(SIX, Calibrator)
    assert probe_calibrator(plugin, cube_faces()) < 1e-14
    for poses in (6, 24):
        values = {"pose_set": "faces", "poses": poses, "trials": 512}
        found = named(rows_of(plugin, **values))
        assert found["left", "best of its class"].value == pytest.approx(
            0.2447, abs=4e-4
        )


@pytest.mark.parametrize(
    ("plugin", "values", "words"),
    [
        (SIX, {}, r'not finite|set `calibrator.pose_set = "faces"`'),
        (
            "ellipsoid.py",
            {"pose_set": "faces"},
            "nine parameters, of which the six|six",
        ),
    ],
)
def test_poses_that_do_not_fit_are_refused_with_the_others(plugin, values, words):
    plugin = find_plugin(str(EXAMPLES / plugin), Calibrator)
    with pytest.raises(PluginError, match=words):
        rows_of(plugin, trials=32, **values)


EYE, ZERO = np.eye(3), np.zeros(3)


@pytest.mark.parametrize(
    ("estimates", "answer", "words"),
    [
        (
            ("scale", "bias"),
            (EYE + 1e-6 * np.eye(3, k=1), ZERO),
            "must be diagonal, bu",
        ),
        (("scale", "bias"), (EYE[::-1], ZERO), "diagonal, but it has 1 in row 0, colu"),
        (("scale", "bias"), (np.zeros((3, 3)), ZERO), "true parameters|finite"),
        (("scale", "bias"), (EYE, ZERO, np.eye(9)), r"shape \(9, 9\); .* \(6, 6\)"),
        (("scale", "bias"), (EYE, ZERO, -np.eye(6)), "not positive definite"),
        (("bias",), (1.001 * EYE, ZERO), "unit matrix, but it has 1.001 in row 0, col"),
        (("bias",), (EYE, ZERO, np.eye(6)), r"shape \(6, 6\); .* \(3, 3\)"),
        (("bias",), (EYE, 0.3), r"B as float of shape \(\)"),
        (
            ("bias",),
            {"matrix": EYE, "B": ZERO, "covariance_kind": "type A", "dof": 4},
            "5 or more: use 8 poses or more",
        ),
    ],
)
def test_an_answer_outside_the_class_is_refused(estimates, answer, words):
    plugin = Calibrator(name="c", calibrate=lambda p, g: answer, estimates=estimates)
    with pytest.raises(PluginError, match=words):
        probe_calibrator(plugin)


def test_an_answer_that_never_varies_is_no_estimate():
    """It is right about the sensor of the study, and looks at no reading."""

    def constant(poses, g, noise_std):
        if noise_std < 1e-6:  # the probes, which have other sensors
            return lengths(("scale", "bias")).calibrate(poses, g, noise_std)[:2]
        return np.diag([2.06, 1.92, 2.1]), np.array([0.3, -0.2, 0.1])

    def of_one(poses, g, noise_std):
        matrix, bias, _ = lengths(("scale", "bias")).calibrate(poses, g, noise_std)
        return matrix, np.array([*bias[:2], bias[2] if noise_std < 1e-6 else 0.1])

    for calibrate, name in ((constant, "K_x"), (of_one, "B_z")):
        plugin = Calibrator(
            name="still",
            calibrate=calibrate,
            estimates=("scale", "bias"),
            noise_std=True,
        )
        with pytest.raises(PluginError, match=rf"still gives the same {name} in all"):
            rows_of(plugin, sensor="own class", trials=64)
