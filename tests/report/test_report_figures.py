"""Ratios, findings, ticks, words and colours of the figures, from synthetic curves."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import small_runs
from matplotlib.colors import to_rgb
from rounding import EPS

from simval.report import panels
from simval.report.curves import (
    SEEN,
    Z95,
    Curve,
    Slope,
    limits,
    ratio,
    ratio_bars,
    ratio_panel,
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
from simval.report.panels import DotPanel, Series
from simval.statistics import BIAS, SD

X = np.array([0.001, 0.01, 0.1])


def made(sigmas, *, error=0.01, prediction=None, x=X, remainder=None, label="a"):
    """A curve whose points are so many standard errors from their predictions."""
    sigmas = np.array(sigmas, dtype=float)
    predicted = np.full(len(sigmas), 2.0) if prediction is None else prediction
    return Curve(
        label=label,
        x=x[: len(sigmas)],
        value=predicted * (1.0 + error * sigmas),
        error=error * np.abs(predicted),
        prediction=predicted,
        remainder=remainder,
    )


def test_a_ratio_is_measured_over_predicted_with_its_error():
    c = made([1.0, -2.0, 0.0], prediction=np.array([2.0, -4.0, 0.5]))
    over = ratio(c)
    np.testing.assert_allclose(over.value, [1.01, 0.98, 1.0], rtol=4 * EPS)
    np.testing.assert_allclose(over.error, 0.01, rtol=4 * EPS)
    assert over.x.tolist() == X.tolist()


def test_the_axis_of_a_ratio_is_about_one_and_holds_every_band():
    c = made([3.0, -1.0, 0.0])
    panel = ratio_panel("", "", [c], 2.0)
    low, high = panel.limits
    assert 1.0 - low == pytest.approx(high - 1.0, rel=1e-12)
    (points,) = panel.series
    assert low < (points.y - points.band).min()
    assert (points.y + points.band).max() < high
    # one percent, the error here, is a good part of the axis
    assert 0.01 / (high - low) > 0.05
    # without any distance the axis still has a length
    low, high = limits([np.ones(2)], [np.zeros(2)])
    assert low < 1.0 < high
    assert not panel.log_y


@pytest.mark.parametrize(("error", "shown"), [(0.99, True), (1.01, False)])
def test_a_band_wider_than_one_is_no_ratio(error, shown):
    z = 2.0
    c = made([0.0, 0.0, 0.0], error=error * SEEN / z)
    assert (ratio_panel("", "", [c], z) is not None) == shown
    assert (ratio_bars("", ["a", "b", "c"], [c], z) is not None) == shown


@pytest.mark.parametrize("bad", [0.0, np.nan, np.inf])
def test_a_ratio_to_nothing_is_left_out_and_other_lines_do_not_widen_the_axis(bad):
    c = made([1.0, 1.0, 1.0], prediction=np.array([2.0, bad, 2.0]))
    line = Series(label="far", x=X, y=np.array([1.0, 5.0, 50.0]), line="-")
    panel, wider = (ratio_panel("", "", [c], 2.0, lines) for lines in ((), [line]))
    assert panel.series[0].x.tolist() == [0.001, 0.1]
    assert wider.limits == panel.limits


@pytest.mark.parametrize("value", [1e308, -1e308, np.inf, np.nan, 1e290])
@pytest.mark.parametrize("prediction", [1.0, 1e-200, -1e-300])
def test_a_ratio_that_overflows_has_no_place(value, prediction):
    c = replace(made([0.0, 0.0, 0.0]), value=np.array([value, 1.0, 1.0]))
    c = replace(c, prediction=np.array([prediction, 1.0, 1.0]))
    low, high = ratio_panel("", "", [c], 2.0).limits
    assert np.isfinite(high - low)
    assert low < 1.0 < high


def test_parts_have_their_ratio_at_their_place():
    c = made([1.0, 0.0, -1.0], x=np.arange(3.0))
    panel = ratio_bars("", ["a", "b", "c"], [c], 2.0)
    assert isinstance(panel, DotPanel)
    np.testing.assert_allclose(panel.series[0].x, [1.01, 1.0, 0.99], rtol=4 * EPS)
    assert panel.series[0].y.tolist() == [0.0, 1.0, 2.0]


BAND = simultaneous(3)
FAR = simultaneous(3, SURE)


def said(sigmas, **more):
    """What a figure of these points says of them."""
    c = made(sigmas, **more)
    names = [f"a{k}" for k in range(1, len(c.x) + 1)]
    return agreement(replace(c, names=names)).said("The sd")


@pytest.mark.parametrize(
    ("sigmas", "words"),
    [
        ([1.0, -0.5, 0.0], "agrees with theory within 1 % in all 3 values (most: a1)."),
        ([BAND - 0.01, 0.0, 0.0], "within 2.4 % in all 3 values (most: a1)."),
        ([BAND + 0.01, 0.0, 0.0], "1 of 3 values lies 2.4 standard errors from theory"),
        ([BAND + 0.01, 0.0, 0.0], "expected by chance in one figure of 21."),
        ([FAR - 0.01, 0.0, 0.0], "expected by chance in one figure of 9,"),
        (
            [0.0, FAR + 0.01, 0.0],
            "1 of 3 values differs from theory, the farthest by 4.2",
        ),
        (
            [0.0, -30.0, 9.0],
            "2 of 3 values differ from theory, the farthest (a2) by 30",
        ),
        ([0.5], "agrees with theory within 0.5 % (0.5 standard errors): one value."),
        ([], "0 values, and no prediction to compare with."),
    ],
)
def test_a_finding_says_what_the_points_do(sigmas, words):
    assert words in said(sigmas)


def test_a_finding_without_chance_and_without_a_prediction():
    assert "within rounding: one value" in said([0.0], error=0.0)
    none = np.array([np.nan, np.nan])
    assert "2 values, and no prediction" in said([1.0, 1.0], prediction=none)


def test_what_theory_leaves_out_is_not_held_against_it():
    sigmas, rest = [0.0, 50.0, 0.0], np.array([0.0, 1.1, 0.0])  # of 2, so 55 errors
    words = "; 1 agrees with theory within its stated remainder of 50 %"
    assert words in said(sigmas, remainder=rest)
    # power: a remainder that does not reach, and none
    assert "differs from theory" in said(sigmas, remainder=rest / 2.0)
    assert "differs from theory" in said(sigmas)


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


def test_what_cannot_be_seen_is_counted_and_is_no_agreement():
    assert "cannot be distinguished from zero" in said([1.0, -1.0, 0.5], error=3.0)
    # where it can be seen in some places, they are counted
    some = replace(made([0.0, 0.0]), error=np.array([5.0, 0.01]))
    assert "in 1 of 2 values; 1 cannot be dist" in agreement(some).said("It")


def test_slopes_are_folded_only_where_they_are_theorys():
    one = Slope(1.0, 0.004)
    words, well = slopes_said([(Slope(1.002, 0.004), one), (Slope(0.999, 0.004), one)])
    assert (words, well) == ("2 slopes agree with theory's within 0.002", True)
    near = Slope(1.0 + 0.99 * simultaneous(1) * 0.004 / Z95, 0.004)
    beyond = Slope(1.0 + 1.01 * simultaneous(1) * 0.004 / Z95, 0.004)
    assert slopes_said([(near, one)])[1]
    words, well = slopes_said([(beyond, one), (None, one)])
    assert not well
    assert words.startswith("1 of 1 slope differs from theory's, by up to 2.0 standard")
    assert words.endswith("; 1 cannot be distinguished from zero")
    assert slopes_said([(None, None)]) == (
        "1 slope, none distinguishable from zero in these trials",
        True,
    )


@pytest.mark.parametrize(
    ("share", "words"),
    [(0.0042, "0.42 %"), (0.5, "50 %"), (3.1, "310 %"), (1e-14, "rounding"),
     (3e-6, "0.001 %")],
)  # fmt: skip
def test_shares_are_percent(share, words):
    assert percent(share) == words


def luminance(colour):
    """Relative luminance, WCAG 2."""
    parts = np.array(to_rgb(colour))
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722]), linear


PAPERS = {"white": 1.0, "dark": luminance("#151618")[0]}
ROLES = (
    panels.SIMULATED,
    panels.THEORY,
    panels.ORDER_2,
    panels.ORDER_4_SOURCE,
    panels.ORDER_4_COMPLETE,
    panels.ORDER_2_PRINTED,
)
# Machado, Oliveira and Fernandes 2009, full deficiency, on linear RGB
VISION = {
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
               [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
               [-0.011820, 0.042940, 0.968881]],
    "normal": np.eye(3),
}  # fmt: skip


@pytest.mark.parametrize("colour", sorted({*ROLES, *panels.COLOURS, panels.GREY}))
def test_a_colour_is_seen_on_white_and_on_dark_paper(colour):
    y, _ = luminance(colour)
    for paper in PAPERS.values():
        low, high = sorted((y, paper))
        assert (high + 0.05) / (low + 0.05) >= 3.0  # WCAG 2.1, 1.4.11: graphics


def lab(linear):
    to_xyz = [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
              [0.0193339, 0.1191920, 0.9503041]]  # fmt: skip
    t = np.array(to_xyz) @ np.clip(linear, 0.0, 1.0) / [0.95047, 1.0, 1.08883]
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize(
    ("colours", "least"),
    [(ROLES, 12.0), (panels.COLOURS, 10.0)],
    ids=["roles", "groups"],
)
def test_colours_are_told_apart_with_every_vision(colours, least, vision):
    """CIE76 beyond 10 is a difference at a glance; lines and markers add to it."""
    seen = [lab(np.array(VISION[vision]) @ luminance(c)[1]) for c in colours]
    for a, b in itertools.combinations(range(len(seen)), 2):
        assert np.linalg.norm(seen[a] - seen[b]) > least, (colours[a], colours[b])
    assert len(set(panels.MARKERS)) == len(panels.COLOURS)
