"""The study `diagnosis`: its limits are those of the laws, its faults of their size."""

import numpy as np
import pytest
from scipy import stats

from simval.studies.diagnosis import MISSED, SELDOM, as_counted, by_markov
from simval.studies.rest_sets import (
    BIASES,
    HOLDS,
    LYING,
    PAIRS,
    SCALES,
    SINGLE,
    UNLISTED,
    RestSet,
    Where,
    course,
    directions,
)


@pytest.mark.parametrize("n", [1, 3, 24, 1000])
@pytest.mark.parametrize(("k", "of"), [(0, 24), (7, 72), (24, 24)])
def test_what_was_counted_limits_what_is_counted_again(n, k, of):
    most = as_counted(k, of, n)
    law = stats.betabinom(n, k + 0.5, of - k + 0.5)
    assert law.sf(most) <= SELDOM
    assert most == 0 or law.sf(most - 1) > SELDOM


@pytest.mark.parametrize("n", [1, 12, 500])
@pytest.mark.parametrize("rate", [1e-3, 0.1])
def test_a_rate_limits_a_count(n, rate):
    most = by_markov(rate, n)
    assert stats.binom.sf(most, n, rate) <= SELDOM < stats.binom.sf(most - 1, n, rate)


def test_every_fault_was_counted():
    assert MISSED.keys() == {*SINGLE, *PAIRS, *LYING, *UNLISTED}


@pytest.mark.parametrize("name", [*BIASES, *SCALES, *HOLDS, *UNLISTED])
def test_a_fault_is_as_great_as_it_says(name):
    rng, size, most = np.random.default_rng(48), 0.01, []
    fault = {**SINGLE, **UNLISTED}[name]
    for _ in range(8):
        log = RestSet(up=directions(60, rng), noise=1e-5, temperature=course(60, rng))
        sick = fault.act(log, Where(size, 30, int(rng.integers(3))), rng)
        seed = rng.integers(2**32)
        sound, off = (s.means(np.random.default_rng(seed)) for s in (log, sick))
        most.append(np.abs(off.readings - sound.readings).max() / size)
    # a walk or noise of 60 rests reaches three deviations; two decades would be a unit
    assert 0.4 < np.median(most) < 4.0
