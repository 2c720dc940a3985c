"""What a person reads on the page: units, ticks, axes, values of bars, columns."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
import rows_by_name
import side_by_side
import small_runs

from simval.judge import compare_algorithms
from simval.judge.algorithms import ACCURACY
from simval.report.algorithms import contest_of, dots
from simval.report.curves import bars, limits
from simval.report.page import context_of
from simval.report.paint import placed, svg
from simval.report.panels import Drawing
from simval.report.summary import figures
from simval.report.table import Column, Table, csv_text, text
from simval.statistics import EXACT, RMS
from simval.units import MILLIRADIAN


def test_a_column_has_its_own_unit_on_the_page_and_si_in_the_file():
    column = Column("RMS, rad", "measured", shown="RMS, mrad", factor=1e3)
    rows = [[(0.0125, 0.00025), "1", None], [(0.5, 0.0), "1", None]]
    columns = (column, Column("unit", "unit"), Column("note"))
    table = Table(name="t", caption="", columns=columns, rows=rows)
    assert column.heading == "RMS, mrad"
    assert text(rows[0][0], column) == "12.50 ± 0.25"
    assert list(table.filled) == [0], "a unit 1 is none, and nothing has a note"
    head, first, _ = csv.reader(io.StringIO(csv_text(table)))
    assert head == ["RMS, rad", "standard error of RMS, rad", "unit", "note"]
    assert first == ["0.0125", "0.00025", "1", ""]


def test_an_axis_of_ratios_does_not_reach_below_zero_for_nothing():
    one, far = np.array([0.9, 1.1]), np.array([2.0, 30.0])
    near = limits([one], [np.array([0.1, 0.1])])
    assert near[0] + near[1] == pytest.approx(2.0), "about 1"
    low, high = limits([far], [np.ones(2)])
    assert low == 0.0
    assert high > 31.0
    low, _ = limits([far], [np.array([5.0, 1.0])])
    assert low < -3.0, "a bar that reaches there is whole"


def test_bars_say_their_values_where_they_end():
    names = ("one", "two")
    row = rows_by_name.row
    rows = [
        row(f"budget[{name}]", k * 1e-3, "rad", standard_error=1e-5, n=9,
            prediction=k * 1.1e-3, predictor="p")
        for k, name in enumerate(names, 1)
    ]  # fmt: skip
    cell = small_runs.cell_of("attitude", rows)
    panel = bars([(cell, r) for r in rows], names, "parts", "mrad", MILLIRADIAN)
    assert panel.notes[1].startswith("2.000 ± 0.010 mrad, n = 9\npredicted 2.2 mrad")
    (ends,) = placed(panel)
    assert ends.x.tolist() == [1.0, 2.0]
    assert ends.y.tolist() == [1.0, 0.0]
    drawing = Drawing(name="b", caption="", alternative="parts", panels=[panel])
    drawn = svg(drawing)
    assert drawn.count("<circle") == 2
    assert "2.000 ± 0.010 mrad" in drawn


def test_the_first_screen_says_degrees(tmp_path):
    run = small_runs.accuracy(tmp_path)
    figure = figures(context_of(run))[1]
    points = figure.panels[0].series[-1]
    assert figure.panels[0].y_label == "RMS error, °"
    # an angle is twice the length of the quaternion's error
    sizes = sorted(cell.row(RMS(), EXACT).value for cell in run.of("attitude"))
    angles = np.degrees(2.0 * np.array(sizes))
    assert all(np.isclose(angles, y, rtol=1e-12).any() for y in points.y)
    assert "°" in points.notes[0]


def test_dots_and_their_best_name_the_same_numbers(tmp_path):
    run = small_runs.own_estimator(tmp_path)
    contest = contest_of(run.of("estimator"))
    drawing = dots("estimators", contest)
    (panel,) = drawing.panels
    for series in panel.series:
        for x, note in zip(series.x, series.notes, strict=True):
            assert float(note.split()[0]) == pytest.approx(x, abs=1e-4)
            assert "× the bound" in note
            assert "simval repro" in note
    # geometric means of 1.01 and 1.111, of 1.2 and 1.32 (tests/report/small_runs.py)
    assert "simval:wahba is nearest to the bound, with 1.06 times" in drawing.finding
    assert "mine.py farthest, with 1.26 times" in drawing.finding


def test_the_best_is_of_settings_in_which_all_have_a_result(tmp_path):
    """One whose worse setting was refused is not the best by that, nor of two."""
    cells = small_runs.own_estimator(tmp_path).of("estimator")
    noises = sorted({cell.parameters["noise_std"] for cell in cells})

    def found(*kept):
        """What is said if the user's own has a result at these noises alone."""
        given = [
            cell
            if cell.parameters["algorithm"] != "mine.py"
            or cell.parameters["noise_std"] in kept
            else replace(cell, status="failed", error="refused: x", rows=())
            for cell in cells
        ]
        return dots("estimators", contest_of(given)).finding

    one = found(noises[0])
    assert "with 1.01 times its error, and mine.py farthest, with 1.2 times" in one
    assert one.endswith("(in 1 of 2 settings).")
    # what is measured nowhere takes no setting from the others
    none = found()
    assert "with 1.06 times its error, and simval:triad farthest" in none
    assert none.endswith("(geometric mean over 2 settings).")


@pytest.mark.parametrize(
    ("ratios", "said"),
    [
        ((1.1, 1.1, 1.1), "No difference is seen between mine.py, with 1.1 times"),
        ((1.1, 1.1, 1.5), "mine.py (no difference seen to simval:wahba) is nearest"),
        ((1.1, 1.5, 1.5), "simval:wahba (no difference seen to simval:triad) farthest"),
        ((1.1, 1.2, 1.5), "mine.py is nearest to the bound, with 1.1 times its error,"),
    ],
)
def test_what_compare_does_not_tell_apart_is_not_ranked(tmp_path, ratios, said):
    names = ("mine.py", "simval:wahba", "simval:triad")
    cells = [
        side_by_side.cell(name, side_by_side.estimator_rows(ratio, 2e-3, 0.01))
        for name, ratio in zip(names, ratios, strict=True)
    ]
    run = side_by_side.run_of(tmp_path, cells)
    finding = dots("estimators", contest_of(run.of("estimator"))).finding
    assert said in finding
    # as the command says of the same pair
    merits = compare_algorithms(run, names[0], names[1]).merits
    tied = all(m.standing == "same" for m in merits if m.what == ACCURACY)
    assert tied == (ratios[0] == ratios[1])
