"""The plan over temperature: its error bars, and that its choice beats chance."""

import numpy as np
import pytest

from simval.errors import GeometryError, InputError
from simval.imu.sensor import AccelerometerModel
from simval.poses import cube_faces, fibonacci_sphere
from simval.theory.thermal import plan_thermal, thermal_equations

G, NOISE = 9.80665, 0.003
IDEAL = AccelerometerModel.from_parameters([0, 0, 0, 1, 1, 1, 0, 0, 0])


def bound(directions, degrees, reference):
    """Error bars by the rows themselves, differentiated by theory's own means."""
    equations = thermal_equations(
        IDEAL, directions, degrees - reference, np.zeros((2, 3)), NOISE, g=G
    )
    return np.sqrt(np.diagonal(equations.bound))


def test_the_plans_error_bars_are_those_of_the_rows():
    plan = plan_thermal(fibonacci_sphere(25), [10.0, 25.0, 40.0], NOISE, rests=24)
    want = bound(plan.directions, plan.temperatures, plan.reference)
    # two inverses of a matrix of condition 1e3, scaled
    np.testing.assert_allclose(plan.sd, want, rtol=1e-9)
    assert len(plan.names) == len(want) == 15


def test_the_plan_is_better_than_temperatures_by_chance():
    poses, degrees = fibonacci_sphere(24), np.array([10.0, 25.0, 40.0])
    plan = plan_thermal(poses, degrees, NOISE, rests=24)
    rng = np.random.default_rng(5)
    drawn = [bound(poses, rng.permutation(np.repeat(degrees, 8)), 25.0)
             for _ in range(40)]  # fmt: skip
    terms = slice(9, None)
    assert plan.sd[terms].max() < np.min([each[terms].max() for each in drawn])


def test_what_cannot_be_planned_is_refused_in_words():
    with pytest.raises(GeometryError, match="do not determine every term"):
        plan_thermal(cube_faces(), [10.0, 40.0], NOISE, rests=30)
    with pytest.raises(InputError, match="2 or more different"):
        plan_thermal(fibonacci_sphere(20), [10.0, 10.0], NOISE, rests=30)
