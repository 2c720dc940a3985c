"""A masked entry is refused by every public name of theory and attitude."""

from functools import partial

import numpy as np
import pytest

from simval import attitude, theory
from simval.errors import InputError
from simval.sensor import AccelerometerModel

Q, R1, R2 = [0.5, -0.4, 0.6, 0.45], [1.0, 0.1, 0.0], [0.0, 1.0, 0.2]
V = np.array([[0.8, 0.1, 0.6], [0.1, 0.9, 0.2], R1, R2])
C = np.stack([1e-4 * np.eye(3)] * 4)
MODEL = AccelerometerModel(T=np.eye(3), K=np.ones(3), B=np.zeros(3))
POSES = np.random.default_rng(1).standard_normal((12, 3))


def masked(value):
    value = np.array(value, dtype=float)
    return np.ma.masked_array(value, np.arange(value.size).reshape(value.shape) == 0)


def first(*vectors):
    return vectors[0]


CASES = {
    "attitude_bound": (theory.attitude_bound, (Q, R1, R2, C)),
    "attitude_moments": (theory.attitude_moments, (Q, R1, R2, C)),
    "cubature_moments": (theory.cubature_moments, (first, V, C, V[0])),
    "series_moments": (theory.series_moments, (first, V, C)),
    "estimate_attitude": (attitude.estimate_attitude, tuple(V)),
    "two_vector_quaternion": (attitude.two_vector_quaternion, tuple(V)),
    "singular_solution": (attitude.singular_solution, tuple(V)),
    "turn_is_singular": (partial(attitude.turn_is_singular, axis=0), tuple(V)),
    "plan": (theory.plan, (POSES, 0.01)),
    "calibration_moments": (theory.calibration_moments, (MODEL, POSES, 9.8, 0.01)),
    "sequential_quaternion": (attitude.sequential_quaternion, tuple(V)),
}


@pytest.mark.parametrize("name", CASES)
def test_a_masked_entry_is_refused(name):
    function, arguments = CASES[name]
    function(*arguments)  # as it is, it works
    for i, argument in enumerate(arguments):
        if callable(argument) or argument is MODEL:
            continue
        for bad in (masked(argument), [masked(argument)]):
            given = (*arguments[:i], bad, *arguments[i + 1 :])
            with pytest.raises(InputError, match="masked"):
                function(*given)


def test_a_masked_number_is_refused():
    with pytest.raises(InputError, match="masked"):
        theory.attitude_moments(Q, R1, R2, np.ma.masked)


def test_a_masked_answer_is_refused():
    with pytest.raises(InputError, match="masked"):
        theory.cubature_moments(lambda *v: masked(v[0]), V, C, V[0])
    with pytest.raises(InputError, match="not a finite number"):
        theory.series_moments(lambda *v: masked([1.0, 2.0]), V, C)


def test_an_array_without_a_masked_entry_is_an_array():
    whole = np.ma.masked_array(V[0], np.zeros(3, dtype=bool))
    np.testing.assert_array_equal(
        attitude.two_vector_quaternion(whole, *V[1:]),
        attitude.two_vector_quaternion(*V),
    )
