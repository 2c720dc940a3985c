"""Parts of the report: numbers in words, slopes, bands, pixels, tables."""

import math

import numpy as np
import pytest
from rows_by_name import cell

from simval.judge.findings import reproduce
from simval.report.curves import fitted_slope, grouped, order, simultaneous, varying
from simval.report.table import Column, Table, csv_text, sort_key, text
from simval.report.words import measured
from simval.results import CellName


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (1.23456, 0.0123, "1.235 ± 0.012"),
        (6.3255e-5, 5.4e-7, "(6.325 ± 0.054)e-5"),
        (-0.5, 0.0, "-0.5"),
        (0.0, 0.2, "0.00 ± 0.20"),
        (1234.5, 12.0, "1234 ± 12"),
        (math.inf, 1.0, "inf"),
        (math.nan, 1.0, "nan"),
        (1.0, math.inf, "1"),
        (1.0, math.nan, "1"),
    ],
)
def test_numbers_show_the_digits_that_mean_something(value, error, text):
    assert measured(value, error) == text


def test_a_cell_is_quoted_for_the_shell():
    cell = CellName("a", "a(b=1)@2")
    assert reproduce(cell) == "simval repro 'a(b=1)@2'"
    assert reproduce(cell, "my run") == "simval repro --run 'my run' 'a(b=1)@2'"
    assert reproduce(CellName("a")) == ""
    assert reproduce(CellName("a", r"a(b=\x1b)@2")) == ""


FITS = 400
COVERAGE = 4 * np.sqrt(0.05 * 0.95 / FITS)
"""Four standard errors: 88 % instead of 95 % would be seen nineteen times in twenty."""


@pytest.mark.ci
def test_fitted_slope_recovers_a_known_one_with_its_interval():
    rng = np.random.default_rng(4)
    x = np.geomspace(1e-3, 1e-1, 6)
    inside = 0
    for _ in range(FITS):
        error = 0.02 * x**2
        slope = fitted_slope(x, x**2 + error * rng.standard_normal(6), error)
        inside += abs(slope.value - 2.0) < slope.half_width
    assert abs(inside / FITS - 0.95) < COVERAGE
    assert fitted_slope(x[:1], x[:1], x[:1]) is None


@pytest.mark.ci
def test_fitted_slope_is_not_biased_by_points_near_zero():
    """Half of the points scatter about zero; leaving them out would bias the slope."""
    rng = np.random.default_rng(5)
    x = np.geomspace(1e-2, 1.0, 8)
    error = np.full(8, 0.02)
    slopes, inside = [], 0
    for _ in range(FITS):
        slope = fitted_slope(x, x**2 + error * rng.standard_normal(8), error)
        slopes.append(slope.value)
        inside += abs(slope.value - 2.0) < slope.half_width
    mean, spread = np.mean(slopes), np.std(slopes) / np.sqrt(FITS)
    # the fit is not linear: its own second-order bias is below half its spread of 0.1
    assert abs(mean - 2.0) < 4 * spread + 0.01
    assert abs(inside / FITS - 0.95) < COVERAGE


def test_a_curve_that_cannot_be_told_from_zero_has_no_slope():
    x = np.geomspace(1e-2, 1.0, 6)
    assert fitted_slope(x, np.zeros(6), np.ones(6)) is None
    assert fitted_slope(x, np.full(6, 0.1), np.ones(6)) is None
    assert fitted_slope(x, np.full(6, np.nan), np.ones(6)) is None
    # negative all along is a curve too, with its sign
    assert fitted_slope(x, -(x**2), 1e-3 * x**2).value == pytest.approx(2.0, abs=1e-6)


def test_order_is_the_slope_at_the_smallest_noise():
    x = np.array([1e-3, 2e-3, 4e-3])
    # the next term is 5 times the noise here: log2(1.01 / 1.005) = 0.007 off
    assert order(x, x**4 * (1 + 5 * x)) == pytest.approx(4.0, abs=0.008)
    assert order(x[:1], x[:1]) is None
    assert order(x, np.array([0.0, 1.0, 16.0])) == pytest.approx(4.0, abs=1e-12)


def test_simultaneous_bands_cover_together():
    rng = np.random.default_rng(6)
    for count in (1, 5, 40):
        z = simultaneous(count)
        together = np.all(np.abs(rng.standard_normal((20_000, count))) < z, axis=1)
        # 95 % from 20 000 draws: standard error 0.15 %, 4 of them allowed
        assert abs(together.mean() - 0.95) < 0.0062
    # power: the band of one point does not hold for forty
    alone = np.all(np.abs(rng.standard_normal((20_000, 40))) < simultaneous(1), axis=1)
    assert alone.mean() < 0.2


def test_csv_is_exact_and_no_formula_for_a_spreadsheet():
    table = Table(
        name="x",
        caption="",
        columns=(Column("what"), Column("v", "measured"), Column("p", "number")),
        rows=[("=1+1", (0.1, 1e-17), None), ('a,"b"', (2.0, 0.0), 1 / 3)],
        shown=1,
    )
    assert csv_text(table) == (
        "what,v,standard error of v,p\n'=1+1,0.1,1e-17,\n"
        '"a,""b""",2.0,0.0,0.3333333333333333\n'
    )
    assert len(table.visible) == 1


def test_sort_keys_are_numbers_and_empty_cells_are_empty():
    column = Column("v", "measured")
    assert sort_key((0.1, 3.0), column) == "0.1"
    assert text((0.5, 0.0), column) == "0.5"
    assert sort_key(None, Column("p", "number")) == ""
    assert text(None, Column("p", "number")) == ""
    assert sort_key("a", Column("t")) == ""


def test_cells_are_grouped_by_what_varies_beside_the_axis():
    cells = [
        cell(poses=p, scene=s, noise_std=n, trials=int(1 / n), fixed=3)
        for p in (12, 40)
        for s in ("gimbal", "die")
        for n in (0.1, 0.2)
    ]
    assert varying(cells) == ["noise_std", "poses", "scene", "trials"]
    groups = grouped(cells, "noise_std")
    assert next(iter(groups)) == "12 poses, gimbal"
    assert [len(g) for g in groups.values()] == [2, 2, 2, 2]
