"""The report: complete, self-contained, the same bytes, honest about gaps."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from simval.report import render
from simval.report.section import measured
from simval.report.slope import fitted_slope
from simval.sweep import load_run, store


def test_the_same_run_gives_the_same_bytes(tiny_run):
    assert render(load_run(tiny_run)) == render(load_run(tiny_run))


def test_the_page_is_complete_and_needs_no_network(tiny_run):
    page = render(load_run(tiny_run))
    for anchor in ("summary", "calibration", "attitude", "checks", "numbers"):
        assert f'id="{anchor}"' in page
    assert "PASS: every check agrees with theory" in page
    # no address is loaded: only data and anchors of the page itself
    links = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert links
    assert all(link.startswith(("data:", "#")) for link in links)
    assert "@import" not in page
    assert "<script" not in page


def test_figures_are_well_formed_have_a_text_and_no_double_id(tiny_run):
    page = render(load_run(tiny_run))
    figures = re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL)
    assert len(figures) == 2
    for figure in figures:
        root = ElementTree.fromstring(figure)
        assert root.get("aria-label")
    ids = re.findall(r'\bid="([^"]*)"', page)
    assert len(set(ids)) == len(ids)


def test_missing_and_failed_cells_are_shown_and_escaped(tiny_run):
    with store.opened(tiny_run / "run.sqlite") as database, database:
        database.execute("UPDATE cells SET status = 'failed', error = '<b>x</b>'")
        database.execute("DELETE FROM rows")
    page = render(load_run(tiny_run))
    assert "Cells without a result" in page
    assert "INCONCLUSIVE" in page
    assert "&lt;b&gt;x&lt;/b&gt;" in page
    assert "<b>x</b>" not in page


def test_the_command_prints_the_path_last(simval, tiny_run, tmp_path):
    code, out, _ = simval("report", tiny_run)
    assert code == 0
    assert out.splitlines()[-1] == str(tiny_run / "report.html")
    assert simval("report", tiny_run, "--out", tmp_path / "no" / "x.html")[0] == 2
    assert simval("report", tmp_path)[0] == 2


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (1.23456, 0.0123, "1.235 ± 0.012"),
        (6.3255e-5, 5.4e-7, "6.325 ± 0.054e-5"),
        (-0.5, 0.0, "-0.5"),
        (0.0, 0.2, "0.00 ± 0.20"),
        (1234.5, 12.0, "1234 ± 12"),
    ],
)
def test_numbers_show_the_digits_that_mean_something(value, error, text):
    assert measured(value, error) == text


def test_fitted_slope_recovers_a_known_one_with_its_interval():
    rng = np.random.default_rng(4)
    x = np.geomspace(1e-3, 1e-1, 6)
    inside = 0
    for _ in range(2000):
        error = 0.02 * x**2
        y = x**2 + error * rng.standard_normal(6)
        slope = fitted_slope(x, y, error)
        inside += abs(slope.value - 2.0) < slope.half_width
    # coverage of 95 % from 2000 fits: standard error 0.5 %, 4 of them allowed
    assert abs(inside / 2000 - 0.95) < 0.02
    assert fitted_slope(x[:1], x[:1], x[:1]) is None
    assert fitted_slope(x, -x, x) is None
