"""Which formula may be used: for one geometry, and the map over many."""

import numpy as np
import pytest

from simval.errors import GeometryError, InputError
from simval.streams import Streams
from simval.studies import attitude_map
from simval.studies.attitude import random_geometry
from simval.theory import attitude_moments, sufficient_order

GEOMETRY = random_geometry(3)


@pytest.mark.parametrize(
    ("sigma", "order"), [(0.0, 2), (1e-9, 2), (0.02, 2), (0.05, 4), (0.2, "exact")]
)
def test_the_lowest_order_within_the_tolerance(sigma, order):
    found = sufficient_order(*GEOMETRY, sigma, 0.01)
    assert found.order == order
    if sigma > 0.0:
        assert found.norm_over_noise == pytest.approx(
            attitude_moments(*GEOMETRY, sigma).norm / sigma
        )


def test_the_errors_are_those_of_the_table():
    # docs/attitude.md: geometry 3, plain frame, sigma 0.0125
    found = sufficient_order(*GEOMETRY, 0.0125, frame="plain")
    assert found.covariance_off[2] == pytest.approx(6.16e-4, rel=0.01)
    assert found.covariance_off["4-paper"] == pytest.approx(1.15e-3, rel=0.01)
    assert found.covariance_off[4] == pytest.approx(1.5e-6, rel=0.05)


def test_any_covariances_are_answered():
    factor = np.random.default_rng(2).standard_normal((4, 3, 3))
    noise = 6e-4 * factor @ factor.swapaxes(1, 2)
    found = sufficient_order(*GEOMETRY, noise, 0.01)
    assert found.order == 4
    assert 0.01 < found.covariance_off[2] < 0.1


def test_what_cannot_be_answered_says_why():
    with pytest.raises(InputError, match="`frame`"):
        sufficient_order(*GEOMETRY, 0.01, frame="combined")
    with pytest.raises(InputError, match="`tolerance`"):
        sufficient_order(*GEOMETRY, 0.01, 0.0)
    with pytest.raises(GeometryError, match="farther apart"):
        sufficient_order(GEOMETRY[0], GEOMETRY[1], GEOMETRY[1], 0.01)


@pytest.mark.ci
def test_the_map_is_where_a_formula_is_off_by_that_much():
    cell = attitude_map.Parameters(geometries=5)
    rows = attitude_map.run(cell, Streams(1, (2, 3))).rows
    found = {(str(row.statistic), row.predictor): row.value for row in rows}
    greatest = found["limit_ratio[covariance,1%,most]", "order 2"]
    off = []
    for number in range(5):
        geometry = random_geometry(number)
        norm = attitude_moments(*geometry, 1e-3).norm
        answer = sufficient_order(*geometry, norm / greatest)
        off.append(answer.covariance_off[2])
    # interpolated between noise levels an eighth apart: 1 % in the ratio is 2 % here
    assert max(off) == pytest.approx(0.01, rel=0.03)
    # and rho says so without an oracle
    rho = found["next_order[covariance,1%,median]", "order 2"]
    assert rho == pytest.approx(0.01, rel=0.07)
    least = found["limit_ratio[covariance,1%,least]", "order 2"]
    assert least < found["limit_ratio[covariance,1%,median]", "order 2"] < greatest
