"""What a user's calibrator and estimator are allowed, each limit on both of its sides.

The figures stand here as the page on plug-ins and the studies state them.
"""

import dataclasses

import numpy as np
import pytest

from simval.calibrate import calibrate as package_calibrate
from simval.errors import PluginError
from simval.plugins import Calibrator, probe_calibrator
from simval.plugins.answers import calibration_of
from simval.plugins.attitudes import sound_rows
from simval.plugins.probe import probe_sensor
from simval.results import CellName
from simval.streams import Streams
from simval.studies import calibrator
from simval.verdict import judge

G = 9.80665
NOISE = 0.02
OFF = 1e-3  # of a limit


def fitted(poses, g):
    fit = package_calibrate(poses, g)
    return fit.matrix, fit.B, fit.covariance


def plugin(answer=fitted, **words):
    return Calibrator(name="mine", calibrate=answer, **words)


@pytest.fixture(scope="module")
def rows():
    values = {"algorithm": "any", "poses": 12, "noise_std": NOISE, "trials": 32}
    parameters = calibrator.Parameters(**values)
    return calibrator.outcome(plugin(), parameters, Streams(1, (1,))).rows


def named(rows, family):
    return [row for row in rows if str(row.statistic).startswith(f"{family}[")]


@pytest.mark.ci
def test_a_bias_may_be_seven_squared_noises(rows):
    """Relative to g: of a misalignment, of a scale, and of a bias in raw units."""
    K = np.abs(probe_sensor().K)
    sizes = np.array([1, 1, 1, *K, *[G / K.min()] * 3])
    allowed = 7.0 * (NOISE / G) ** 2 * sizes
    biases = named(rows, "bias")
    found = [row.remainder for row in biases]
    np.testing.assert_allclose(found, allowed, rtol=1e-12)
    # and it is what decides: beyond it a bias of a hair's breadth fails
    for row, most in zip(biases, allowed, strict=True):
        known = {"standard_error": float(1e-6 * most), "n": 10**14}
        for factor, answer in ((1.0 - OFF, "pass"), (1.0 + OFF, "fail")):
            moved = dataclasses.replace(row, value=float(factor * most), **known)
            (verdict,) = judge([(CellName("calibrator", "cell"), moved)])
            assert verdict.answer == answer


def test_an_answer_without_noise_is_right_to_a_millionth():
    """Relative to 1 for T and K, to the greatest entry for B."""
    truth = probe_sensor()
    greatest = float(np.abs(truth.B).max())

    def moved(share):
        def answer(poses, g):
            matrix, bias, _ = fitted(poses, g)
            return matrix, bias + share * np.array([greatest, 0.0, 0.0])

        return plugin(answer)

    # rounding of a fit leaves 1e-12 of it
    assert probe_calibrator(moved(1e-6 * (1 - OFF))) <= 1e-6
    with pytest.raises(PluginError, match="from the true parameters"):
        probe_calibrator(moved(1e-6 * (1 + OFF)))


@pytest.mark.parametrize(("dof", "good"), [(5, True), (4, False), (5.0, False)])
def test_a_covariance_of_type_a_needs_five_degrees_of_freedom(dof, good):
    def answer(poses, g):
        words = {"covariance_kind": "type A", "dof": dof}
        return {"matrix": np.eye(3), "B": np.zeros(3), "covariance": np.eye(9)} | words

    given = plugin(answer), np.zeros((9, 3)), G, NOISE
    if good:
        assert calibration_of(*given).dof == dof
    else:
        with pytest.raises(PluginError, match="5 or more: use 14 poses"):
            calibration_of(*given)


@pytest.mark.parametrize("off", [1e-6, -1e-6])
def test_an_attitude_is_of_unit_length_to_a_millionth(off):
    q = np.array([0.2, -0.4, 0.4, 0.8])
    for share, good in ((1 - OFF, True), (1 + OFF, False)):
        length = 1.0 + share * off
        assert sound_rows(length * q[None], "xyzw")[0] == good
        # a matrix: the length of a column, and the angle of two
        matrix = np.eye(3)
        matrix[0, 0] = length
        assert sound_rows(matrix[None], "matrix")[0] == good
        angle = share * off
        matrix = np.eye(3)
        matrix[:2, 1] = np.sin(angle), np.cos(angle)
        assert sound_rows(matrix[None], "matrix")[0] == good
    assert not sound_rows(np.diag([1.0, 1.0, -1.0])[None], "matrix")[0]
