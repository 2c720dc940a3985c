"""Random faults are found and named, and unusual style is no fault: the families."""

import re
from zlib import crc32

import numpy as np
import pytest
from random_algorithms import BAD, SOUND, ellipsoid, member
from scipy import stats

from simval.check import check_function, told
from simval.errors import PluginError
from simval.plugins import Calibrator
from simval.plugins.runs import require_no_memory

BY_DAY = (
    "averages_with_the_previous",
    "knows_the_truth",
    "covariance_in_another_order",
    "identity_where_the_angle_is_off",
    "always_turned",
    "not_repeating",
)
DRAWS = 7


TRUE = np.random.default_rng(1).standard_normal((64, 3))
DEPENDING = {
    "the place": lambda own: own + 1e-5 * (np.arange(len(own)) == 50)[:, None],
    "the rows before": lambda own: own + 1e-5 * np.cumsum(own, axis=0),
    "how many are asked": lambda own: own + 1e-5 * (len(own) < 40),
    "nothing": lambda own: 0.0 * own,
}


@pytest.mark.parametrize("what", DEPENDING)
def test_answers_are_of_their_own_trial_alone(what):
    allowed = np.full(TRUE.shape, 1e-6)
    require_no_memory("mine", TRUE, lambda places: TRUE[places] + 0.9e-6, allowed)
    answered = DEPENDING[what]
    with pytest.raises(PluginError, match="from one call to the next"):
        require_no_memory(
            "mine", answered(TRUE), lambda places: answered(TRUE[places]), allowed
        )


def checked(kind, make, name, draw):
    rng = np.random.default_rng([crc32(name.encode()), draw])
    function, declared = member(kind, make, rng)
    return check_function(function, kind, **{"name": "mine", **declared})


def require_named(name, draw):
    kind, words, make = BAD[name]
    found = checked(kind, make, name, draw)
    assert found.result.exit_code, name
    assert re.search(words, told(found)), told(found)


@pytest.mark.ci
@pytest.mark.parametrize("name", BY_DAY)
def test_a_random_fault_is_named(name):
    require_named(name, 0)


@pytest.mark.slow
@pytest.mark.parametrize("draw", range(DRAWS))
@pytest.mark.parametrize("name", BAD)
def test_every_random_fault_is_named(name, draw):
    require_named(name, draw)


@pytest.mark.slow
@pytest.mark.parametrize("draw", range(2))
@pytest.mark.parametrize("name", SOUND)
def test_no_style_is_a_fault(name, draw):
    found = checked(*SOUND[name], name, draw)
    assert found.result.exit_code == 0, told(found)


@pytest.mark.slow
def test_a_sound_calibrator_passes_at_the_stated_rate():
    """Of 50 seeds at a rate of a tenth no more fail than binomial chance allows.

    Power: one that leans on the truth is below the bound each time.
    """
    alpha, seeds = 0.1, 50
    words = {"noise_std": 0.02, "trials": 1024, "alpha": alpha}
    failed = sum(
        check_function(ellipsoid, Calibrator, seed=seed, **words).result.exit_code != 0
        for seed in range(seeds)
    )
    assert failed <= stats.binom.isf(1e-4, seeds, alpha)
    _, _, make = BAD["knows_the_truth"]
    knowing, declared = member(Calibrator, make, np.random.default_rng(0))
    for seed in range(5):
        found = check_function(knowing, Calibrator, seed=seed, **words, **declared)
        assert "below_bound" in told(found)
