"""tr C + |m|^2 = 2 q'm for unit quaternions: formulas, samples, plug-ins."""

import dataclasses

import numpy as np
import pytest
from rows_by_name import named

from simval.attitude import two_vector_quaternion
from simval.attitude.kernel import normalize_columns, raw_quaternion
from simval.montecarlo import simulate
from simval.plugins import Estimator
from simval.streams import Streams
from simval.studies import attitude, estimator
from simval.studies.attitude import random_geometry
from simval.theory import attitude_moments
from simval.theory.expansion import (
    predicted_defect,
    unit_length_defect,
    unit_length_rounding,
)
from simval.verdict import judge

STREAMS = Streams(1, (2, 3))
GEOMETRY = random_geometry(3)
GOOD = Estimator(
    name="good", estimate=two_vector_quaternion, components="xyzs", matrix="passive"
)


def defect(sigma, order):
    found = attitude_moments(*GEOMETRY, sigma, order)
    return abs(predicted_defect(found, found.q_true))


@pytest.mark.parametrize(("order", "power"), [(2, 2.0), ("4-paper", 2.0), (4, 4.0)])
def test_the_defect_of_a_formula_has_the_order_of_what_it_leaves_out(order, power):
    # relative to sigma^2, so two less than the order of the first term left out; the
    # next term bends the slope by its relative size, (sigma/|qbar|)^2 = 2e-3
    sizes = (0.01, 0.02)
    slope = np.diff(np.log([defect(s, order) for s in sizes])) / np.log(2.0)
    assert slope[0] == pytest.approx(power, abs=0.05)


@pytest.mark.parametrize("sigma", [1e-4, 0.0125, 0.05, 0.3])
def test_the_exact_answer_has_none(sigma):
    found = attitude_moments(*GEOMETRY, sigma, "exact")
    square = float(np.trace(found.second_moment))
    assert defect(sigma, "exact") < unit_length_rounding(square)


def test_the_exact_answer_has_none_for_full_noise():
    factor = np.random.default_rng(1).standard_normal((4, 3, 3))
    noise = 1e-3 * factor @ factor.swapaxes(1, 2)
    assert defect(noise, "exact") < 1e-10  # of the quadrature, 1e-9 at the most
    assert defect(noise, 4) > 1e-4


def test_the_source_contradicts_itself_more_than_the_second_order_does():
    for sigma in (0.0125, 0.05):
        assert defect(sigma, "4-paper") > 2.0 * defect(sigma, 2)
        assert defect(sigma, 4) < 0.1 * defect(sigma, 2)


def unit_rows(rows):
    return {
        str(r.statistic): r for r in rows if r.statistic.family.name == "unit_length"
    }


def too_long(vectors, frame, q, noise_std, streams, *, samples, block):
    """Trials of the closed form whose estimates are not quite normalised."""

    def errors(rng, count):
        noisy = vectors + noise_std * rng.standard_normal((12, count))
        estimates = normalize_columns(raw_quaternion(noisy, frame))
        return q[:, None] - (1 + 1e-9) * estimates

    return simulate(errors, streams, samples=samples, block=block, batch=256)


def test_samples_and_exact_answer_are_judged(monkeypatch):
    cell = attitude.Parameters(samples=65_536, noise_std=0.05)
    rows = unit_rows(attitude.run(cell, STREAMS).rows)
    judged = [row for row in rows.values() if row.check == "limit"]
    assert sorted(str(r.statistic) for r in judged) == [
        "unit_length[exact]", "unit_length[simulated]",
    ]  # fmt: skip
    assert [v.answer for v in judge(named(judged))] == ["pass"] * 2
    # power: estimates that are too long by 1e-9 are seen
    monkeypatch.setattr(attitude, "simulate_closed_form", too_long)
    row = unit_rows(attitude.run(cell, STREAMS).rows)["unit_length[simulated]"]
    assert [v.answer for v in judge(named([row]))] == ["fail"]


def measured(plugin, monkeypatch):
    monkeypatch.setattr(estimator, "find_plugin", lambda *_: plugin)
    cell = estimator.Parameters(algorithm="any", noise_std=0.05, samples=1024)
    rows = estimator.compute(cell, STREAMS).rows
    return unit_rows(rows)["unit_length[simulated]"]


def test_a_plugin_is_held_to_it(monkeypatch):
    row = measured(GOOD, monkeypatch)
    assert row.value <= row.prediction < 1e-12


def test_a_plugin_of_single_precision_is_held_to_its_own(monkeypatch):
    rough = dataclasses.replace(
        GOOD, estimate=lambda *v: two_vector_quaternion(*v).astype(np.float32)
    )
    row = measured(rough, monkeypatch)
    assert 1e-12 < row.value <= row.prediction < 1e-4


def test_no_error_at_all_has_no_defect():
    assert unit_length_defect(0.0, 0.0) == 0.0
    assert np.isfinite(unit_length_rounding(0.0))
