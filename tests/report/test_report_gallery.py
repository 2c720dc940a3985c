"""What studies declare, drawn: nothing is lost, and the rows that pool others are so.

The runs are the smoke suite's and one of the studies that it leaves out.
"""

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from read_back import not_numbers, off_datum, svg
from small_runs import cell_of, run_of

from simval.errors import InputError
from simval.figures import Listing, Shown, Trace
from simval.report import drawings, render, tables
from simval.report.artifacts import drawn_artifacts
from simval.report.formatting import FORMULAS
from simval.report.page import context_of, sections
from simval.report.study_sections import elsewhere, shown_of
from simval.statistics import EXACT, FIRST_ORDER, SECOND_ORDER
from simval.studies import STUDIES
from simval.studies.solvers import METHODS, SOURCES
from simval.sweep import load_run, run_suite

pytestmark = pytest.mark.ci

SUITE = """
title = "Studies that smoke leaves out"
[ladder]
residual = ["squared", "norm"]
noise_std = [0.2, 0.4]
poses = 20
trials = 1024
[attitude_efficiency]
geometries = 100
trials = 10
[attitude_limits]
norm = [0.3, 0.6]
samples = 4096
[attitude_map]
geometries = 5
[attitude_singular]
distance = [0.0, 10.0]
noise_std = [1e-3, 1e-2]
normalized = [false, true]
samples = 1024
[solvers]
poses = 12
[detector]
multiplier = [3.0, 6.0]
trials = 2
[diagnosis]
logs = ["holds", "of known noise"]
[told]
setting = ["true noise", "tenfold"]
gyroscope_error = [1e-3, 1e-2]
trials = 64
[audit]
simulators = ["right", "times"]
seconds = 4.0
trials = 2
"""


@pytest.fixture(scope="module")
def smoke(smoke_run):
    return load_run(smoke_run)


@pytest.fixture(scope="module")
def others(tmp_path_factory):
    folder = tmp_path_factory.mktemp("others")
    (folder / "each.toml").write_text(SUITE, encoding="utf-8")
    run_suite(str(folder / "each.toml"), folder / "run")
    return load_run(folder / "run")


# --- rows that pool others ----------------------------------------------------------


def rows_of(cell, family, predictor=None):
    """Rows of a family by their entries, without control variates."""
    return {
        row.statistic.entries: row
        for row in cell.rows
        if row.statistic.family.name == family
        and not row.statistic.controlled
        and predictor in (None, row.predictor)
    }


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def test_pooled_rows_of_a_calibration_are_those_of_its_entries(smoke):
    noisy = [c for c in smoke.of("calibration") if c.parameters["noise_std"]]
    assert len(noisy) == 2
    for cell in noisy:
        whole, spreads = rows_of(cell, "rms", FIRST_ORDER), rows_of(cell, "spread")
        sd, bias = rows_of(cell, "sd"), rows_of(cell, "bias")
        along = rows_of(cell, "bias_along", SECOND_ORDER)
        for letter, kinds in (("T", "ST"), ("K", "K"), ("B", "B")):
            own = [key for key in sd if key[0][0] in kinds]
            for field in ("value", "prediction"):
                told = getattr(spreads[(letter,)], field)
                entries = [getattr(sd[key], field) for key in own]
                assert told == pytest.approx(rms(entries), rel=1e-12)
            predicted = np.array([bias[key].prediction for key in own])
            value = predicted @ [bias[key].value for key in own] / rms(predicted) / 3.0
            row = along[(letter,)]
            assert row.prediction == pytest.approx(rms(predicted), rel=1e-12)
            # sums of three with cancellation, relative to the greatest of them
            scale = max(abs(bias[key].value) for key in own)
            assert row.value == pytest.approx(value, abs=1e-12 * scale)
            # at most the entries' errors all one way
            errors = [bias[key].standard_error for key in own]
            most = np.abs(predicted) @ errors / rms(predicted) / 3.0
            assert 0.0 < row.standard_error <= most * (1.0 + 1e-12)
        parts = [
            whole[(k,)].value / g for k, g in zip("TKB", (1, 1, 9.80665), strict=True)
        ]
        assert whole[("all",)].value == pytest.approx(rms(parts), rel=1e-12)
        bound = rows_of(cell, "rms", "Cramer-Rao").values()
        over = [row.value / row.prediction for row in bound]
        ratio = rows_of(cell, "rms_over_bound")[()]
        assert ratio.value == pytest.approx(rms(over[:3]))


def test_pooled_rows_of_attitudes_are_projections_of_their_moments(smoke):
    for cell in smoke.of("attitude"):
        for part in ("bias", "covariance"):
            exact = rows_of(cell, part, EXACT)
            twice = {k: 2.0 if len(set(k)) == 2 else 1.0 for k in exact}
            size = np.sqrt(sum(twice[k] * r.prediction**2 for k, r in exact.items()))
            value = sum(twice[k] * r.prediction * r.value for k, r in exact.items())
            row = rows_of(cell, f"{part}_along", EXACT)[()]
            assert row.prediction == pytest.approx(size, rel=1e-12)
            assert row.value == pytest.approx(value / size, rel=1e-9)
            for formula in list(FORMULAS)[:3]:
                own = rows_of(cell, part, formula)
                off = sum(
                    twice[k] * (own[k].prediction - r.prediction) ** 2
                    for k, r in exact.items()
                )
                left = rows_of(cell, "left_out", formula)[(part,)]
                assert left.value == pytest.approx(np.sqrt(off) / size, rel=1e-9)


def test_pooled_rows_are_not_judged_again(smoke):
    families = {"bias_along", "covariance_along", "spread", "left_out"}
    found = [
        row
        for cell in (*smoke.of("calibration"), *smoke.of("attitude"))
        for row in cell.rows
        if row.statistic.family.name in families or row.statistic.entries == ("all",)
    ]
    assert len(found) > 30
    assert {row.check for row in found} == {"record"}


# --- what is declared is drawn ------------------------------------------------------


def test_every_declaration_has_a_name_of_its_own_and_is_drawn(smoke, others):
    names = {"figure": [], "table": []}
    for study in STUDIES.values():
        for shown in study.shown:
            assert isinstance(shown, Shown)
            kind = "table" if isinstance(shown, Listing) else "figure"
            names[kind].append(shown.name)
    for each in names.values():
        assert len(set(each)) == len(each)
    drawn = {d.name for run in (smoke, others) for d in drawings(run)}
    listed = {t.name for run in (smoke, others) for t in tables(run)}
    # of each geometry or frame one; one pose count of scenes is no curve
    whole = {name.partition("-random")[0] for name in drawn}
    assert set(names["figure"]) - whole == {"poses-condition"}
    assert set(names["table"]) <= listed


def test_every_study_has_its_section_and_none_is_there_twice(smoke, others):
    for run in (smoke, others):
        found = [s.anchor for s in sections(run)]
        assert len(set(found)) == len(found)
        for study in {cell.study for cell in run.cells}:
            assert (STUDIES[study].section or "other") in found
        for made in (drawings(run), tables(run)):
            names = [each.name for each in made]
            assert len(set(names)) == len(names)
        page = render(run)
        ids = re.findall(r'\bid="([^"]*)"', page)
        assert len(set(ids)) == len(ids)


def content(drawings, tables):
    """All that is shown, as numbers and words."""
    panels = []
    for drawing in drawings:
        panels.append((drawing.finding, drawing.fold))
        for panel in drawing.panels:
            for series in getattr(panel, "series", ()):
                panels.append((series.label, series.x.tolist(), series.y.tolist()))
            if hasattr(panel, "measured"):
                panels.append((panel.measured.tolist(), panel.predicted.tolist()))
    return repr((panels, [table.rows for table in tables]))


def changed(context, study, name):
    """The context with other numbers in one statistic of one study."""

    def other(row):
        if str(row.statistic) != name:
            return row
        moved = None if row.prediction is None else 3.0 * row.prediction + 0.5
        return replace(row, value=2.0 * row.value + 0.5, prediction=moved)

    cells = tuple(
        replace(cell, rows=tuple(map(other, cell.rows)))
        if cell.study == study
        else cell
        for cell in context.run.cells
    )
    return replace(context, run=replace(context.run, cells=cells))


DECLARED = [name for name, study in STUDIES.items() if study.shown and name != "scene"]


@pytest.mark.parametrize("study", DECLARED)
def test_every_statistic_is_shown_or_named(smoke, others, study, monkeypatch):
    """Other numbers in one statistic: a figure or table changes, or it is named."""
    # a slope is of what is drawn, and fitting them takes most of the time
    monkeypatch.setattr(
        "simval.report.study_sections.fitted_slope", lambda *curve: None
    )
    context = context_of(smoke if smoke.of(study) else others)
    anchors = {s.section or STUDIES[study].section for s in STUDIES[study].shown}
    named = elsewhere(context, STUDIES[study].section)

    def shown(context):
        return [content(*shown_of(context, anchor)) for anchor in sorted(anchors)]

    before, told = shown(context), set()
    rows = [row for cell in context.cells(study) for row in cell.rows]
    kinds = {(r.statistic.family.name, r.statistic.controlled): r for r in rows}
    for row in kinds.values():
        name = str(row.statistic)
        said = name in named or name.partition("[")[0] in named
        assert (before != shown(changed(context, study, name))) != said, name
        told.add(said)
    assert False in told, "something of it is drawn"


def test_every_marker_stands_at_its_datum_and_every_number_is_one(smoke, others):
    for run, least in ((smoke, 300), (others, 80)):
        found = [off_datum(drawing) for drawing in drawings(run)]
        assert [off for off, _ in found if off] == []
        assert sum(count for _, count in found) > least
        assert not_numbers(render(run)) == []


def test_what_is_left_out_is_named(others):
    """More residuals than a figure takes: those not drawn stand below it."""
    ladder = [c for c in others.of("ladder")]
    many = [
        replace(
            cell,
            name=f"{cell.name}{poses}",
            parameters={**cell.parameters, "poses": poses},
        )
        for cell in ladder
        for poses in range(20, 29)
    ]
    run = replace(others, cells=tuple(many))
    (drawing,) = (d for d in drawings(run) if d.name == "ladder")
    drawn = " ".join(panel.title for panel in drawing.panels)
    for poses in range(20, 29):
        words = f"{poses} poses"
        assert (words in drawn) != (words in drawing.left_out)
    page = render(run)
    assert all(name in page for name in drawing.left_out)


def test_numbers_of_a_figure_are_those_of_the_rows(others):
    (bars,) = (d.panels[0] for d in drawings(others) if d.name == "ladder")
    assert set(bars.names) == {"squared", "norm"}
    for name, value, predicted in zip(
        bars.names, bars.measured, bars.predicted, strict=True
    ):
        (row,) = (
            row
            for cell in others.of("ladder")
            for row in cell.rows
            if (cell.parameters["residual"], cell.parameters["noise_std"])
            == (name, 0.2)
            and (str(row.statistic), row.predictor) == ("scale_bias", SECOND_ORDER)
        )
        assert (value, predicted) == (row.value, row.prediction)
    slopes = {row[0]: row for t in tables(others) if t.name == "ladder-slopes"
              for row in t.rows}  # fmt: skip
    assert all(abs(row[3] - 2.0) < 1e-3 for row in slopes.values())


# --- artifacts along time -----------------------------------------------------------


def test_a_long_trace_is_short_on_the_page_and_a_damaged_one_is_refused(tmp_path):
    """4 lines of 50 000 points: half a byte of the page each, all of them above ten."""
    cell = cell_of("detector", [], scene="gimbal", poses=40)
    context = replace(context_of(run_of(tmp_path, [])), run=run_of(tmp_path, [cell]))
    trace = next(s for s in STUDIES["detector"].shown if isinstance(s, Trace))
    time = np.arange(50_000) / 100.0
    arrays = {
        "time": time,
        "signal": np.sin(time)[:, None] + np.zeros(3),
        "variance": np.abs(np.sin(time)) + 1e-6,
        "threshold": [0.1],
        "intervals": [[1.0, 2.0], [5.0, 9.0]],
        "truth": np.empty((0, 2)),
    }
    file = tmp_path / "artifacts" / trace.file(cell.parameters)
    file.parent.mkdir()
    np.savez(file, **arrays)
    (drawing,) = drawn_artifacts(trace, context, [cell])
    assert "2 intervals, and the sensor is never truly at rest." in drawing.finding
    readings, variance = drawing.panels
    for line in readings.series:
        np.testing.assert_array_equal(line.y, np.sin(time))
        np.testing.assert_array_equal(line.x, time)
    assert readings.spans == ((1.0, 2.0), (5.0, 9.0))
    assert variance.spans == ()
    assert variance.references == [(0.1, "threshold")]
    picture = svg(drawing)
    ElementTree.fromstring(f"<all>{picture}</all>")
    assert len(picture) < 100_000
    for lost in arrays:
        np.savez(file, **{k: v for k, v in arrays.items() if k != lost})
        with pytest.raises(InputError, match=f"`{lost}` is missing"):
            drawn_artifacts(trace, context, [cell])


def test_a_trace_without_an_axis_counts_its_values(others):
    context = context_of(others)
    trace = next(s for s in STUDIES["solvers"].shown if isinstance(s, Trace))
    (drawing,) = drawn_artifacts(trace, context, context.cells("solvers"))
    (panel,) = drawing.panels
    assert {s.label for s in panel.series} == {"", *METHODS, *SOURCES}
    assert panel.series[0].x[:2] == pytest.approx([0.0, 1.0])
    file = (
        others.folder / "artifacts" / trace.file(context.cells("solvers")[0].parameters)
    )
    with np.load(file) as ways:
        for name, line in zip(sorted(ways.files), panel.series[::2], strict=True):
            way = ways[name]  # what is zero has no place on a logarithmic axis
            np.testing.assert_array_equal(line.y, np.where(way > 0.0, way, np.nan))
    assert "for newton" in drawing.finding
