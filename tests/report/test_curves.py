"""Numbers, ratios, findings, notes, words and colours of figures, from made curves."""

import csv
import io
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import rows_by_name
import small_runs
from matplotlib.colors import to_rgb
from rounding import EPS
from rows_by_name import cell

from simval.judge.findings import reproduce
from simval.judge.settings import PARAMETERS, axis_words, named, setting_words, varying
from simval.report import panels
from simval.report.curves import (
    SEEN,
    Z95,
    Curve,
    Measured,
    Slope,
    bars,
    curve,
    fitted_slope,
    grouped,
    limits,
    note,
    order,
    ratio,
    ratio_bars,
    ratio_strips,
    simultaneous,
)
from simval.report.findings import (
    SURE,
    Claim,
    agreement,
    limited,
    percent,
    slopes_said,
)
from simval.report.marks import framed
from simval.report.paint import svg
from simval.report.panels import DotPanel, Drawing, Panel, Series
from simval.report.table import Column, Table, csv_text, sort_key, text
from simval.results import CellName
from simval.spelling import measured
from simval.statistics import BIAS, RMS, SD
from simval.studies import STUDIES
from simval.units import MILLIRADIAN

X = np.array([0.001, 0.01, 0.1])


def made(sigmas, *, error=0.01, prediction=None, x=X, remainder=None):
    """A curve whose points are so many standard errors from their predictions."""
    sigmas = np.array(sigmas, dtype=float)
    predicted = np.full(len(sigmas), 2.0) if prediction is None else prediction
    return Curve(
        label="a",
        x=x[: len(sigmas)],
        value=predicted * (1.0 + error * sigmas),
        error=error * np.abs(predicted),
        prediction=predicted,
        remainder=remainder,
    )


# ratios


def strips(curves, z, lines=()):
    """What stands below a panel of these curves."""
    panel = Panel(title="", x_label="", y_label="")
    return ratio_strips(panel, "theory", dict(enumerate(curves)), z, lines)


def test_curves_that_would_cover_each_other_have_strips_on_one_scale():
    curves = [made([3.0, -1.0, 0.0]), made([0.0, 0.0, 20.0])]
    one, other = strips(curves, 2.0, [Series(label="line", x=X, y=X, line="-")])
    assert one.limits == other.limits
    for place, (strip, c) in enumerate(zip((one, other), curves, strict=True)):
        (points,) = strip.series  # and no line, which is over one of them alone
        np.testing.assert_array_equal(points.y, ratio(c).value)
        assert points.x.tolist() == X.tolist()  # at their data
        assert points.colour == panels.COLOURS[place]


def test_a_ratio_is_measured_over_predicted_with_its_error():
    over = ratio(made([1.0, -2.0, 0.0], prediction=np.array([2.0, -4.0, 0.5])))
    np.testing.assert_allclose(over.value, [1.01, 0.98, 1.0], rtol=4 * EPS)
    np.testing.assert_allclose(over.error, 0.01, rtol=4 * EPS)
    assert over.x.tolist() == X.tolist()
    # the parts of something have theirs at their place
    c = made([1.0, 0.0, -1.0], x=np.arange(3.0))
    panel = ratio_bars("", ["a", "b", "c"], [c], 2.0)
    assert isinstance(panel, DotPanel)
    np.testing.assert_allclose(panel.series[0].x, [1.01, 1.0, 0.99], rtol=4 * EPS)
    assert panel.series[0].y.tolist() == [0.0, 1.0, 2.0]


def test_the_axis_of_a_ratio_is_about_one_and_holds_every_band():
    (panel,) = strips([made([3.0, -1.0, 0.0])], 2.0)
    low, high = panel.limits
    assert 1.0 - low == pytest.approx(high - 1.0, rel=1e-12)
    (points,) = panel.series
    assert low < (points.y - points.band).min()
    assert (points.y + points.band).max() < high
    # one percent, the error here, is a good part of the axis
    assert 0.01 / (high - low) > 0.05
    assert not panel.log_y
    # without any distance the axis still has a length; from far it begins at zero, but
    # for a bar that reaches below
    low, high = limits([np.ones(2)], [np.zeros(2)])
    assert low < 1.0 < high
    far = [np.array([2.0, 30.0])]
    low, high = limits(far, [np.ones(2)])
    assert (low, high > 31.0) == (0.0, True)
    assert limits(far, [np.array([5.0, 1.0])])[0] < -3.0


def test_a_band_wider_than_one_is_no_ratio():
    z, names = 2.0, ["a", "b", "c"]
    for error, shown in ((0.99, True), (1.01, False)):
        c = made([0.0, 0.0, 0.0], error=error * SEEN / z)
        assert (strips([c], z) != []) == shown
        assert (ratio_bars("", names, [c], z) is not None) == shown


@pytest.mark.parametrize("bad", [0.0, np.nan, np.inf])
def test_a_ratio_to_nothing_is_left_out_and_other_lines_do_not_widen_the_axis(bad):
    c = made([1.0, 1.0, 1.0], prediction=np.array([2.0, bad, 2.0]))
    # with all that is said of the points
    assert [*ratio(replace(c, names=["a", "b", "c"])).names] == ["a", "c"]
    line = Series(label="far", x=X, y=np.array([1.0, 5.0, 50.0]), line="-")
    (panel,), (wider,) = (strips([c], 2.0, lines) for lines in ((), [line]))
    assert panel.series[0].x.tolist() == [0.001, 0.1]
    assert wider.limits == panel.limits
    # and what overflows has no place
    for value, small in itertools.product((1e308, -1e308, np.inf), (1.0, 1e-200)):
        far = replace(c, value=np.array([value, 2.02, 2.02]))
        far = replace(far, prediction=np.array([small, bad, 2.0]))
        ((low, high),) = (each.limits for each in strips([far], 2.0))
        assert low < 1.0 < high < np.inf


# findings


BAND, FAR = simultaneous(3), simultaneous(3, SURE)


def said(sigmas, **more):
    """What a figure of these points says of them."""
    c = made(sigmas, **more)
    names = [f"a{k}" for k in range(1, len(c.x) + 1)]
    return agreement(replace(c, names=names)).said("The sd")


@pytest.mark.parametrize(
    ("sigmas", "more", "words"),
    [
        ([1.0, -0.5, 0.0], {},
         "agrees with theory within 1 % in all 3 values (most: a1)."),
        ([BAND - 0.01, 0.0, 0.0], {}, "within 2.4 % in all 3 values (most: a1)."),
        ([BAND + 0.01, 0.0, 0.0], {},
         "1 of 3 values lies 2.4 standard errors from theory"),
        ([BAND + 0.01, 0.0, 0.0], {}, "expected by chance in one figure of 21."),
        ([FAR - 0.01, 0.0, 0.0], {}, "expected by chance in one figure of 9,"),
        ([0.0, FAR + 0.01, 0.0], {},
         "1 of 3 values differs from theory, the farthest by 4.2"),
        ([0.0, -30.0, 9.0], {},
         "2 of 3 values differ from theory, the farthest (a2) by 30"),
        ([0.5], {},
         "agrees with theory within 0.5 % (0.5 standard errors): one value."),
        ([], {}, "0 values, and no prediction to compare with."),
        ([0.0], {"error": 0.0}, "within rounding: one value"),
        ([1.0, 1.0], {"prediction": np.full(2, np.nan)}, "2 values, and no prediction"),
        ([1.0, -1.0, 0.5], {"error": 3.0}, "cannot be distinguished from zero"),
        # nor does one agree within 720 % that chance puts so far out
        ([BAND + 0.01, 0.0, 0.0], {"error": 3.0},
         "The sd: 2 cannot be distinguished from zero; 1 of 3 values lies 2.4"),
        ([2.0], {"error": 3.0}, "The sd: 1 of 1 value lies 2.0 standard errors from"),
        # what theory leaves out is not held against it: of 2, so 55 errors
        ([0.0, 50.0, 0.0], {"remainder": np.array([0.0, 1.1, 0.0])},
         "; 1 agrees with theory within its stated remainder of 50 %"),
        ([0.0, 50.0, 0.0], {"remainder": np.array([0.0, 0.55, 0.0])},
         "differs from theory"),
        ([0.0, 50.0, 0.0], {}, "differs from theory"),
    ],
)  # fmt: skip
def test_a_finding_says_what_the_points_do(sigmas, more, words):
    assert words in said(sigmas, **more)


def test_a_limit_is_the_greatest_bias_that_the_trials_do_not_show():
    """Of 0.1 and 0.2 +- 0.1 beside a scatter of 2: (0.2 + 2.24 * 0.1) / 2 = 21 %."""

    def rows(name, values):
        return [
            small_runs.row(f"{name}[{e}]", "p", v, 1.0, 0.1 / v, 99)
            for e, v in zip("xy", values, strict=True)
        ]

    cell = small_runs.cell_of(
        "calibration", [*rows("bias", (0.1, 0.2)), *rows("sd", (2.0, 2.0))]
    )
    bias, scale = (Claim(subject="", cells=[cell], what=[what]) for what in (BIAS, SD))
    words = limited("The bias", bias, scale, "the scatter")
    assert "99 trials to show: less than 21 % of the scatter in all 2 values" in words
    assert "theory predicts 10 % at most" in words


# slopes and bands


def test_slopes_are_folded_only_where_they_are_theorys():
    one = Slope(1.0, 0.004)
    words, well = slopes_said([(Slope(1.002, 0.004), one), (Slope(0.999, 0.004), one)])
    assert (words, well) == ("2 slopes agree with theory's within 0.002", True)
    near, beyond = (
        Slope(1.0 + k * simultaneous(1) * 0.004 / Z95, 0.004) for k in (0.99, 1.01)
    )
    assert slopes_said([(near, one)])[1]
    words, well = slopes_said([(beyond, one), (None, one)])
    assert not well
    assert words.startswith("1 of 1 slope differs from theory's, by up to 2.0 standard")
    assert words.endswith("; 1 cannot be distinguished from zero")
    nothing = "1 slope, none distinguishable from zero in these trials"
    assert slopes_said([(None, None)]) == (nothing, True)


FITS = 400
COVERAGE = 4 * np.sqrt(0.05 * 0.95 / FITS)
"""Four standard errors: 88 % instead of 95 % would be seen nineteen times in twenty."""


@pytest.mark.ci
def test_a_fitted_slope_has_its_interval_and_no_bias_by_points_near_zero():
    """The second: half of the points scatter about zero; they are not left out."""
    rng = np.random.default_rng(4)
    for low, high, points, errors in (
        (1e-3, 1e-1, 6, lambda x: 0.02 * x**2),
        (1e-2, 1.0, 8, lambda x: np.full(8, 0.02)),
    ):
        x = np.geomspace(low, high, points)
        found = [
            fitted_slope(x, x**2 + errors(x) * rng.standard_normal(points), errors(x))
            for _ in range(FITS)
        ]
        inside = np.mean([abs(s.value - 2.0) < s.half_width for s in found])
        assert abs(inside - 0.95) < COVERAGE
        slopes = [s.value for s in found]
        spread = np.std(slopes) / np.sqrt(FITS)
        # the fit is not linear: its own second-order bias is below half its spread
        assert abs(np.mean(slopes) - 2.0) < 4 * spread + 0.01


def test_a_curve_that_cannot_be_told_from_zero_has_no_slope():
    x = np.geomspace(1e-2, 1.0, 6)
    for y in (np.zeros(6), np.full(6, 0.1), np.full(6, np.nan)):
        assert fitted_slope(x, y, np.ones(6)) is None
    assert fitted_slope(x[:1], x[:1], x[:1]) is None
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
        z = np.abs(rng.standard_normal((20_000, count)))
        together = np.all(z < simultaneous(count), axis=1).mean()
        # 95 % from 20 000 draws: standard error 0.15 %, 4 of them allowed
        assert abs(together - 0.95) < 0.0062
    # power: the band of one point does not hold for forty
    assert np.all(z < simultaneous(1), axis=1).mean() < 0.2


# words and tables


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


@pytest.mark.parametrize(
    ("share", "words"),
    [(0.0042, "0.42 %"), (0.5, "50 %"), (3.1, "310 %"), (1e-14, "rounding"),
     (3e-6, "0.001 %")],
)  # fmt: skip
def test_shares_are_percent(share, words):
    assert percent(share) == words


def test_a_cell_is_quoted_for_the_shell():
    cell = CellName("a", "a(b=1)@2")
    assert reproduce(cell) == "simval repro 'a(b=1)@2'"
    assert reproduce(cell, "my run") == "simval repro --run 'my run' 'a(b=1)@2'"
    assert reproduce(CellName("a")) == ""
    assert reproduce(CellName("a", r"a(b=\x1b)@2")) == ""


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
    assert sort_key((0.1, 3.0), column) == "0.1"
    assert sort_key(None, column) == text(None, column) == ""


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


# a unit as the page has it, and as the descriptions of the parameters do
SPELLED = {
    "s": (", s.",),
    "K": (", K.",),
    "Hz": (" Hz",),
    "√Hz": (", root Hz.",),
    "T": (", T.",),
    "m/s²": (", m/s^2",),
    "°": (", degrees.",),
    "°/√s": ("degrees/s per root hertz",),
    "samples": ("amples",),
    "of gravity": ("share of gravity",),
    "of the field": ("share of the field",),
    "standard deviations": ("in standard deviations",),
}


def test_the_unit_of_a_parameter_is_that_of_its_study():
    used = {
        (study, key): field.description
        for study, module in STUDIES.items()
        for key, field in module.parameters.model_fields.items()
        if key in PARAMETERS
    }
    found = {place: named(*place).unit for place in used}
    assert {key for _, key in found} == set(PARAMETERS)  # none is of no study
    for place, description in used.items():
        if unit := found[place]:
            assert any(words in description for words in SPELLED[unit]), place
        else:  # a ratio, a count, or relative to a vector of length 1
            assert not description.rstrip(".").endswith((", s", "m/s^2", ", T", ", Hz"))
    # each unit is of some parameter, so none of the words above is idle
    assert set(found.values()) - {""} == set(SPELLED)


@pytest.mark.parametrize(
    ("study", "key", "value", "setting", "axis"),
    [
        ("filter", "seconds", 8.0, "length 8 s", "length, s"),
        ("calibration", "noise_std", 0.01, "noise 0.01 m/s²", "noise, m/s²"),
        ("attitude", "noise_std", 0.01, "noise 0.01", "noise"),
        ("calibration", "poses", 12, "12 poses", "number of poses"),
        ("magnetometer", "dip_deg", 60.0, "dip 60°", "dip, °"),
        ("calibration", "some_word", "die", "die", "some word"),
        ("calibration", "some_word", "", "no some word", "some word"),
        ("calibration", "some_word", None, "no some word", "some word"),
        ("calibration", "some_word", True, "some word", "some word"),
        ("calibration", "some_word", False, "no some word", "some word"),
    ],
)
def test_a_setting_is_spelled_with_its_unit(study, key, value, setting, axis):
    assert setting_words(study, key, value) == setting
    assert axis_words(study, key) == axis


# notes


def test_a_note_says_number_prediction_cell_and_command():
    row = rows_by_name.row(
        "rms[T]", 6.3262e-5, standard_error=5.4e-7, n=4096, prediction=6.3e-5
    )
    here = replace(
        cell([row]),
        name="calibration(poses=12)@1",
        study="calibration",
        parameters={"scene": "gimbal", "poses": 12, "noise_std": 0.02, "trials": 9},
        run="my run",
    )
    c = curve("", [here], "noise_std", lambda c: c.row(row.statistic))
    assert c.notes == (
        "(6.326 ± 0.054)e-5, n = 4096\n"
        "predicted 6.3e-05\n"
        "calibration: gimbal, 12 poses, noise 0.02 m/s²\n"
        "simval repro --run 'my run' 'calibration(poses=12)@1'",
    )
    assert c.points(1.0).notes == c.notes
    # in a unit for people the note goes with the axis
    own = c.scaled(MILLIRADIAN)
    assert (own.value[0], own.error[0]) == (c.value[0] * 1e3, c.error[0] * 1e3)
    assert own.notes[0].splitlines()[:2] == [
        "0.06326 ± 0.00054 mrad, n = 4096",
        "predicted 0.063 mrad",
    ]
    # where nothing is sampled or predicted, nothing is said of it
    bare = note(here, Measured(2.0, 0.0, np.nan))
    assert bare.splitlines()[0] == "2"
    assert "predicted" not in bare


def test_notes_stay_with_their_points_when_a_curve_is_sorted():
    noise = np.random.default_rng(3).permutation(np.geomspace(1e-3, 1.0, 12))
    cells = [
        cell(
            [rows_by_name.row("rms[T]", 2.0 * x, standard_error=0.1, n=k)],
            noise_std=float(x),
        )
        for k, x in enumerate(noise, start=1)
    ]
    c = curve("", cells, "noise_std", lambda c: c.row(RMS("T")))
    assert np.all(np.diff(c.x) > 0.0)
    counts = [int(n.splitlines()[0].split("n = ")[1]) for n in c.notes]
    assert counts == (np.argsort(noise) + 1).tolist()


def test_bars_say_their_values_where_they_end():
    names = ("one", "two")
    rows = [
        rows_by_name.row(f"budget[{name}]", k * 1e-3, "rad", standard_error=1e-5, n=9,
                         prediction=k * 1.1e-3, predictor="p")
        for k, name in enumerate(names, 1)
    ]  # fmt: skip
    cell = small_runs.cell_of("attitude", rows)
    panel = bars([(cell, r) for r in rows], names, "parts", "mrad", MILLIRADIAN)
    assert panel.notes[1].startswith("2.000 ± 0.010 mrad, n = 9\npredicted 2.2 mrad")
    (ends,) = framed(panel, []).points
    assert (ends.x.tolist(), ends.y.tolist()) == ([1.0, 2.0], [1.0, 0.0])
    drawn = svg(Drawing(name="b", caption="", alternative="parts", panels=[panel]))
    assert drawn.count("<circle") == 2
    assert "2.000 ± 0.010 mrad" in drawn


# colours


def luminance(colour):
    """Relative luminance, WCAG 2, and the linear parts."""
    parts = np.array(to_rgb(colour))
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722]), linear


FORMULAS = (panels.ORDER_2, panels.ORDER_4_SOURCE, panels.ORDER_4_COMPLETE)
ROLES = (panels.SIMULATED, *FORMULAS, panels.ORDER_2_PRINTED)
PAPERS = {"light": ("#ffffff", "#16191d"), "dark": ("#14171b", "#e8eaed")}
"""Paper and ink of the page."""


def on(paper, colours):
    """Colours as they are on a paper."""
    return [panels.DARK.get(c, c) if paper == "dark" else c for c in colours]


# Machado, Oliveira and Fernandes 2009, full deficiency, on linear RGB
VISION = {
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
               [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
               [-0.011820, 0.042940, 0.968881]],
    "normal": np.eye(3),
}  # fmt: skip


@pytest.mark.parametrize("paper", PAPERS)
def test_a_colour_is_seen_on_light_and_on_dark_paper(paper):
    ground, ink = (luminance(each)[0] for each in PAPERS[paper])
    seen = [luminance(c)[0] for c in on(paper, [*panels.DARK, panels.GREY])]
    for y in (*seen, ink):
        low, high = sorted((y, ground))
        assert (high + 0.05) / (low + 0.05) >= 3.0  # WCAG 2.1, 1.4.11: graphics


def lab(linear):
    to_xyz = [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
              [0.0193339, 0.1191920, 0.9503041]]  # fmt: skip
    t = np.array(to_xyz) @ np.clip(linear, 0.0, 1.0) / [0.95047, 1.0, 1.08883]
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("paper", PAPERS)
@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize(("colours", "least"), [(ROLES, 12.0), (panels.COLOURS, 10.0)])
def test_colours_are_told_apart_with_every_vision(colours, least, vision, paper):
    """CIE76 beyond 10 is a difference at a glance; lines and markers add to it."""
    ink = [PAPERS[paper][1]] * (colours is ROLES)  # of theory
    colours = [*on(paper, colours), *ink]
    seen = [lab(np.array(VISION[vision]) @ luminance(c)[1]) for c in colours]
    for a, b in itertools.combinations(range(len(seen)), 2):
        assert np.linalg.norm(seen[a] - seen[b]) > least, (colours[a], colours[b])
    assert len(set(panels.MARKERS)) == len(panels.COLOURS)
