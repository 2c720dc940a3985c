"""Study estimator: what a covariance that an estimator states may leave out."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from cells import answers, of_family, outcome
from places import EXAMPLES

from simval import algorithms
from simval.errors import PluginError
from simval.geometry import attitude_matrix
from simval.moments import Moments
from simval.plugins import Estimator, find_plugin
from simval.plugins.noise import vector_noise
from simval.statistics import OPERATIONS
from simval.studies import estimator
from simval.studies.estimator_errors import claim_rows
from simval.studies.estimator_operations import (
    SINES,
    Counted,
    operation_rows,
    rounding_rows,
)
from simval.studies.named_geometries import GEOMETRIES, named_geometry
from simval.theory import wahba_bound

MOMENTS = Moments(
    bias=np.array([0, 0, 0, 3.1]), covariance=np.eye(4), samples=100,
    bias_error=np.array([0, 0, 0, 0.1]), covariance_error=np.eye(4),
)  # fmt: skip


@pytest.mark.parametrize("order", [2, 4])
def test_a_claim_falls_with_the_noise_as_its_order_says(order):
    off, covariance = 1e-3, np.diag([1e-4, 4e-4, 2e-4])
    rows = claim_rows(order, MOMENTS, off, off / 8.0, 1e-9, covariance, 0.0)
    nees, half, full = rows
    assert (nees.value, nees.standard_error, nees.prediction) == (3.1, 0.1, 3.0)
    # twice the error that cubature finds in it, of a mean of 3
    assert nees.remainder == pytest.approx(2.0 * 3.0 * off, rel=1e-12)
    assert (half.value, full.value) == (off / 8.0, off)
    assert half.prediction == pytest.approx(off / 2.0 ** (order - 0.5), rel=1e-12)
    following = (4.0 * 4e-4) ** (order / 2 + 1)
    expected = 2.0 ** (order + 0.5) * off / 8.0 + following
    assert full.prediction == pytest.approx(expected, rel=1e-12)
    # below a millionth an order cannot be told
    for rounding, allowed in ((0.0, [1e-6, 1e-6]), (3e-15, [4e-6, 2e-6])):
        tiny = 1e-18 * np.eye(3), rounding
        _, *least = claim_rows(order, MOMENTS, 1e-9, 1e-9, 1e-9, *tiny)
        assert [row.prediction for row in least] == pytest.approx(allowed, rel=1e-12)


def test_an_exact_claim_may_be_off_by_twice_what_cubature_is():
    nees, off = claim_rows("exact", MOMENTS, -1e-4, 0.0, 3e-5, np.eye(3), 0.0)
    assert nees.remainder == 0.0
    assert (off.value, off.prediction) == (1e-4, pytest.approx(6e-5, rel=1e-12))


@pytest.mark.parametrize("name", GEOMETRIES)
def test_a_named_geometry_is_the_published_one(name):
    q, references = named_geometry(name)
    A = [[0.352, 0.864, 0.36], [-0.864, 0.152, 0.48], [0.36, -0.48, 0.8]]
    np.testing.assert_allclose(attitude_matrix(q), A, rtol=0.0, atol=1e-15)
    parameters = estimator.Parameters(geometry=name)
    std = GEOMETRIES[name].std
    assert parameters.vectors == len(references) == len(std)
    assert parameters.noise_std == max(std)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("algorithm", "name"),
    [
        ("weighted-wahba", "markley 1"),
        ("weighted-wahba", "markley 9"),
        ("weighted-wahba", "unequal 2"),
        # vectors 0.01 rad apart: noise that is small elsewhere reaches other frames
        ("combined", "markley 7"),
        ("sequential", "markley 9"),
    ],
)
def test_sound_estimators_pass_the_named_geometries(algorithm, name):
    given = {"algorithm": f"simval:{algorithm}", "samples": 1024, "cases": 64}
    rows = outcome("estimator", geometry=name, **given).rows
    assert "fail" not in answers(rows)
    # two directions of each vector; the bound of the case's own noise
    std = [*GEOMETRIES[name].std, *[0.0] * len(GEOMETRIES[name].std)]
    bound = wahba_bound(*named_geometry(name), std).rotation
    (rms,) = (row for row in rows if str(row.statistic) == "rms")
    assert rms.prediction == pytest.approx(np.sqrt(np.trace(bound)), rel=1e-4)


def test_a_named_geometry_has_its_own_vectors():
    with pytest.raises(ValueError, match="the geometry markley 1 has 3"):
        estimator.Parameters(geometry="markley 1", vectors=4)
    with pytest.raises(ValueError, match="give a number, or markley 1"):
        estimator.Parameters(geometry="markley 13")
    # as a suite fills them in
    filled = estimator.Parameters(geometry="markley 1", vectors=2, noise_std=0.01)
    assert (filled.vectors, filled.noise_std) == (3, 1e-6)


def operations(rows):
    """How many operations an attitude takes, by kind."""
    return {r.statistic.entries[0]: r.value for r in of_family(rows, OPERATIONS)}


def test_operations_are_counted():
    x, y = Counted(3.0), Counted(4.0)
    Counted.done = Counter()
    length = np.sqrt(np.array([sum([x * x, 2.0 * y * y, -5.0])], dtype=object))[0]
    assert length.value == 6.0
    assert Counted.done == {"products": 3, "sums": 2, "roots": 1}
    # by hand: 9 sums and differences, 3 quarters, a cross product of 6 and 3, a scalar
    # product of 3 and 2; a length of 4, 3 and a root, one division and 4 products
    found = operations(operation_rows(algorithms.plain, 2))
    sums, products = 9 + 3 + 2 + 3, 3 + 6 + 3 + 4 + 4
    assert found == {
        "fewest": 39, "median": 39, "most": 39,
        "sums": sums, "products": products, "divisions": 1, "roots": 1,
    }  # fmt: skip
    assert operation_rows(algorithms.wahba, 2) == ()


@pytest.mark.parametrize(
    ("arithmetic", "words"),
    [
        (lambda *v: algorithms.plain.arithmetic(*v[2:], *v[:2]), "in 200 of 200 exact"),
        (lambda *v: 2.0 * algorithms.plain.arithmetic(*v), "does not answer the attit"),
        (lambda *v: np.arctan2(v[0][0], v[1][0]), "cannot work with numbers that"),
        (lambda *v: v[0], "cannot work with numbers that count"),
    ],
)
def test_an_arithmetic_that_is_not_the_estimate_is_refused(arithmetic, words):
    with pytest.raises(PluginError, match=words):
        operation_rows(replace(algorithms.plain, arithmetic=arithmetic), 2)


DIGITS = {
    "`optimal`": algorithms.optimal,
    "`combined`": algorithms.combined,
    "`wahba_quaternion` of two pairs": algorithms.wahba,
    "TRIAD": algorithms.triad,
    "K by `eigh`": find_plugin(f"{EXAMPLES / 'optimal.py'}:K by eigh", Estimator),
    "QUEST": find_plugin(f"{EXAMPLES / 'optimal.py'}:QUEST", Estimator),
}


@pytest.mark.parametrize("name", DIGITS)
def test_the_digits_that_the_page_states_are_those_of_the_rows(name):
    """Within three times, which is what another processor may round otherwise."""
    rows = rounding_rows(DIGITS[name], 2, vector_noise("body", 2, 0.01))
    assert [row.check for row in rows] == ["limit"] * 3 + ["record"] * 3
    errors = np.array([row.value for row in rows])
    page = (EXAMPLES.parent / "attitude.md").read_text()
    line = next(each for each in page.splitlines() if each.startswith(f"| {name} |"))
    stated = np.array(line.split("|")[2:-1], dtype=float)
    assert np.all(np.abs(np.log(errors / stated)) < np.log(3.0))
    squares = name in ("K by `eigh`", "QUEST")
    slope = np.polyfit(np.log(SINES), np.log(errors), 1)[0]
    assert slope == pytest.approx(-2.0 if squares else -1.0, abs=0.1)


def test_an_answer_that_is_none_is_recorded_and_not_judged():
    noise = vector_noise("body", 2, 0.01)
    *_, least = rounding_rows(algorithms.plain, 2, noise)
    assert (least.value, least.check) == (np.pi, "record")
    declared = replace(algorithms.optimal, fails_at=("nearly parallel",))
    assert {row.check for row in rounding_rows(declared, 2, noise)} == {"record"}
    assert rounding_rows(algorithms.wahba, 3, vector_noise("body", 3, 0.01)) == ()
    # beyond what a case may err by: its vectors are rounded to six digits

    def coarse(*vectors):
        return algorithms.optimal.estimate(*(np.round(v, 6) for v in vectors))

    rows = rounding_rows(replace(algorithms.optimal, estimate=coarse), 2, noise)
    judged = [row for row in rows if row.check == "limit"]
    assert all(row.value > row.prediction for row in judged)


@pytest.mark.parametrize(
    "name",
    [
        *(pytest.param(x, marks=pytest.mark.slow) for x in ("EULER-2", "SVD")),
        *(pytest.param(x, marks=pytest.mark.ci) for x in ("QUEST", "ESOQ2", "FOAM")),
    ],
)  # fmt: skip
def test_the_closed_form_takes_fewer_operations_than_each_classical_method(name):
    given = {"samples": 1024, "cases": 64}
    ours, theirs = (
        outcome("estimator", algorithm=f"{EXAMPLES / 'optimal.py'}:{who}", **given).rows
        for who in ("closed form", name)
    )
    assert answers(ours) == answers(theirs) == {"pass"}
    assert 2.5 * operations(ours)["median"] < operations(theirs)["median"]
    # the optimum by the same formula, of differences and sums
    path = f"{EXAMPLES / 'optimal.py'}:sums and differences"
    optimum = outcome("estimator", algorithm=path, **given).rows
    assert answers(optimum) == {"pass"}
    assert 1.25 * operations(optimum)["median"] < operations(theirs)["median"]
    # all its frames together, which need no half turn, take fewer than the optimal ones
    combined = operations(operation_rows(algorithms.combined, 2))
    assert combined["most"] == 171
    assert name == "EULER-2" or operations(theirs)["fewest"] > combined["most"]
