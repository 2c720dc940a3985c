"""The optical truth of BROAD, by Laidig, Caruso, Cereatti and Seel (CC BY 4.0)."""

from functools import cache

import numpy as np
import pytest
from places import recording

from simval.errors import RefusedError
from simval.logs import read_log, read_truth
from simval.recorded import align
from simval.recorded.attitudes import Meaning
from simval.recorded.settings import rests_of_log

RATE = 2000.0 / 7.0  # Hz, as their `sampling_rate` has it
BREAKS = "05_undisturbed_slow_rotation_with_breaks_B"
TRANSLATION = "10_undisturbed_slow_translation_A"


@cache
def aligned(name, world=None):
    path = str(recording(f"broad/{name}.mat"))
    log = read_log(path, RATE)
    return align(
        read_truth(path, stem="opt_quat", clock=log.time),
        log.time,
        log.gyro,
        log.accelerometer,
        log.magnetometer,
        rests_of_log(log),
        world,
    )


@pytest.mark.ci
@pytest.mark.parametrize(("name", "missing"), [(BREAKS, 0.034), (TRANSLATION, 0.0008)])
def test_what_their_authors_state_is_found(name, missing):
    found = aligned(name)
    # scalar first, sensor to world, east-north-up, body axes those of the sensor
    assert found.meaning == Meaning("first", "body to world")
    assert found.same == (Meaning("last", "world to body"),)
    assert found.better > 10.0
    assert found.world.name == "ENU"
    assert found.world.taken == "standard"
    # north by the log holds that of the data set within its own deviation
    assert abs(found.world.off[2]) < found.world.half("heading") < np.radians(10.0)
    assert np.linalg.norm(found.world.off[:2]) < np.radians(0.6)
    assert np.linalg.norm(found.rotation) < np.radians(0.6)
    # unit rad/s, and a gyroscope within its data sheet
    assert found.fit.scale == pytest.approx(1.0, abs=0.01)
    assert found.fit.share < 2e-3
    # optical noise: hundredths of a degree
    assert 1e-5 < found.noise.mean() < 3e-4
    assert 1.0 - np.isfinite(found.attitude[:, 0]).mean() == pytest.approx(
        missing, abs=2e-3
    )


@pytest.mark.ci
def test_both_trials_have_the_same_delay():
    # one system: the two offsets agree within four standard deviations
    first, second = aligned(BREAKS).offset, aligned(TRANSLATION).offset
    assert abs(first.value - second.value) < 4.0 * np.hypot(first.sd, second.sd)
    assert first.value == pytest.approx(-2.4e-3, abs=5e-4)


@pytest.mark.ci
def test_the_truth_of_the_other_trial_is_refused():
    path = str(recording(f"broad/{BREAKS}.mat"))
    log = read_log(path, RATE)
    other = read_truth(
        str(recording(f"broad/{TRANSLATION}.mat")), stem="opt_quat", rate=RATE
    )
    with pytest.raises(RefusedError, match="follows the gyroscope"):
        align(
            other,
            log.time,
            log.gyro,
            log.accelerometer,
            log.magnetometer,
            rests_of_log(log),
        )
