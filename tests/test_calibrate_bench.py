"""The calibration's races: contenders agree, and do what they say."""

import numpy as np
import pytest

from simval.bench import calibration
from simval.calibrate import calibrate


def test_batch_contenders_agree(monkeypatch):
    """Each loop holds its answers to the batch's at 1e-9, and says when not."""
    monkeypatch.setattr(calibration, "MANY", 40)
    monkeypatch.setattr(calibration, "FEW", 10)
    for contender in calibration.batch():
        assert contender.run() in (10, 40)
    readings = calibration.noisy_poses(10)
    found = calibration.scipy_loop(readings, "lm")
    with pytest.raises(AssertionError, match="differs by"):
        calibration._require_equal(found * (1 + 2e-9), found, "lm")


def test_the_other_races_run(monkeypatch):
    monkeypatch.setattr(calibration, "MANY", 40)
    for contender in calibration.residuals():
        assert contender.run() == 10


def test_the_start_of_the_loop_is_the_start_of_the_batch():
    """Written for SciPy users from the same equations, without our code."""
    readings = calibration.noisy_poses(3)
    fits = calibrate(readings, calibration.G, max_iterations=1, tolerance=1.0)
    for one, fit in zip(readings, fits.parameters, strict=True):
        start = calibration.ellipsoid_start(one)
        # one step away: the start is within the square of the relative noise or so
        assert (
            np.abs(start - fit).max() < 500 * (calibration.NOISE / calibration.G) ** 2
        )
