"""The calibration's races: contenders agree, and do what they say."""

import numpy as np
import pytest

from simval.bench import calibration
from simval.bench.race import require_agreement
from simval.calibrate import calibrate
from simval.errors import RefusedError


def test_batch_contenders_agree(monkeypatch):
    """All answers are held to each other at 1e-9, and it is said when they differ."""
    monkeypatch.setattr(calibration, "MANY", 40)
    monkeypatch.setattr(calibration, "FEW", 10)
    contenders = calibration.batch()
    found = {each.name: each.once() for each in contenders}
    assert [done.items for done in found.values()] == [10, 10, 10, 40, 40]
    require_agreement("calibration", found, set())
    lm = contenders[1]
    found[lm.name] = lm.seen(lm.run() * (1 + 2e-9))
    with pytest.raises(RefusedError, match=r"differ by"):
        require_agreement("calibration", found, set())


def test_the_other_races_run(monkeypatch):
    monkeypatch.setattr(calibration, "MANY", 40)
    contenders = calibration.residuals()
    found = {each.name: each.once() for each in contenders}
    assert {done.items for done in found.values()} == {10}
    require_agreement("residuals", found, set())
    # power: a residual's answers of other poses
    norm = contenders[2]
    found[norm.name] = norm.seen(norm.run()[::-1])
    with pytest.raises(RefusedError, match=r"parameters: .* differ by"):
        require_agreement("residuals", found, set())


@pytest.mark.ci
def test_sizes_of_one_set(monkeypatch):
    monkeypatch.setattr(calibration, "SAMPLES", 40_000)
    monkeypatch.setattr(calibration, "ALIKE", 1e-4)  # of fits of 400 samples
    found = {each.name: each.once() for each in calibration.samples()}
    assert [done.items for done in found.values()] == [4_000, 40_000, 40_000, 40_000]
    require_agreement("samples", found, set())


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
