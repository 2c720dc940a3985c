"""What a figure draws of a cell: values, standard errors, predictions, remainders.

The oracle moves the rows' values and sees what becomes of the number that is drawn, so
it shares no formula of an error with the code.
"""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from rounding import EPS
from rows_by_name import cell, row

from simval.report.curves import bars, curve, read, spans, statistic, triple
from simval.report.measures import left_out, moment, part, placed, together
from simval.report.notes import Measured
from simval.report.ratio import limits, ratio, seen
from simval.report.table import NUMBERS, Table, csv_text, numbers_of
from simval.report.units import Unit
from simval.report.words import measured
from simval.results import Row
from simval.statistics import BIAS, COVARIANCE, RMS, SD

BY = "first order"
G = 9.80665


def made(name, value, prediction=1.0, error=0.01, n=100, **fields):
    fields = {"remainder": 0.002, "predictor": BY} | fields
    words = {"prediction": prediction, "standard_error": error, "n": n}
    return row(name, value, **words, **fields)


def slope(measure, rows, name, step=1e-6):
    """How fast the value of a measure grows with that of one row."""
    ends = [
        measure(
            cell(replace(r, value=r.value + s) if r is name else r for r in rows)
        ).value
        for s in (step, -step)
    ]
    return (ends[0] - ends[1]) / (2.0 * step)


def test_a_row_is_drawn_with_its_own_error_and_prediction():
    one = made("rms", -3.0, 2.0, error=0.25, n=64, unit="rad")
    bare = Row(statistic=RMS(), value=1.5)
    assert triple(one) == (-3.0, 0.25, 2.0)
    assert triple(bare)[:2] == (1.5, 0.0)
    assert np.isnan(triple(bare)[2])
    assert read(one) == Measured(-3.0, 0.25, 2.0, 0.002, 64, "rad")
    assert statistic(RMS(), BY)(cell([one])) == read(one)
    assert statistic(RMS(), "exact")(cell([one])) is None


def test_bands_are_standard_errors_times_a_positive_width():
    rows = [made("rms", v, 2.0 * v, error=e) for v, e in ((1, 0.1), (3, 0.2), (2, 0.3))]
    cells = [cell([r], noise_std=x) for r, x in zip(rows, (0.3, 0.1, 0.2), strict=True)]
    drawn = curve("", cells, "noise_std", statistic(RMS(), BY))
    np.testing.assert_array_equal(drawn.x, [0.1, 0.2, 0.3])  # sorted, each with its own
    np.testing.assert_array_equal(drawn.value, [3, 2, 1])
    np.testing.assert_array_equal(drawn.error, [0.2, 0.3, 0.1])
    np.testing.assert_array_equal(drawn.prediction, [6, 4, 2])
    np.testing.assert_array_equal(drawn.remainder, [0.002] * 3)
    np.testing.assert_array_equal(drawn.points(3.0).band, 3.0 * drawn.error)
    shown = drawn.scaled(Unit("m", 1e3))
    for name in ("value", "error", "prediction", "remainder"):
        np.testing.assert_array_equal(getattr(shown, name), 1e3 * getattr(drawn, name))
    np.testing.assert_array_equal(shown.predicted().y, shown.prediction)
    aside = placed("", rows)
    np.testing.assert_array_equal(aside.x, [0, 1, 2])
    np.testing.assert_array_equal(aside.error, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(aside.prediction, [2, 6, 4])
    found = [(cells[0], each) for each in rows]
    panel = bars(found, ["a", "b", "c"], "t", "x", Unit("m", 1e3))
    # 0.95^(1/3) for each of three: the quantile 2.388 (tables of Sidak's intervals)
    np.testing.assert_allclose(panel.band, 1e3 * 2.388 * aside.error, rtol=1e-3)
    np.testing.assert_array_equal(panel.measured, 1e3 * aside.value)
    np.testing.assert_array_equal(panel.predicted, 1e3 * aside.prediction)


def nine(**changes):
    """RMS of T, K and B: B in m/s^2 joins them over standard gravity."""
    rows = [
        made("rms[T]", 3.0, 2.5, error=0.1, n=90, remainder=0.01),
        made("rms[K]", 4.0, 3.5, error=0.2, n=80, remainder=0.02),
        made("rms[B]", 5.0 * G, 4.5 * G, error=0.3 * G, n=70, remainder=0.03 * G),
    ]
    return [replace(each, **changes.get(str(each.statistic), {})) for each in rows]


def test_together_is_the_rms_over_all_nine_and_its_errors_add():
    rows, measure = nine(), together(BY)
    found = measure(cell(rows))
    # 3 of T, 3 of K and 3 of B: the mean of their squares
    assert found.value == pytest.approx(np.sqrt((9 + 16 + 25) / 3), rel=4 * EPS)
    predicted = np.sqrt((2.5**2 + 3.5**2 + 4.5**2) / 3)
    assert found.prediction == pytest.approx(predicted, rel=4 * EPS)
    assert found.n == 70
    # the three share their trials, so the worst case: all move one way
    slopes = np.array([slope(measure, rows, each) for each in rows])
    assert np.all(slopes > 0.0)
    # central differences of step 1e-6: rounding leaves 1e-10
    error = slopes @ [each.standard_error for each in rows]
    rest = slopes @ [each.remainder for each in rows]
    assert found.error == pytest.approx(error, rel=1e-8)
    assert found.remainder == pytest.approx(rest, rel=1e-8)


@pytest.mark.parametrize("name", ["rms[T]", "rms[K]", "rms[B]"])
@pytest.mark.parametrize(
    "fields", [{"prediction": None}, {"value": np.nan}, {"standard_error": np.inf}]
)
def test_together_needs_all_three(name, fields):
    assert together(BY)(cell(nine(**{name: fields}))) is None
    assert (
        together(BY)(cell(each for each in nine() if str(each.statistic) != name))
        is None
    )


def parts(family, letter):
    """Three entries of different size and error."""
    return [
        made(f"{family}[{letter}_{axis}]", v, p, error=e, n=n, remainder=r)
        for axis, v, p, e, n, r in zip(
            "xyz", (3, -1, 2), (2, -2, 1), (0.1, 0.2, 0.4), (9, 8, 7), (0.1, 0.2, 0.3),
            strict=True,
        )
    ]  # fmt: skip


@pytest.mark.parametrize(("family", "name"), [(SD, "K"), (BIAS, "B"), (SD, "T")])
def test_a_part_is_projected_on_its_prediction(family, name):
    rows = parts(family.name, "S" if name == "T" else name)
    measure = part(family, name, BY)
    found = measure(cell(rows))
    # its size is the RMS of the predictions, and where all values are the predicted
    # ones the value is that size; each entry counts as its prediction does
    size = np.sqrt((4 + 4 + 1) / 3)
    assert found.prediction == pytest.approx(size, rel=4 * EPS)
    exact = measure(cell(replace(r, value=r.prediction) for r in rows))
    assert exact.value == pytest.approx(size, rel=8 * EPS)
    slopes = np.array([slope(measure, rows, each) for each in rows])
    np.testing.assert_allclose(slopes, np.array([2, -2, 1]) / (3 * size), atol=1e-9)
    errors, rests = [0.1, 0.2, 0.4], [0.1, 0.2, 0.3]
    # the entries share their trials, so the worst case: all move one way
    assert found.error == pytest.approx(np.abs(slopes) @ errors, rel=1e-8)
    assert found.remainder == pytest.approx(np.abs(slopes) @ rests, rel=1e-8)
    assert found.n == 7


@pytest.mark.parametrize(
    "measure", [part(SD, "K", BY), moment(SD, BY)], ids=["part", "moment"]
)
def test_what_control_variates_measured_is_no_point_of_a_figure(measure):
    """Nor are rows of another theory, another family or another part."""
    rows = parts("sd", "K")
    others = [
        made("control sd[K_x]", 30.0, 2.0, error=5.0, n=1),
        made("sd[K_x]", 30.0, 2.0, error=5.0, n=1, predictor="exact"),
        made("bias[K_x]", 30.0, 2.0, error=5.0, n=1),
    ]
    assert measure(cell([*rows, *others])) == measure(cell(rows))
    assert measure(cell([*others, *rows])) == measure(cell(rows))
    assert part(SD, "B", BY)(cell(rows)) is None
    assert part(SD, "K", BY)(cell([*rows, made("sd[B_x]", 9.0)])).n == 7


def covariances(scale=1.0):
    values = {"x,x": 4.0, "y,y": 9.0, "x,y": -2.0}
    return [
        made(f"covariance[{name}]", 1.1 * scale * v, scale * v, error=e, remainder=r)
        for (name, v), e, r in zip(
            values.items(), (0.1, 0.2, 0.3), (0.01, 0.02, 0.03), strict=True
        )
    ]


def test_a_covariance_is_projected_with_both_of_its_triangles():
    rows, measure = covariances(), moment(COVARIANCE, BY)
    found = measure(cell(rows))
    size = np.linalg.norm([[4.0, -2.0], [-2.0, 9.0]])  # Frobenius
    assert found.prediction == pytest.approx(size, rel=4 * EPS)
    assert found.value == pytest.approx(1.1 * size, rel=8 * EPS)
    slopes = np.array([slope(measure, rows, each) for each in rows])
    np.testing.assert_allclose(slopes, np.array([4.0, 9.0, -4.0]) / size, atol=1e-9)
    rest = np.abs(slopes) @ [0.01, 0.02, 0.03]
    assert found.remainder == pytest.approx(rest, rel=1e-8)
    # normal samples correlate the entries
    P = np.array([[4.0, -2.0], [-2.0, 9.0]])
    pairs = [(0, 0), (1, 1), (0, 1)]
    C = np.array([
        [P[i, k] * P[j, m] + P[i, m] * P[j, k] for k, m in pairs] for i, j in pairs
    ])  # fmt: skip
    own = slopes * [0.1, 0.2, 0.3] / np.sqrt(np.diagonal(C))
    assert found.error == pytest.approx(np.sqrt(own @ C @ own), rel=1e-8)


SHAPES = {  # covariances, by how much the entries have to do with each other
    "round": np.eye(3),
    "long, along an axis": np.diag([1.0, 0.1, 0.01]),
    "near a singular geometry": np.eye(3) * 1e-3 + np.ones((3, 3)),
    "of two directions alone": np.array([[2, 1, 1], [1, 1.0, 0], [1, 0, 1]]),
    "crooked": np.array([[4.0, -2.0, 0.3], [-2.0, 9.0, 1.0], [0.3, 1.0, 2.0]]),
}
UPPER = [(i, j) for i in range(3) for j in range(i, 3)]


def sampled(P, mean, n):
    """Rows of exact predictions with the errors that n normal samples leave."""
    moments = {
        f"covariance[{'xyz'[i]},{'xyz'[j]}]": (
            P[i, j],
            np.sqrt((P[i, i] * P[j, j] + P[i, j] ** 2) / n),
        )
        for i, j in UPPER
    }
    means = {
        f"bias[{axis}]": (m, np.sqrt(v / n))
        for axis, m, v in zip("xyz", mean, np.diagonal(P), strict=True)
    }
    return [
        made(name, value, value, error=error, n=n)
        for name, (value, error) in (moments | means).items()
    ]


@pytest.mark.parametrize("shape", SHAPES)
def test_the_error_of_a_moment_is_that_of_its_samples(shape):
    """Against 20 000 fresh moments of 100 samples each, drawn with a fixed seed."""
    P, n, repeats = SHAPES[shape], 100, 20_000
    rng = np.random.default_rng(20_261_122)
    values, vectors = np.linalg.eigh(P)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    mean = 0.1 * root @ [1.0, 2.0, -1.0]
    z = rng.standard_normal((repeats, n, 3)) @ root.T
    S = np.einsum("kni,knj->kij", z, z) / n  # about the known mean
    found = {
        BIAS: (z.mean(axis=1) + mean) @ mean / np.linalg.norm(mean),
        COVARIANCE: np.einsum("kij,ij->k", S, P) / np.linalg.norm(P),
    }
    rows = sampled(P, mean, n)
    for family, values in found.items():
        drawn = moment(family, BY)(cell(rows))
        # an sd of 20 000 values is known to 0.5 % (0.6 % of squares of 100): 5 of these
        assert drawn.error == pytest.approx(values.std(), rel=0.03), family


def test_errors_added_as_if_independent_would_be_seen():
    """Power of the test above: that rule gives 0.43 of the error of P = 1."""
    P = SHAPES["near a singular geometry"]
    rows = [r for r in sampled(P, np.ones(3), 100) if r.statistic.family == COVARIANCE]
    weight = np.array([P[p] * (1 if p[0] == p[1] else 2) for p in UPPER])
    errors = weight / np.linalg.norm(P) * [r.standard_error for r in rows]
    ratio_of_rules = np.linalg.norm(errors) / moment(COVARIANCE, BY)(cell(rows)).error
    assert ratio_of_rules == pytest.approx(np.sqrt(15.0 / 81.0), rel=0.01)


@pytest.mark.parametrize(
    "damage",
    [
        {"covariance[x,x]": None},  # not there
        {"covariance[x,x]": -1.0},
        {"covariance[x,y]": 50.0},  # correlation above 1
        {"covariance[x,z]": np.nan},
        {"covariance[z,z]": 1e-320},
        {"covariance[x,y]": 1e300},
    ],
)
def test_without_a_covariance_all_entries_move_one_way(damage):
    mean = np.array([3.0, -1.0, 2.0])
    rows = [
        replace(r, prediction=damage.get(str(r.statistic), r.prediction))
        for r in sampled(SHAPES["crooked"], mean, 100)
        if damage.get(str(r.statistic), 0.0) is not None
    ]
    found = moment(BIAS, BY)(cell(rows))
    errors = np.sqrt(np.diagonal(SHAPES["crooked"]) / 100)
    expected = np.abs(mean / np.linalg.norm(mean)) @ errors
    assert found.error == pytest.approx(expected, rel=1e-12)
    assert moment(BIAS, BY)(cell(rows[-3:])).error == pytest.approx(expected, rel=1e-12)


def test_a_covariance_too_odd_to_scale_is_none():
    """Its correlations are infinite, and have no eigenvalues."""
    odd = {f"covariance[{a},{a}]": 1e-320 for a in "xyz"} | {"covariance[x,z]": 1e140}
    rows = [
        replace(r, prediction=odd.get(str(r.statistic), r.prediction))
        for r in sampled(SHAPES["crooked"], np.array([3.0, -1.0, 2.0]), 100)
    ]
    assert np.isfinite(moment(COVARIANCE, BY)(cell(rows)).error)


@pytest.mark.parametrize("family", [BIAS, COVARIANCE])
def test_a_row_of_no_entry_does_not_end_the_page(family):
    rows = [
        replace(r, statistic=replace(r.statistic, entries=()))
        for r in sampled(SHAPES["crooked"], np.array([3.0, -1.0, 2.0]), 100)
        if r.statistic.family == family
    ]
    assert moment(family, BY)(cell(rows)).error > 0.0


def test_what_a_theory_leaves_out_is_its_distance_from_the_exact_one():
    rows = [
        *covariances(),
        *(replace(r, predictor="exact") for r in covariances(1.5)),
        made("control covariance[x,x]", 9.0, 99.0, predictor="exact"),
    ]
    found = left_out(COVARIANCE, BY)(cell(rows))
    size = 1.5 * np.linalg.norm([[4.0, -2.0], [-2.0, 9.0]])
    assert found.prediction == pytest.approx(size, rel=8 * EPS)
    assert found.value == pytest.approx(size / 3.0, rel=8 * EPS)
    assert (found.error, found.against) == (0.0, "of")
    assert left_out(COVARIANCE, "none")(cell(rows)) is None


@pytest.mark.parametrize(
    ("values", "long"),
    [
        ([1.0, 3.0], False),  # just the factor
        ([1.0, 3.0 + 1e-9], True),
        ([2.0, 2.0], False),
        ([3.0 + 1e-9, 1.0], True),  # whatever the order
        ([0.0, 30.0], False),  # no logarithm
        ([-1.0, 30.0], False),
    ],
)
def test_an_axis_is_logarithmic_if_it_spans_more_than_a_factor(values, long):
    assert spans(3.0, [np.array(values)]) is long
    # of several curves together
    apart = [np.array([value]) for value in values]
    assert spans(3.0, apart) is long


def test_a_ratio_has_its_error_over_the_size_of_the_prediction():
    rows = [made("rms", -3.0, -2.0, error=0.5), made("rms", 3.0, 2.0, error=0.5)]
    both = ratio(
        placed("", [*rows, made("rms", 1.0, 0.0), Row(statistic=RMS(), value=1.0)])
    )
    np.testing.assert_array_equal(both.value, [1.5, 1.5])
    np.testing.assert_array_equal(both.error, [0.25, 0.25])
    np.testing.assert_array_equal(both.remainder, [0.001, 0.001])
    np.testing.assert_array_equal(both.prediction, [1.0, 1.0])
    # of width 1 a band tells its point from 0 and 2, and no more
    assert len(seen(both, 4.0).x) == 2
    assert len(seen(both, np.nextafter(4.0, 5.0)).x) == 0


def test_an_axis_of_ratios_holds_its_bands():
    values, bands = [np.array([1.02, 0.99])], [np.array([0.01, 0.05])]
    low, high = limits(values, bands)
    assert (low, high) == pytest.approx((1 - 1.1 * 0.06, 1 + 1.1 * 0.06), rel=8 * EPS)
    assert limits([np.array([1.0])], [None]) == (1.0 - 1e-3, 1.0 + 1e-3)
    # far above 1 the axis ends at zero, or at the lowest band below it
    assert limits([np.array([9.0])], [None])[0] == 0.0
    low = limits([np.array([9.0, 0.5])], [np.array([0.0, 1.5])])[0]
    assert low == pytest.approx(-1.1, rel=4 * EPS)


def test_tables_hold_the_error_as_it_was_measured():
    one = made("rms", -3.0, 2.0, error=0.25, n=64, unit="rad")
    table = Table(name="t", caption="t", columns=NUMBERS, rows=[numbers_of(one)])
    (titles, numbers) = csv.reader(io.StringIO(csv_text(table)))
    found = dict(zip(titles, numbers, strict=True))
    assert found["value"] == "-3.0"
    assert found["standard error of value"] == "0.25"
    assert found["prediction"] == "2.0"
    assert found["n"] == "64"


@pytest.mark.parametrize(
    ("value", "error", "words"),
    [
        (1.2345, 0.012, "1.234 ± 0.012"),
        (-1.2345, 0.012, "-1.234 ± 0.012"),
        (123.4, 5.6, "123.4 ± 5.6"),
        (1.5e-7, 2e-9, "(1.500 ± 0.020)e-7"),
        (2.0, 0.0, "2"),  # nothing sampled
        (0.001, 0.5, "0.00 ± 0.50"),
    ],
)
def test_a_number_has_two_digits_of_its_error(value, error, words):
    assert measured(value, error) == words
