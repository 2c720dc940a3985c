"""Sections that belong to one study, from small runs of the studies themselves."""

import re

import numpy as np
import pytest
from every_study import SUITE
from rounding import EPS

from simval.report import drawings, render, tables
from simval.statistics import SCALE_BIAS, SECOND_ORDER
from simval.sweep import load_run, run_suite


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("studies")
    (folder / "each.toml").write_text(SUITE, encoding="utf-8")
    run_suite(str(folder / "each.toml"), folder / "run")
    return load_run(folder / "run")


@pytest.fixture(scope="module")
def page(run):
    return render(run)


@pytest.fixture(scope="module")
def undrawn():
    """What the figures hold, without drawing each once more: `page` has done that."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("simval.report.environment.svg", lambda drawing: "")
        yield


@pytest.fixture(scope="module")
def figures(run, page, undrawn):
    return {drawing.name: drawing for drawing in drawings(run)}


@pytest.fixture(scope="module")
def found(run, page, undrawn):
    return {table.name: table for table in tables(run)}


def test_every_study_has_its_section(page):
    sections = re.findall(r'<section id="([^"]*)"', page)
    for anchor in (
        "ladder",
        "orders",
        "closeness",
        "estimators",
        "statistics",
        "statics",
        "budget",
    ):
        assert anchor in sections
    assert "other" not in sections  # nothing is left for it


def test_the_ladder_holds_the_rows_of_its_smallest_noise(run, figures, found):
    bars = figures["ladder"].panels[0]
    assert set(bars.names) == {"squared", "norm"}
    for name, value, predicted in zip(
        bars.names, bars.measured, bars.predicted, strict=True
    ):
        (cell,) = (
            c
            for c in run.of("ladder")
            if c.parameters["residual"] == name and c.parameters["noise_std"] == 0.2
        )
        row = cell.row(SCALE_BIAS(), SECOND_ORDER)
        assert (value, predicted) == (row.value, row.prediction)
    many = {row[0]: row[3] for row in found["ladder"].rows}
    assert many == {"squared": -3.5, "norm": -2.0}  # theory.md, section 7


def test_the_orders_are_visible_as_slopes(figures, found):
    for row in found["orders"].rows:
        _, _, formula, count, least, greatest, _ = row
        expected = 6.0 if formula == "order 4, complete" else 4.0
        assert count == 1
        # tolerance of the study: twice the next term at the highest level
        assert abs(least - expected) <= 0.1
        assert abs(greatest - expected) <= 0.1
    for panel in figures["orders"].panels:
        assert len(panel.series) == 3
        for series in panel.series:
            rise = np.polyfit(np.log(series.x), np.log(series.y), 1)[0]
            expected = 4.0 if series.label == "order 4, complete" else 2.0
            assert abs(rise - expected) <= 0.1  # drawn over the noise squared


def test_coverage_is_drawn_for_both_kinds_of_error_bars(run, figures):
    (panel,) = figures["coverage"].panels
    assert panel.references[0][0] == 0.95
    labels = " ".join(series.label for series in panel.series)
    assert "known" in labels
    assert "type A" in labels
    drawn = {series.label: series for series in panel.series if not series.line}
    (known,) = (s for label, s in drawn.items() if label == "known, normal")
    cells = [c for c in run.of("coverage") if c.parameters["sigma"] == "known"]
    expected = [
        np.mean([r.value for r in c.rows if r.predictor == "normal"]) for c in cells
    ]
    # the same ratio taken twice
    np.testing.assert_allclose(known.y, expected, rtol=4 * EPS)


def test_the_price_of_an_estimator_is_its_distribution(run, figures, found):
    (panel,) = figures["estimators"].panels
    medians = {row[0]: row[2] for row in found["estimators"].rows}
    for series in panel.series:
        assert np.all(np.diff(series.x) >= 0.0)
        # median of 100 sorted values: between the two in the middle
        low, high = series.x[49], series.x[50]
        assert low <= medians[series.label] <= high


def test_the_recorded_signal_is_shaded_where_it_rests(run, figures):
    (name,) = (n for n in figures if n.startswith("static-"))
    signal, variance = figures[name].panels
    assert len(signal.series) == 3
    assert len(signal.spans) > 10
    assert all(start < stop for start, stop in signal.spans)
    assert variance.references[0][1] == "threshold"
    # in each detected interval the variance is below the threshold, but for the ends
    time, values = variance.series[0].x, variance.series[0].y
    for start, stop in signal.spans:
        middle = np.searchsorted(time, (start + stop) / 2.0)
        assert values[middle] < variance.references[0][0]


def test_the_budget_has_its_parts_and_their_predictions(run, figures):
    (panel,) = figures["budget"].panels
    assert set(panel.names) >= {"calibration", "total"}
    assert np.isfinite(panel.predicted).all()
    (cell,) = run.of("end_to_end")
    for name, value in zip(panel.names, panel.measured, strict=True):
        (row,) = (r for r in cell.rows if str(r.statistic) == f"budget[{name}]")
        assert value == row.value
