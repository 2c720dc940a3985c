"""Good logs that lost rows, some at a time or in bursts, with a clock or without."""

from dataclasses import replace

import numpy as np
import pytest
import still_logs

from simval.calibrate.gyroscope import moves_between
from simval.errors import InputError
from simval.multiposition import calibrate_log, calibrate_sensors
from simval.recorded.settings import signals


def lossy(seed, *, clock, bursts):
    """A log without 1 to 20 % of its rows; stamped bursts last up to 2 s."""
    made = still_logs.draw(seed, turning=False)
    rng = np.random.default_rng([55, seed])
    share, n = 0.01 * 20.0 ** rng.random(), len(made.log.time)
    keep = rng.random(n) >= share
    while bursts and np.mean(~keep) < 2.0 * share:
        row = int(rng.integers(1, n))
        keep[
            row : row + int(made.log.rate * rng.uniform(0.02, 2.0 if clock else 0.2))
        ] = False
    keep[[0, -1]] = True
    time = made.log.time[keep] if clock else made.log.time[: np.sum(keep)]
    return made, replace(
        made.log,
        time=time,
        accelerometer=made.log.accelerometer[keep],
        gyro=made.log.gyro[keep] if clock else None,
        magnetometer=None,
        rate=(len(time) - 1) / (time[-1] - time[0]),
    )


def require_right(seed, **how):
    made, log = lossy(seed, **how)
    result = calibrate_log(log, g=still_logs.G)
    assert len(result.intervals) >= 0.5 * len(made.holds)  # shorter ones are none
    whole = calibrate_sensors(log, result)
    for fit in (result.fit, whole.accelerometer):
        error = fit.parameters - made.accelerometer.parameters
        # 200 logs, 9 values of t with 7 degrees of freedom and more
        assert np.abs(error / fit.sd).max() < 8.0, (seed, how)


HOW = [
    {"clock": clock, "bursts": bursts} for clock in (True, False) for bursts in (0, 1)
]


@pytest.mark.ci
@pytest.mark.parametrize("how", HOW)
def test_a_log_with_lost_rows_is_calibrated(how):
    for seed in range(2):
        require_right(seed, **how)


@pytest.mark.slow
@pytest.mark.parametrize("how", HOW)
def test_200_logs_with_lost_rows(how):
    for seed in range(200):
        require_right(seed, **how)


def test_a_filter_needs_every_row():
    made = still_logs.draw(0, turning=False)
    log = made.log
    keep = np.ones(len(log.time), bool)
    keep[500:512] = False
    log = replace(
        log, time=log.time[keep], gyro=log.gyro[keep],
        accelerometer=log.accelerometer[keep], magnetometer=log.accelerometer[keep],
    )  # fmt: skip
    si = (1.0, "m/s^2")
    with pytest.raises(InputError, match="a filter needs what was turned there"):
        signals(log, made.holds, accelerometer=si, gyro=si, calibration=None)


def test_a_lost_row_of_a_move_is_between_its_neighbours():
    """A rate that grows linearly loses nothing; the last row alone leaves 6e-4."""
    time = 0.01 * np.arange(400)
    ramp = np.clip(time - 1.0, 0.0, 1.0) * np.clip(3.0 - time, 0.0, 1.0)
    rates = ramp[:, None] * [1.0, -2.0, 0.5]
    rests = np.array([[0, 90], [310, 400]])
    whole = moves_between(time, rates, rests)
    keep = np.delete(np.arange(400), [120, 140, 141, 160, 180])
    found = moves_between(time[keep], rates[keep], np.searchsorted(keep, rests))
    turned = [m.statistics[..., :3, :].sum(axis=-1) for m in (whole, found)]
    assert np.abs(turned[1] - turned[0]).max() < 1e-4 * np.abs(turned[0]).max()
