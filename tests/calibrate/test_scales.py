"""The same readings in any unit, at any gravity, give the same calibration."""

import numpy as np
import pytest
from true_sensor import MODEL

from simval.calibrate import calibrate, diagnose
from simval.calibrate.residuals import RESIDUALS
from simval.calibrate.solver import METHODS
from simval.errors import SimvalError
from simval.poses import fibonacci_sphere
from simval.sensor import MODELS


def one(rng):
    """Options and readings at g = 1, and a scale of the readings and one of g."""
    n = int(rng.integers(12, 30))
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    clean = MODEL.distort(fibonacci_sphere(n) @ turn, rng)
    readings = clean + 1e-3 * rng.standard_normal((n, 3))
    names = {"model": MODELS, "method": METHODS, "residual": RESIDUALS}
    options = {name: str(rng.choice(values)) for name, values in names.items()}
    return readings, options


def physical(parameters, model, raw, g):
    """Parameters for readings `raw` times, and gravity `g` times, as large."""
    sizes = np.ones(9)
    sizes[0 if model == "symmetric" else 3 : 6] = g / raw
    sizes[6:] = raw
    return parameters * sizes, sizes


def agree(rng, trials):
    for _ in range(trials):
        readings, options = one(rng)
        raw, g = 10.0 ** rng.uniform(-12, 12), 10.0 ** rng.uniform(-6, 6)
        offset = 10.0 ** rng.uniform(0, 6) * rng.choice([0.0, 1.0], 3)
        plain = calibrate(readings, 1.0, noise_std=1e-3, **options)
        fit = calibrate((readings + offset) * raw, g, noise_std=1e-3 * raw, **options)
        want, sizes = physical(plain.parameters, options["model"], raw, g)
        want[6:] += offset * raw
        # an offset of 1e6 leaves ten digits of each reading, and the poses' condition
        # takes one: the same for the start and the stop of the iterations
        room = 1e-13 * np.abs(offset).max() * 1e3 + 1e-8
        assert fit.status == plain.status
        off = np.abs(fit.parameters - want) / sizes
        assert off.max() < room, (raw, g, offset, options)
        # the sd is of an inverse: its condition, 1e2, once more
        assert np.abs(fit.sd / sizes / plain.sd - 1.0).max() < 1e2 * room
        assert np.isfinite(diagnose(fit, (readings + offset) * raw).distance).all()


@pytest.mark.ci
def test_scales():
    agree(np.random.default_rng(5), 30)


@pytest.mark.slow
def test_a_thousand_scales():
    agree(np.random.default_rng(6), 1000)


@pytest.mark.parametrize("trials", [40, pytest.param(1000, marks=pytest.mark.slow)])
def test_no_scale_ends_in_a_traceback(trials):
    """Anything that a float can be: an answer without NaN, or a refusal in words."""
    rng = np.random.default_rng(7)
    answers = 0
    for _ in range(trials):
        readings, options = one(rng)
        raw, g = 10.0 ** np.clip(60.0 * rng.standard_normal(2), -320, 300)
        with np.errstate(under="ignore"):
            scaled = readings * raw
        batch = np.stack([scaled, scaled])
        options["noise_std"] = 1e-3 * raw if options["residual"] == "adjusted" else None
        for given in (scaled, batch):
            try:
                fit = calibrate(given, g, **options)
            except SimvalError:
                continue
            for status, row in zip(
                np.atleast_1d(fit.status), fit.parameters.reshape(-1, 9), strict=True
            ):
                assert status.startswith("refused") or np.isfinite(row).all()
            answers += 1
    assert answers > 0
