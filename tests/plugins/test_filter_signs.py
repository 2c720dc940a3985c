"""Signs of the bias, and of its covariance with the attitude."""

import itertools

import numpy as np
import pytest
from sound_filters import KALMAN_READS, Kalman, kalman, told

from simval.errors import PluginError
from simval.plugins import Filter
from simval.plugins.worlds import require_signs

RATE = 10.0


def spoilt(world, side, spoil):
    """A Kalman filter whose answers are spoilt."""

    class Spoilt(Kalman):
        def update(self, dt, w, f, m):
            return spoil(super().update(dt, w, f, m))

    form = {"components": "sxyz", "matrix": "active", "world": world}
    return Filter(
        name="spoilt",
        make=lambda **reads: Spoilt(**form, side=side, **reads),
        side=side,
        reads=KALMAN_READS,
        **form,
    )


def other_blocks(answer):
    answer["covariance"] = answer["covariance"] * np.kron(
        [[1, -1], [-1, 1]], np.ones((3, 3))
    )
    return answer


CASES = list(itertools.product(("NWU", "SWD"), ("body", "reference")))


@pytest.mark.parametrize(("world", "side"), CASES)
def test_right_signs_stand(world, side):
    require_signs(kalman(world, side=side), told(), world, RATE)


@pytest.mark.parametrize(("world", "side"), CASES)
def test_a_turned_bias_is_refused(world, side):
    filter = spoilt(world, side, lambda answer: answer | {"bias": -answer["bias"]})
    with pytest.raises(PluginError, match="the rate is the reading less the bias"):
        require_signs(filter, told(), world, RATE)


@pytest.mark.parametrize(("world", "side"), CASES)
def test_a_turned_covariance_is_refused(world, side):
    with pytest.raises(PluginError, match="attitude and bias are of opposite signs"):
        require_signs(spoilt(world, side, other_blocks), told(), world, RATE)


def test_what_says_nothing_of_the_bias_is_not_asked():
    calls = []

    def only(answer):
        calls.append(1)
        return answer["attitude"], answer["covariance"][:3, :3]

    require_signs(spoilt("NWU", "body", only), told(), "NWU", RATE)
    assert len(calls) == 1


def test_a_bias_that_is_told_to_be_none_is_no_fault():
    known = told(bias_std=0.0, gyroscope_walk=0.0)
    require_signs(kalman(), known, "NWU", RATE)
