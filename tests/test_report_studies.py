"""Sections that belong to one study, from small runs of the studies themselves."""

import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from every_study import SUITE
from rounding import EPS

from simval.errors import InputError
from simval.report import drawings, render, tables
from simval.report.distribution import MOST, share_at_most
from simval.report.palette import GROUPS, THEORY
from simval.report.sections import geometries, vectors
from simval.statistics import (
    CHI_SQUARE,
    FIRST_ORDER,
    INCONSISTENT_RATE,
    LEADING_ERROR_RATIO,
    LIMIT_RATIO,
    NEARER,
    ORDER_2,
    ORDER_4,
    ORDER_4_SOURCE,
    RMS_OVER_BOUND,
    SCALE_BIAS,
    SECOND_ORDER,
)
from simval.sweep import load_run, run_suite

pytestmark = pytest.mark.ci

WEIGHTED = RMS_OVER_BOUND("weighted"), FIRST_ORDER


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
        "geometries",
        "ranges",
        "vectors",
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
    for panel in (*figures["orders"].panels, *figures["orders-bias"].panels):
        assert len(panel.series) == 3
        for series in panel.series:
            rise = np.polyfit(np.log(series.x), np.log(series.y), 1)[0]
            expected = 4.0 if series.label == "fourth order, complete" else 2.0
            assert abs(rise - expected) <= 0.1  # drawn over the noise squared


def test_coverage_is_drawn_for_both_kinds_of_error_bars(run, figures):
    (panel,) = (p for p in figures["coverage"].panels if p.title.startswith("coverage"))
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
    panel, over = figures["budget"].panels
    assert set(panel.names) >= {"magnetometer noise in the tumble", "total"}
    assert np.isfinite(panel.predicted).all()
    (cell,) = run.of("end_to_end")
    for name, value in zip(panel.names, panel.measured, strict=True):
        (row,) = (r for r in cell.rows if str(r.statistic) == f"budget[{name}]")
        assert row.unit == "rad"
        assert value == 1e3 * row.value  # milliradians, for a person
    assert panel.x_label == "contribution, mrad"
    (ratios,) = over.series
    np.testing.assert_allclose(ratios.x, panel.measured / panel.predicted, rtol=8 * EPS)


def of_geometries(run, folder):
    """The run as it lies in a folder, with two of its studies."""
    studies = ("attitude_geometries", "attitude_map")
    cells = tuple(cell for cell in run.cells if cell.study in studies)
    return replace(run, folder=folder, cells=cells)


def artifact(run, name):
    with np.load(run.folder / "artifacts" / name) as content:
        return {key: content[key] for key in content.files}


def test_many_geometries_are_drawn_as_their_distribution(run, figures, found):
    drawing = figures["geometries"]
    titles = ["isotropic noise, greatest frame", "full noise, greatest frame"]
    assert [panel.title for panel in drawing.panels] == titles
    cells = run.of("attitude_geometries")
    for cell, panel in zip(cells, drawing.panels, strict=True):
        noise = cell.parameters["noise"]
        ratios = artifact(run, f"attitude-geometries-{noise}-greatest-20.npz")
        curves = {s.label: s for s in panel.series}
        assert set(curves[ORDER_2].x) == {1.0}  # over itself
        assert set(curves[ORDER_4].x) == {0.0}  # of higher order
        for name, values in ratios.items():
            np.testing.assert_array_equal(curves[name].x[:20], np.sort(values))
            np.testing.assert_allclose(curves[name].y[:20], (np.arange(20) + 0.5) / 20)
            assert curves[name].x[-1] > values.max()  # and stays at 1 to the end
            assert set(curves[name].y[20:]) == {1.0}
            (row,) = (
                r for r in found["geometries"].rows if r[0] == noise and r[3] == name
            )
            assert row[6] == cell.row(LEADING_ERROR_RATIO("median"), name).value
            assert row[6] == np.median(values)
            assert row[9] == cell.row(NEARER(), name).value == np.mean(values < 1.0)


def test_the_finding_is_what_the_numbers_say(run, figures):
    told = figures["geometries"].caption
    both = [
        artifact(run, f"attitude-geometries-{noise}-greatest-20.npz")
        for noise in ("isotropic", "full")
    ]
    low, high = sorted(100.0 * np.mean(r[ORDER_4_SOURCE] < 1.0) for r in both)
    assert 0.0 < low < high
    assert f"nearer to the truth in {low:.3g} % (" in told
    assert f"{high:.3g} % (full noise, greatest frame) of 20 geometries" in told
    medians = sorted(np.median(r[ORDER_4_SOURCE]) for r in both)
    assert "{:.3g} to {:.3g} times as large in the median".format(*medians) in told
    assert "usually worse, sometimes better, than the second order" in told
    assert "Equation (63) as printed is always better" in told


@pytest.mark.parametrize(
    ("ratios", "words"),
    [
        ([0.5, 0.9], "is always better than the second order, and never of higher"),
        ([1.1, 1.2], "is always worse than the second order, and never of higher"),
        ([0.5, 0.9, 1.1], "is usually better, sometimes worse, than"),
        ([0.5, 1.2, 1.1], "is usually worse, sometimes better, than"),
        ([0.0, 0.9, 1.1], "than the second order. It is nearer"),  # may be higher
        ([0.5, 1.2], "nearer to the truth in 50 % of 2 geometries"),
    ],
)
def test_every_finding_has_its_words(run, ratios, words):
    cell = run.of("attitude_geometries")[0]
    given = [(cell, {ORDER_4_SOURCE: np.array(ratios)})]
    assert words in geometries._finding(ORDER_4_SOURCE, given)


def test_a_long_distribution_is_thinned_and_keeps_its_ends():
    values = np.random.default_rng(1).exponential(size=100_000)
    curve = share_at_most("", values, 99.0, "", "-")
    assert len(curve.x) == MOST + 2
    assert (curve.x[0], curve.x[-3], curve.x[-1]) == (values.min(), values.max(), 99.0)
    for x, y in zip(curve.x[:-2], curve.y[:-2], strict=True):
        # half a value, as drawn in the middle of its step
        assert abs(np.mean(values <= x) - y) <= 0.5001 / len(values)


def test_the_range_of_a_formula_is_its_distribution(run, figures, found):
    (cell,) = run.of("attitude_map")
    limits = artifact(run, "attitude-map-greatest-5.npz")
    for panel in figures["ranges-greatest"].panels:
        part, _, share = panel.title.replace(" %", "%").partition(" within ")
        assert len(panel.series) == 3
        for series in panel.series:
            values = limits[f"{series.label}, {part}, {share}"]
            np.testing.assert_array_equal(series.x[:5], np.sort(values))
            (row,) = (
                r
                for r in found["ranges"].rows
                if r[2:5] == (series.label, part, share.replace("%", " %"))
            )
            statistic = LIMIT_RATIO(part, share, "median")
            assert row[7] == cell.row(statistic, series.label).value
            assert row[7] == np.median(values)
    half, most = np.quantile(limits[f"{ORDER_2}, covariance, 1%"], [0.5, 0.9])
    told = figures["ranges-greatest"].finding
    assert f"{half:.3g} and {most:.3g} for second order" in told
    assert "from 30 down to 1.2" in figures["ranges-greatest"].caption


def test_the_price_of_unequal_noise_is_drawn_as_it_is_measured(run, figures, found):
    drawing = figures["vectors"]
    assert [panel.title for panel in drawing.panels] == ["2 vectors", "3 vectors"]
    for n, panel in zip((2, 3), drawing.panels, strict=True):
        assert panel.log_x
        assert not panel.log_y
        cells = [c for c in run.of("attitude_vectors") if c.parameters["vectors"] == n]
        points = [s for s in panel.series if not s.line]
        lines = [s for s in panel.series if s.line]
        assert len(points) == len(lines) == (4 if n == 2 else 2)
        for measured, line in zip(points, lines, strict=True):
            rows = [c.row(RMS_OVER_BOUND(measured.label), FIRST_ORDER) for c in cells]
            assert measured.x.tolist() == line.x.tolist() == [1.0, 100.0]
            assert measured.y.tolist() == [row.value for row in rows]
            assert line.y.tolist() == [row.prediction for row in rows]
            assert line.colour == THEORY
            assert measured.colour in GROUPS
            for row, band in zip(rows, measured.band, strict=True):
                assert band > 1.96 * row.standard_error  # all of them together
    tested = [(row[0], row[1], row[4][0], row[5]) for row in found["vectors-test"].rows]
    assert tested == [
        (
            cell.parameters["vectors"],
            cell.parameters["ratio"],
            cell.row(INCONSISTENT_RATE("good"), CHI_SQUARE).value,
            cell.row(INCONSISTENT_RATE("good"), CHI_SQUARE).prediction,
        )
        for cell in run.of("attitude_vectors")
    ]


def test_one_ratio_of_noises_still_has_a_line(run):
    (cell,) = (
        c
        for c in run.of("attitude_vectors")
        if c.parameters["vectors"] == 2 and c.parameters["ratio"] == 100.0
    )
    drawing = vectors._efficiency({"2 vectors": (cell,)}, ["weighted"], [cell])
    points, line = drawing.panels[0].series
    assert line.x[0] < points.x[0] < line.x[1]
    assert line.y[0] == line.y[1] == cell.row(*WEIGHTED).prediction


@pytest.mark.parametrize(
    "name", ["attitude-geometries-full-greatest-20", "attitude-map-greatest-5"]
)
def test_a_damaged_distribution_is_named(run, name, tmp_path):
    shutil.copytree(run.folder, tmp_path / "run")
    file = tmp_path / "run" / "artifacts" / f"{name}.npz"
    content = artifact(run, f"{name}.npz")
    np.savez(file, **{key: values[:-1] for key, values in content.items()})
    with pytest.raises(InputError, match=f"{name}.npz.*must have"):
        drawings(of_geometries(run, tmp_path / "run"))


def test_cells_without_a_distribution_are_named(run, tmp_path):
    shutil.copytree(run.folder, tmp_path / "run")
    artifacts = tmp_path / "run" / "artifacts"
    (artifacts / "attitude-geometries-full-greatest-20.npz").unlink()
    (artifacts / "attitude-map-greatest-5.npz").unlink()
    now = of_geometries(run, tmp_path / "run")
    drawn = {drawing.name: drawing for drawing in drawings(now)}
    assert len(drawn["geometries"].panels) == 1
    assert len(drawn["geometries"].left_out) == 1
    assert "full noise" in drawn["geometries"].left_out[0]
    assert "ranges-greatest" not in drawn
    rows = {table.name: len(table.rows) for table in tables(now)}
    assert rows["geometries"] == 4  # the tables are from the rows
    assert rows["ranges"] == 12
