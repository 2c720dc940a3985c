"""Every legal value of every parameter is measured, or refused in words.

A cell that raises anything else has crashed, and a row that is judged of a value that
is no number says nothing. Values are drawn at their edges and between; those with
which a cell once crashed stand by themselves.
"""

import warnings
from importlib import import_module

import numpy as np
import pytest
import study_draws
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
from simval.studies.study import Cell, refusing
from simval.sweep.cells import REFUSED
from simval.sweep.executors import attempt

DRAWN = [name for name in STUDIES if name != "custom_scene"]  # that is a user's
CHEAP = {  # how many tests of how many cells, and what a cell may cost, s
    "coverage": (6, 2, 0.06),
    "calibration": (4, 2, 0.1),
    "ladder": (6, 2, 0.06),
    "solvers": (6, 4, 1.0),
    "attitude_order": (6, 4, 1.0),
    "attitude_vectors": (2, 1, 0.6),
    "attitude": (2, 1, 1.0),
}


def made(study, values):
    """Parameters; None where they are refused, in words."""
    try:
        return STUDIES[study].parameters(**values)
    except (ValidationError, InputError):
        return None


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
    judged = [row for row in rows if row.check != "record"]
    assert not [
        (str(row.statistic), row.predictor)
        for row in judged
        if not np.isfinite([row.value, row.standard_error, row.remainder]).all()
        or (row.prediction is not None and not np.isfinite(row.prediction))
        or row.standard_error < 0.0
    ]
    return "measured"


def drawn(study, count, seconds, first=0):
    """Legal parameters of cells that take no longer, with the number of each draw."""
    number = first - 1
    while count:
        number += 1
        rng = np.random.default_rng([number, *study.encode()])
        parameters = made(study, study_draws.draw(study, rng))
        if parameters is not None and parameters.cost().seconds <= seconds:
            count -= 1
            yield number, parameters


@pytest.mark.parametrize(
    ("study", "part"),
    [(study, part) for study, (parts, _, _) in CHEAP.items() for part in range(parts)],
)
def test_drawn_parameters_of_cheap_studies(study, part):
    _, count, seconds = CHEAP[study]
    for number, parameters in drawn(study, count, seconds, 1000 * part):
        found = answer(study, parameters)
        assert found == "measured" or "cannot be measured: " in found, number


@pytest.mark.slow
@pytest.mark.parametrize("part", range(4))
@pytest.mark.parametrize("study", DRAWN)
def test_drawn_parameters_of_every_study(study, part):
    seconds = 20.0 if study in ("attitude_geometries", "filter", "noise_model") else 3.0
    count = 10 if seconds > 3.0 else 50
    for number, parameters in drawn(study, count, seconds, 1000 * (part + 1)):
        try:
            answer(study, parameters)
        except Exception as error:
            error.add_note(f"draw {number}: {parameters}")
            raise


@pytest.mark.parametrize("study", DRAWN)
def test_what_is_drawn_is_legal_or_refused_in_words(study):
    rng = np.random.default_rng(20_261_122)
    values = [study_draws.draw(study, rng) for _ in range(100)]
    legal = [own for each in values if (own := made(study, each)) is not None]
    assert len(legal) > 10
    assert all(np.isfinite(own.cost().seconds) for own in legal)


CRASHED = {  # values with which a cell crashed, and what of it is said now
    "too noisy for ten poses": (
        "calibration",
        {"noise_std": 10.0, "poses": 10, "hold_time": 0.01, "trials": 128},
        "did not converge.*lower `noise_std` or give more `poses`",
    ),
    "error bars of ten poses": (
        "coverage",
        {"noise_std": 0.3, "poses": 10, "trials": 1024, "residual": "norm"},
        "cannot be measured: .*did not converge",
    ),
    "a die that shows too few sides": (
        "calibration",
        {"scene": "die", "poses": 9, "hold_time": 0.01, "trials": 128},
        "directions have rank 6 of 9.*give more `poses`",
    ),
    "the ladder at a tenth of g": (
        "ladder",
        {"noise_std": 1.0, "poses": 10, "trials": 512},
        "cannot be measured: .*did not converge",
    ),
    "solvers without a solution": (
        "solvers",
        {"noise_std": 3.0, "poses": 40},
        "cannot be measured: .*show fewer than 9",
    ),
    "a geometry without a slope": (
        "attitude_order",
        {"geometry": 390},
        "cannot be measured: geometry 390 has .*give another `geometry`",
    ),
    "a hold of one sample": (
        "calibration",
        {"hold_time": 0.002, "poses": 12, "trials": 128},
        "measured",
    ),
    "the least noise": (
        "calibration",
        {"noise_std": 1e-9, "poses": 9, "hold_time": 0.01, "trials": 128},
        "measured",
    ),
    "a calibrator whose trials have no answer": (
        "calibrator",
        {"algorithm": "simval:norm", "noise_std": 1.0, "trials": 32},
        "norm refuses what it is given: the 24 poses .* add poses",
    ),
    "unequal scales": (
        "ladder",
        {"scale_spread": 0.99, "poses": 100, "noise_std": 1e-4, "trials": 512},
        "measured",
    ),
}


@pytest.mark.parametrize("name", CRASHED)
def test_what_once_crashed(name):
    import re

    study, values, words = CRASHED[name]
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
        ("gyroscope", {"angle_random_walk": 5e-324}, "greater than or equal to"),
        ("end_to_end", {"magnetometer_noise_std": 5e-324}, "greater than or equal"),
        ("filter", {"rate": 86.6}, "500 divided by a whole number"),
        ("detector", {"multiplier": 1e300}, "less than or equal to"),
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
