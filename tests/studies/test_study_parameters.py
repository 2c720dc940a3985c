"""Every legal value of every parameter is measured, or refused in words.

A cell that raises anything else has crashed, and a row that is judged of a value that
is no number says nothing. Values are drawn at their edges and between; those with
which a cell once crashed stand by themselves.
"""

import math
import re
import typing
import warnings
from importlib import import_module

import numpy as np
import pytest
from annotated_types import Ge, Gt, Le, Lt
from pydantic import ValidationError

from simval.errors import (
    CrashedPluginError,
    InputError,
    PluginError,
    RefusedError,
    SimulationError,
    UnmeasurableError,
)
from simval.results import Outcome
from simval.studies import STUDIES
from simval.studies.named_geometries import GEOMETRIES
from simval.studies.study import Cell, refusing
from simval.sweep.cells import REFUSED
from simval.sweep.executors import attempt

DRAWN = [name for name in STUDIES if name != "custom_scene"]  # that is a user's
CHEAP = {  # how many cells, and what a cell may cost, s
    "coverage": (6, 0.06),
    "calibration": (4, 0.1),
    "ladder": (6, 0.06),
    "solvers": (6, 1.0),
    "attitude_order": (4, 1.0),
    "attitude_vectors": (1, 0.6),
    "attitude": (1, 1.0),
}
TEXTS = {  # of fields that are text
    ("estimator", "algorithm"): ("simval:wahba", "simval:triad", "simval:closed-form"),
    ("estimator", "noise"): ("body", "all", "tangent", "unequal", "general"),
    ("estimator", "geometry"): (0, 12_345, 2**63 - 1, *GEOMETRIES),
    ("calibrator", "algorithm"): ("simval:squared", "simval:norm", "simval:weighted"),
    ("filter", "algorithm"): ("simval:mekf",),
    ("filter", "scenario"): (
        *("gimbal slow", "gimbal fast", "magnetic disturbance", "anywhere"),
    ),
}
LARGEST = {"trials": 2.0, "samples": 2.0, "geometries": 1.2, "cases": 2.0}
"""Of a count beside the least that is legal: more is longer and no other work."""


def limits(info):
    """Least and greatest legal value of a number."""
    whole = info.annotation is int
    low, high = -math.inf, 2**200 if whole else 1e300
    for limit in info.metadata:
        match limit:
            case Ge(ge=value):
                low = value
            case Gt(gt=value):
                low = value + 1 if whole else math.nextafter(value, math.inf)
            case Le(le=value):
                high = value
            case Lt(lt=value):
                high = value - 1 if whole else math.nextafter(value, -math.inf)
    return low, high


def edges(name, info):
    """Values of a number at its edges and next to them."""
    low, high = limits(info)
    if name in LARGEST:
        return [low, low + 1]
    if info.annotation is int:
        return [low, low + 1, high - 1, high]
    tiny = [1e-300, 1e-150, 1e-30, 1e-15, 1e-9] if 0.0 <= low < 1e-300 else []
    ends = [low, math.nextafter(low, high), high, math.nextafter(high, low)]
    return [float(each) for each in (*ends, *tiny)]


def between(name, info, rng):
    """A value between the edges, by its logarithm where that is the scale."""
    low, high = limits(info)
    if name in LARGEST:
        return int(low * rng.uniform(1.0, LARGEST[name]))
    high = min(high, 1e6 if info.annotation is float else 2**60)
    least = max(low, 1 if info.annotation is int else 1e-9 * high)
    if info.annotation is float and (rng.random() < 0.5 or low < 0.0):
        return float(rng.uniform(low, high))
    value = 10.0 ** rng.uniform(math.log10(least), math.log10(high))
    return info.annotation(min(max(value, least), high))


def values_of(study, rng, edge=0.4, plain=0.3):
    """Values of all fields: at an edge, by default or between, in these shares."""
    values = {}
    for name, info in STUDIES[study].parameters.model_fields.items():
        kind, choices = rng.random(), TEXTS.get((study, name))
        if typing.get_origin(info.annotation) is typing.Literal:
            choices = typing.get_args(info.annotation)
        if name == "time_limit":
            continue
        if choices is None and kind < edge:
            choices = edges(name, info)
        if choices is not None:
            values[name] = choices[int(rng.integers(len(choices)))]
        elif kind < edge + plain and name not in LARGEST:
            values[name] = info.default
        else:
            values[name] = between(name, info, rng)
    return values


def made(study, values):
    """Parameters; None where they are refused, in words."""
    try:
        return STUDIES[study].parameters(**values)
    except (ValidationError, InputError):
        return None


def drawn(study, count, seconds):
    """Legal parameters of cells that take no longer."""
    rng = np.random.default_rng([*study.encode()])
    while count:
        parameters = made(study, values_of(study, rng))
        if parameters is not None and parameters.cost().seconds <= seconds:
            count -= 1
            yield parameters


def answer(study, parameters):
    """What a cell leaves: "measured", or the words of its refusal."""
    module = import_module(f"simval.studies.{study}")
    compute = getattr(module, "compute", module.run)
    streams = Cell(study, parameters, 1).streams
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            rows = compute(parameters, streams).rows
    except CrashedPluginError:
        raise
    except (UnmeasurableError, PluginError) as error:
        return str(error)
    except Exception as error:
        error.add_note(str(parameters))
        raise
    for row in (row for row in rows if row.check != "record"):
        predicted = 0.0 if row.prediction is None else row.prediction
        numbers = [row.value, row.standard_error, row.remainder, predicted]
        assert np.isfinite(numbers).all(), (parameters, row)
        assert row.standard_error >= 0.0, (parameters, row)
    return "measured"


@pytest.mark.ci
@pytest.mark.parametrize("study", CHEAP)
def test_drawn_parameters_of_cheap_studies(study):
    for parameters in drawn(study, *CHEAP[study]):
        found = answer(study, parameters)
        assert found == "measured" or "cannot be measured: " in found, parameters


@pytest.mark.slow
@pytest.mark.parametrize("study", DRAWN)
def test_drawn_parameters_of_every_study(study):
    long = study in ("attitude_geometries", "filter", "noise_model")
    for parameters in drawn(study, *((40, 3.0) if long else (200, 1.0))):
        answer(study, parameters)


@pytest.mark.parametrize("study", DRAWN)
def test_what_is_drawn_is_legal_or_refused_in_words(study):
    rng = np.random.default_rng(20_261_122)
    values = [values_of(study, rng) for _ in range(100)]
    legal = [own for each in values if (own := made(study, each)) is not None]
    assert len(legal) > 10
    assert all(np.isfinite(own.cost().seconds) for own in legal)


FEW = {"poses": 12, "trials": 128}
CRASHED = [  # values with which a cell crashed, and what of it is said now
    ("calibration", {"noise_std": 10.0, "poses": 10, "hold_time": 0.01, "trials": 128},
     "did not converge.*lower `noise_std` or give more `poses`"),
    ("coverage", {"noise_std": 0.3, "poses": 10, "trials": 1024, "residual": "norm"},
     "cannot be measured: .*did not converge"),
    ("calibration", {"scene": "die", "poses": 9, "hold_time": 0.01, "trials": 128},
     "directions have rank 6 of 9.*give more `poses`"),
    ("ladder", {"noise_std": 1.0, "poses": 10, "trials": 512},
     "cannot be measured: .*did not converge"),
    ("solvers", {"noise_std": 3.0, "poses": 40},
     "cannot be measured: .*show fewer than 9"),
    ("attitude_order", {"geometry": 390},
     "cannot be measured: geometry 390 has .*give another `geometry`"),
    ("end_to_end", {"poses": 105, "attitudes": 13, "average": 16, "trials": 3,
      "accelerometer_noise_std": 1e-9, "magnetometer_noise_std": 1e-5},
     "cannot be measured: a covariance has no inverse"),
    ("calibration", FEW | {"hold_time": 0.002}, "measured"),
    ("calibration", FEW | {"noise_std": 1e-9, "hold_time": 0.01}, "measured"),
    ("calibrator", {"algorithm": "simval:norm", "noise_std": 1.0, "trials": 32},
     "norm refuses what it is given: the 24 poses .* add poses"),
    ("ladder", {"scale_spread": 0.99, "poses": 100, "noise_std": 1e-4, "trials": 512},
     "measured"),
]  # fmt: skip


@pytest.mark.parametrize(("study", "values", "words"), CRASHED)
def test_what_once_crashed(study, values, words):
    found = answer(study, STUDIES[study].parameters(**values))
    assert re.search(words, found), found


@pytest.mark.parametrize(
    ("study", "values", "words"),
    [
        ("coverage", {"residual": "adjusted"}, 'give sigma = "known"'),
        ("coverage", {"noise_std": 1e-300}, "greater than or equal to"),
        ("calibration", {"noise_std": 1e-30}, "it must be 0, or 1e-09 or more"),
        ("calibration", {"hold_time": 1e-9}, "greater than or equal to 0.002"),
        ("ladder", {"scale_spread": 0.999}, "less than or equal to 0.99"),
        ("attitude", {"noise_std": 5e-324}, "greater than or equal to"),
        ("attitude_efficiency", {"noise_std": 1e-300}, "greater than or equal to"),
        ("attitude_vectors", {"noise_std": 0.01, "ratio": 999.0}, "of length 1"),
        ("attitude_vectors", {"geometry": 2**200}, "less than 9223372036854775808"),
        ("estimator", {"noise_std": 1e-30}, "greater than or equal to"),
        ("calibrator", {"noise_std": 1e-30}, "greater than or equal to"),
        ("filter", {"start_std": 1e-200}, "greater than or equal to"),
        ("filter", {"rate": 86.6}, "500 divided by a whole number"),
        ("gyroscope", {"angle_random_walk": 5e-324}, "greater than or equal to"),
        ("end_to_end", {"magnetometer_noise_std": 5e-324}, "greater than or equal"),
        ("detector", {"multiplier": 1e300}, "less than or equal to"),
        ("detector", {"window": 50}, "window"),  # it must be odd
        ("detector", {"window": 1}, "window"),
    ],
)
def test_what_is_refused_at_once(study, values, words):
    with pytest.raises(ValidationError) as caught:
        STUDIES[study].parameters(**values)
    assert words in str(caught.value)


def test_a_cell_is_refused_and_has_not_crashed():
    own = STUDIES["solvers"].parameters(noise_std=3.0, poses=40)
    _, words, _ = attempt(0, Cell("solvers", own, 1))
    assert words.startswith(f"{REFUSED}these parameters cannot be measured: ")
    assert "Traceback" not in words


@pytest.mark.parametrize(
    ("raised", "expected"),
    [
        (RefusedError("x"), UnmeasurableError),
        (SimulationError("x"), SimulationError),
        (PluginError("x"), PluginError),
        (InputError("x"), InputError),
        (ValueError("x"), ValueError),
    ],
)
def test_only_a_refusal_is_one(raised, expected):
    # a bug of ours, and a simulation that fails its checks, are still crashes
    @refusing("lower it")
    def study(parameters, streams) -> Outcome:
        raise raised

    with pytest.raises(expected) as caught:
        study(None, None)
    assert type(caught.value) is expected
