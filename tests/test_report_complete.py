"""Nothing of a study is missing from its section without being named there."""

import importlib
import re
from dataclasses import replace

import pytest
import rows_by_name
from small_runs import cell_of

from simval.judge import judge_run
from simval.report import drawings, render, tables
from simval.report.page import SECTIONS, sections
from simval.report.panels import BarPanel, DotPanel, Panel
from simval.report.section import Context
from simval.report.sections import attitude, convergence, other, statistics
from simval.report.slope import fitted_slope
from simval.studies import STUDIES
from simval.sweep.run import Run, load_run

MANIFEST = {
    "suite": "made",
    "title": "Made",
    "grid": {"seed": [1]},
    "cells": 0,
    "versions": {"simval": "0"},
    "git": {"commit": None, "dirty": None},
    "models": {},
    "machine": {"system": "", "processor": "", "kernels": []},
}
VARIED = {
    "ladder": ("poses", range(20, 27)),
    "calibration": ("poses", range(12, 19)),
    "coverage": ("poses", range(12, 21)),
    "attitude": ("geometry", range(1, 10)),
    "attitude_order": ("noise", ("isotropic", "full", "tangent")),
    "attitude_limits": ("norm", (0.2, 0.3, 0.4, 0.5)),
    "attitude_efficiency": ("geometries", range(100, 109)),
    "attitude_geometries": ("noise", ("isotropic", "tangent", "full")),
    "attitude_map": ("frame", ("greatest", "plain")),
    "attitude_vectors": ("vectors", range(2, 7)),
    "detector": ("trim", range(1, 10)),
    "magnetometer": ("poses", range(12, 21)),
    "gyroscope": ("poses", range(12, 21)),
    "end_to_end": ("poses", range(12, 21)),
    "solvers": ("poses", range(20, 29)),
    "scene": ("poses", range(12, 21)),
    "filter": ("seconds", [4.0 + i for i in range(9)]),
}
SHOWN = {
    module.__name__.rpartition(".")[2]: module.SHOWN
    for module in SECTIONS
    if hasattr(module, "SHOWN")
}
SECTION = {study: anchor for anchor, (study, _) in SHOWN.items()}
SECTION["solvers"] = "convergence"
pytestmark = pytest.mark.usefixtures("undrawn", "fitted_once")


@pytest.fixture(scope="module")
def fitted_once():
    """Fits of the curves met so far: all but one are the same in the next page."""
    known = {}

    def fitted(*curve):
        key = tuple(column.tobytes() for column in curve)
        if key not in known:
            known[key] = fitted_slope(*curve)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("simval.report.noise.fitted_slope", fitted)
        yield


def cells_of(study, rows, **axes):
    """A cell for each value of the parameter that is varied, with rows of its own."""
    key, values = VARIED[study]
    return [
        cell_of(study, scaled(rows, 1.0 + 0.01 * i), **{**axes, key: value})
        for i, value in enumerate(values)
    ]


def scaled(rows, factor):
    return [replace(row, value=row.value * factor) for row in rows]


def row(name, predictor="", prediction=1.0, value=1.0):
    return rows_by_name.row(
        name,
        value,
        standard_error=0.01,
        n=1000,
        prediction=prediction if predictor else None,
        predictor=predictor,
    )


def entries(kind, predictor, names):
    return [row(f"{kind}[{name}]", predictor) for name in names]


AXES = ("K_x", "K_y", "S_xy", "S_xz", "B_x")
CALIBRATED = [
    *entries("bias", "second order", AXES),
    *entries("sd", "first order", AXES),
    *entries("efficiency", "first order", AXES),
]
ESTIMATORS = ("weighted", "equal weights")
FORMULAS = ("order 2", "order 4, source", "order 4, complete", "exact")


def many_geometries_and_vectors():
    cells = []
    quantiles = ("least", "5%", "median", "95%", "most")
    for formula in ("order 4, source", "eq. (63), as printed"):
        rows = [row(f"leading_error_ratio[{q}]", formula) for q in quantiles]
        rows += [row("nearer", formula), row("leading_term_off", "exact")]
    cells += cells_of("attitude_geometries", rows)
    rows = [
        row(f"{name}[{part},{share},{q}]", f)
        for name in ("limit_ratio", "next_order")
        for part in ("bias", "covariance")
        for share in ("1%", "10%")
        for q in quantiles
        for f in FORMULAS[:3]
    ]
    cells += cells_of("attitude_map", rows)
    rows = [row(f"rms_over_bound[{e}]", "first order") for e in ESTIMATORS]
    rows += entries("squared_error_over_predicted", "first order", ESTIMATORS)
    rows += entries("inconsistent_rate", "chi-square", ("good", "wrong vector"))
    rows += [row("nees[weighted]", "chi-square, 3", 3.0), row("outside")]
    for ratio in (1.0, 100.0):
        for shift in (2.0, 3.0):
            cells += cells_of("attitude_vectors", rows, ratio=ratio, shift=shift)
    return cells


def made(folder):
    """A run with more series of every study than a panel takes."""
    cells = []
    for residual in ("squared", "norm", "weighted", "sampson", "adjusted"):
        for noise in (0.1, 0.2):
            rows = [row("scale_bias", "second order"), *CALIBRATED]
            cells += cells_of("ladder", rows, residual=residual, noise_std=noise)
    for noise in (0.01, 0.02):
        rows = [
            *CALIBRATED,
            *entries("rms", "first order", "TKB"),
            *entries("rms", "Cramer-Rao", "TKB"),
            row("nees", "first order", 9.0),
        ]
        cells += cells_of("calibration", rows, noise_std=noise, hold_time=0.02)
        rows = [row("norm_over_noise"), *(row("rms", f) for f in FORMULAS)]
        for i, f in enumerate(FORMULAS):
            rows += [row(f"bias[{a}]", f, 1.0 + i) for a in "xyz"]
            rows += [row(f"covariance[{a},{a}]", f, 2.0 + i) for a in "xyz"]
        cells += cells_of("attitude", rows, noise_std=noise)
    cells += cells_of("coverage", entries("coverage", "normal", AXES))
    rows = [
        row(f"{part}_order", f) for part in ("bias", "covariance") for f in FORMULAS
    ]
    rows += [row(f"bias_error[{s}]", f) for s in (0.01, 0.02) for f in FORMULAS]
    cells += cells_of("attitude_order", rows)
    rows = [row(f"limit_ratio[bias,{s}]", f) for s in ("1%", "10%") for f in FORMULAS]
    rows += [row("flip_rate", "exact"), row("other_selection_rate")]
    cells += cells_of("attitude_limits", rows)
    rows = [row("simulated_rms_ratio[TRIAD,median]"), row("wahba")]
    rows += [row("rms_ratio[TRIAD,median]", "first order")]
    cells += cells_of("attitude_efficiency", rows)
    cells += many_geometries_and_vectors()
    rows = [row("precision"), row("recall"), row("impure"), row("outside")]
    for multiplier in (3.0, 6.0):
        cells += cells_of("detector", rows, multiplier=multiplier)
    cells += cells_of(
        "end_to_end", [row("budget[noise]", "first order"), row("impure")]
    )
    rows = entries("variance_over_bound", "Cramer-Rao", ("M", "b"))
    cells += cells_of("magnetometer", [*rows, *entries("sd", "first order", AXES)])
    rates = ("500 Hz", "250 Hz", "100 Hz", "50 Hz")
    rows = [row(f"recovery[M,straight lines,{rate}]") for rate in rates]
    rows += [row(f"recovery[M,averages,{rate}]") for rate in rates]
    cells += cells_of("gyroscope", [*rows, row("sd[M,bound]")])
    cells += cells_of("solvers", [row("steps[lm]"), row("apart[lm]", "lm")])
    rows = [
        row("rms", "Cramer-Rao"),
        row("rms[heading]"),
        row("rms_over_bound"),
        row("nees", "chi-square"),
    ]
    rows += [row("nis", "chi-square"), row("settling"), row("settling_trials")]
    rows += [row("diverged"), row("worst_instant[attitude]", "chi-square")]
    for t in (1, 2):
        rows += entries("budget_at", "", (f"start,{t}", f"gyroscope walk,{t}"))
        for family in ("rms_at", "bound_at", "nees_at"):
            rows.append(row(f"{family}[attitude,{t}]"))
    cells += cells_of("filter", rows)
    cells += cells_of("scene", [row("condition"), row("rests")], scene="die")
    return Run(folder=folder, cells=tuple(cells), manifest=MANIFEST, timing={})


def content(section):
    """All that a section shows, as words: figures, tables and what is named."""
    panels = [repr(_plain(p)) for d in section.drawings for p in d.panels]
    return panels, [repr(table.rows) for table in section.tables]


def _plain(panel):
    if isinstance(panel, Panel | DotPanel):
        return [(s.label, s.x.tolist(), s.y.tolist()) for s in panel.series]
    if isinstance(panel, BarPanel):
        return list(panel.names), panel.measured.tolist(), panel.predicted.tolist()
    return panel.directions.tolist()


def changed(run, wanted):
    """The run with other numbers in the rows that are wanted."""

    def other(r):
        moved = None if r.prediction is None else 3.0 * r.prediction + 0.5
        return replace(r, value=2.0 * r.value + 0.5, prediction=moved)

    return replace(
        run,
        cells=tuple(
            replace(c, rows=tuple(other(r) if wanted(c, r) else r for r in c.rows))
            for c in run.cells
        ),
    )


def shown(anchor, run, judged):
    """One section of the page, without the others."""
    titles = dict.fromkeys(STUDIES, "")
    module = importlib.import_module(f"simval.report.sections.{anchor}")
    return module.section(Context(run=run, judged=judged, titles=titles))


def of_study(run, study):
    return replace(run, cells=tuple(c for c in run.cells if c.study == study))


def spelled(key, value):
    """A parameter as a figure names it."""
    if isinstance(value, float):
        return f"{value:g}"
    return f"{value} poses" if key == "poses" else str(value)


@pytest.mark.parametrize("study", VARIED)
def test_every_series_is_drawn_or_named(study, tmp_path):
    """Other numbers in one series: its figures change, or their captions name it."""
    key, values = VARIED[study]
    anchor = SECTION[study]
    run = of_study(made(tmp_path), study)
    judged = judge_run(run)
    before = shown(anchor, run, judged)
    named = " ".join(name for d in before.drawings for name in d.left_out)
    for value in (values[0], values[-1]):  # drawn, and where there are many left out
        now = shown(
            anchor,
            changed(run, lambda c, r, v=value: c.parameters[key] == v),
            judged,
        )
        (old, listed), (new, relisted) = content(before), content(now)
        spellings = (spelled(key, value), f"{key}={value}")
        drawn = old != new or not old  # some figures need artifacts
        assert drawn or any(words in named for words in spellings), value
        assert listed != relisted or not listed, value


@pytest.mark.ci
@pytest.mark.parametrize("anchor", SHOWN)
def test_every_statistic_is_shown_or_named(anchor, tmp_path):
    """Other numbers in one statistic: its section changes, or says where it is."""
    study, _ = SHOWN[anchor]
    key, values = VARIED[study]
    run = of_study(made(tmp_path), study)
    few = [c for c in run.cells if c.parameters[key] in values[:2]]
    run = replace(run, cells=tuple(few))
    judged = judge_run(run)
    before = shown(anchor, run, judged)
    (told,) = (s.elsewhere for s in sections(run) if s.anchor == anchor)
    for name in sorted({str(r.statistic) for c in run.cells for r in c.rows}):
        now = shown(
            anchor, changed(run, lambda c, r, n=name: str(r.statistic) == n), judged
        )
        said = name in told or name.partition("[")[0] in told
        assert (content(before) != content(now)) != said, name


@pytest.mark.ci
def test_what_is_left_out_stands_on_the_page(tmp_path):
    page = render(made(tmp_path))
    (ladder,) = (s for s in sections(made(tmp_path)) if s.anchor == "ladder")
    assert ladder.drawings[0].left_out
    for name in ladder.drawings[0].left_out:
        assert name in page
    assert re.search(r"Measured too, and only in .*: .*\bsd\b", page)


def test_every_panel_of_a_statistic_is_full_or_split(tmp_path):
    """Ten groups of a study are two panels of five, none of them dropped."""
    run = made(tmp_path)
    kept = tuple(c for c in run.cells if c.parameters.get("poses", 20) in (20, 21))
    run = replace(run, cells=tuple(c for c in kept if c.study == "ladder"))
    context = Context(run=run, judged=judge_run(run), titles={"ladder": "ladder"})
    (drawing,) = statistics.section(context).drawings
    points = [[s for s in p.series if not s.line] for p in drawing.panels]
    assert [len(series) for series in points] == [5, 5]
    assert not drawing.left_out


@pytest.mark.ci
def test_no_study_is_on_the_page_twice(tmp_path):
    run = made(tmp_path)
    found = {s.anchor: s for s in sections(run)}
    assert [t.name for t in found["convergence"].tables] == ["study-solvers"]
    assert convergence.section  # where the solvers are, and nowhere else
    page = render(run)
    assert page.count('id="table-study-solvers"') == 1
    assert "other" not in found  # nothing is left for it
    names = [table.name for table in tables(run)]
    assert len(names) == len(set(names))
    figures = [drawing.name for drawing in drawings(run)]
    assert len(figures) == len(set(figures))


@pytest.mark.ci
def test_a_formula_has_one_colour_on_all_figures(tmp_path):
    named = attitude.FORMULAS
    colours = {named.get(n, n): c for n, (c, _) in attitude.STYLES.items()}
    seen = set()
    for drawing in drawings(made(tmp_path)):
        for panel in drawing.panels:
            labels = getattr(panel, "series", ())
            for series in (s for s in labels if s.label in colours):
                assert series.colour == colours[series.label], drawing.name
                seen.add(series.label)
    assert seen == set(colours)


def test_the_titles_of_further_studies_are_sentences_of_their_own(tiny_run):
    run = load_run(tiny_run)
    cells = [replace(run.cells[0], study=study) for study in ("asked", "said")]
    context = Context(
        run=replace(run, cells=tuple(cells)),
        judged=judge_run(run),
        titles={"asked": "Is it right?", "said": "Sampling: streams"},
    )
    assert other.section(context).values["found"] == "Is it right? Sampling: streams."
