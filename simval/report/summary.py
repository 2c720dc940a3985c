"""The first screen: the verdict in one line, three answers, and the two figures.

**How wrong** takes for each study the size of its errors in one chosen cell: that of
the middle noise level (of two middle ones the smaller) and the most poses, and of the
algorithm that the suite names first; of several such cells the one with the greatest
error. Noise-free cells have no error to tell. The other two answers are in `answers`.

A suite with a question varies parameters of one study besides noise and effort. Then
the figure over the one that says most is on the first screen, a curve for each value of
the others: "how many poses do I need, and how long?" Where a run has a user's code, its
algorithms come next and the figures after them.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from simval.change import EFFORT
from simval.figures import Figure, Headline, Quote
from simval.judge import headline
from simval.judge.algorithms import STUDIES as OF_ALGORITHMS
from simval.judge.findings import reproduce
from simval.report.algorithms import has_user_code, lines_of_algorithms
from simval.report.answers import (
    SHOWN,
    Block,
    Line,
    as_theory_says,
    in_order,
    worse_than_before,
)
from simval.report.curves import PREFERRED, numeric, spans, varying
from simval.report.formatting import angle, begun, in_unit, setting_words, spelled
from simval.report.gallery import drawn
from simval.report.panels import Drawing, Panel
from simval.report.section import Context, Section, home, made
from simval.report.study_sections import shown_of
from simval.results import Row
from simval.spelling import measured, rounded
from simval.statistics import (
    APART,
    COVARIANCE_ORDER,
    COVERAGE,
    LEADING_ERROR_RATIO,
    LIMIT_RATIO,
    REST_FORCE,
    RMS,
    RMS_OVER_BOUND,
    RMS_RATIO,
    SCALE_BIAS,
    SQUARED_ERROR,
    VARIANCE_OVER_BOUND,
    Family,
)
from simval.studies import STUDIES
from simval.sweep.run import CellResult

# ---- what a cell says


class Reading(NamedTuple):
    """The message of a cell, and the rank of its error among the cells of its study."""

    said: str
    size: float
    n: int


def of_headline(headline: Headline, cell: CellResult) -> Reading | None:
    """What a cell says by the headline of its study; None without all of its rows."""
    rows = {name: cell.row(q.of, q.by) for name, q in headline.quotes.items()}
    found = {name: row for name, row in rows.items() if row is not None}
    said = {name: _quoted(q, rows[name]) for name, q in headline.quotes.items()}
    if "" in said.values():
        return None
    first = found[next(iter(headline.quotes))]
    return Reading(headline.says.format(**said), first.value, first.n)


def _quoted(quote: Quote, row: Row | None) -> str:
    """The number in words; empty without one."""
    numbers = () if row is None else (row.value, row.standard_error)
    if row is None or not np.isfinite(numbers).all():
        return ""
    if quote.angle:
        return angle(quote.times * row.value)
    if quote.unit is not None:
        return in_unit(row.value, quote.unit, quote.digits)
    if quote.over and row.prediction is not None and row.prediction > 0.0:
        return _ratio(row)
    if not row.value > 0.0 or quote.over:
        return ""
    root = float(np.sqrt(row.value))
    if quote.root:
        return measured(root, row.standard_error / 2.0 / root)
    return measured(*numbers)


ANY = (
    RMS,
    RMS_OVER_BOUND,
    RMS_RATIO,
    COVERAGE,
    SCALE_BIAS,
    SQUARED_ERROR,
    VARIANCE_OVER_BOUND,
    LIMIT_RATIO,
    COVARIANCE_ORDER,
    LEADING_ERROR_RATIO,
    REST_FORCE,
    APART,
)
"""Statistics that represent a study without a headline: the first that it has."""


def any_reading(cell: CellResult) -> Reading | None:
    """Reading of a cell whose study has no headline."""
    row = headline_row(cell)
    return None if row is None else Reading(_told(row), _distance(row), row.n)


def headline_row(cell: CellResult) -> Row | None:
    """The statistic that says most, its entry farthest from what was predicted."""
    finite = [row for row in cell.rows if np.isfinite(row.value)]
    for family in (*ANY, *dict.fromkeys(row.statistic.family for row in finite)):
        rows = [row for row in finite if row.statistic.family == family]
        judged = [row for row in rows if row.check != "record"]
        if rows:
            return max(judged or rows, key=_distance)
    return None


def _told(row: Row) -> str:
    unit = "" if row.unit == "1" else f" {row.unit}"
    who = f" ({', '.join(row.statistic.entries)})" if row.statistic.entries else ""
    said = f"{row.statistic.family.words} {_value(row)}{unit}{who}"
    if row.check == "limit" or row.prediction is None:
        return said
    return f"{said}; {rounded(row.prediction, 3)} predicted"


def _value(row: Row) -> str:
    sampled = row.standard_error > 0.0
    exact = partial(rounded, digits=3)
    return measured(row.value, row.standard_error) if sampled else exact(row.shown)


def _distance(row: Row) -> float:
    """How far a value is from its prediction, or from nothing."""
    if row.prediction is None or not np.isfinite(row.prediction):
        return abs(row.value)
    return abs(row.value - row.prediction) / (abs(row.prediction) or 1.0)


def _ratio(row: Row) -> str:
    by = row.prediction or 1.0
    return measured(row.value / by, row.standard_error / by)


# ---- how wrong

NOISES = (
    "noise_std",
    "accelerometer_noise_std",
    "accelerometer_noise",
    "magnetometer_noise_std",
    "field_noise",
    "angle_random_walk",
)
"""Parameters that say how noisy a sensor is."""

MIDDLE = (*NOISES, "multiplier")
"""Parameters of which the middle value is chosen: noise, and a detector's threshold."""

ALGORITHM = ("estimator", "residual", "estimate", "sigma", "trim")
"""Parameters that choose an algorithm or set it, not what it is given."""

RULE = (
    "Each number is of the cell with its study's middle noise level, most poses and "
    "first algorithm; of several such cells, the one with the greatest error. "
    "\N{PLUS-MINUS SIGN}: standard error."
)


def how_wrong(context: Context) -> Block:
    """Answer how great the errors are."""
    lines = lines_of_algorithms(context)
    told = {line.what for line in lines}
    for study in in_order([cell.study for cell in context.run.cells]):
        if study in OF_ALGORITHMS and told:
            continue
        lines.append(_line(context, study))
    return Block(
        title="How wrong",
        answer="pass",
        headline="",
        lines=lines,
        note=RULE,
        fold="more algorithms" if len(told) > SHOWN else "more studies",
    )


def _line(context: Context, study: str) -> Line:
    cells = context.cells(study)
    found = chosen(study, cells)
    if found is None:
        left = [cell for cell in context.run.cells if cell.study == study]
        endings = dict.fromkeys(cell.ending for cell in left if cell not in cells)
        ended = {"pending": "never run", "done": "without numbers"}
        why = ", ".join(ended.get(word, word) for word in endings)
        said = f"not measured{f': {why}' if why else ''}"
        return Line(what=begun(spelled(study)), said=said, answer="inconclusive")
    cell, reading = found
    return Line(
        what=begun(spelled(study)),
        said=reading.said,
        where=where(cell, cells, reading.n),
        link=home(study),
        command=reproduce(cell.named, context.folder),
    )


def chosen(
    study: str, cells: Sequence[CellResult]
) -> tuple[CellResult, Reading] | None:
    """The cell that represents a study, and its message."""
    own = STUDIES[study].headline if study in STUDIES else None
    readings = [
        (cell, reading)
        for cell in typical(cells)
        if (reading := (own and of_headline(own, cell)) or any_reading(cell))
        is not None
    ]
    return max(readings, key=lambda pair: pair[1].size, default=None)


def typical(cells: Sequence[CellResult], *, poses: bool = True) -> Sequence[CellResult]:
    """Cells of the middle noise, the first algorithm and, if asked, the most poses."""
    for key in MIDDLE:
        levels = sorted({v for cell in cells if (v := cell.parameters.get(key))})
        if levels:
            middle = levels[(len(levels) - 1) // 2]
            cells = [cell for cell in cells if cell.parameters.get(key) == middle]
    for key in ALGORITHM:
        names = [cell.parameters.get(key) for cell in cells]
        cells = [c for c, own in zip(cells, names, strict=True) if own == names[0]]
    if not poses:
        return cells
    most = max((cell.parameters.get("poses", 0) for cell in cells), default=0)
    return [cell for cell in cells if cell.parameters.get("poses", 0) == most]


def where(cell: CellResult, cells: Sequence[CellResult], n: int) -> str:
    """Text that identifies a cell in its study."""
    values = cell.parameters
    skipped = ("samples", "trials")
    shown = [key for key in (*NOISES, "poses") if values.get(key)]
    shown += [key for key in varying(cells) if key not in (*NOISES, "poses", *skipped)]
    words = [setting_words(cell.study, key, values.get(key)) for key in shown]
    return ", ".join([*words, f"{n:,} trials"] if n > 1 else words)


# ---- a suite with a question

AXES = {"poses": "number of poses"}
"""Words of a parameter where its name is not enough."""
LITTLE = 3.0
"""Least factor of the values on a logarithmic axis of the only figure."""


def axes_of_question(cells: Sequence[CellResult]) -> tuple[str, ...]:
    """Parameters that a run is about, that of the figure's axis first; none if none."""
    if len({cell.study for cell in cells}) != 1:
        return ()
    keys = [key for key in varying(cells) if key not in (*EFFORT, *NOISES)]
    counts = {
        key: len({cell.parameters.get(key) for cell in cells})
        for key in keys
        if all(numeric(cell.parameters.get(key)) is not None for cell in cells)
    }
    if not counts:
        return ()
    axis = max(counts, key=lambda key: (key in PREFERRED, counts[key]))
    return axis, *(key for key in keys if key != axis)


def question_figure(context: Context) -> Drawing | None:
    """The error over the parameters that the suite asks about."""
    axes = axes_of_question(context.run.cells)
    cells: Sequence[CellResult] = [cell for cell in context.run.cells if cell.rows]
    if not axes or not cells:
        return None
    left_out: list[str] = []
    figure = _of_any(cells)
    if cells[0].study == "calibration":  # each part in its unit, at the middle noise
        noises = {cell.parameters["noise_std"] for cell in cells}
        cells = typical(cells, poses=False)
        noises.remove(here := cells[0].parameters["noise_std"])
        left_out = [f"noise {level:g} m/s²" for level in sorted(noises)]
        figure = replace(
            next(f for f in STUDIES["calibration"].shown if isinstance(f, Figure)),
            what="",
            value="RMS error",
            slope=None,
            caption=f"RMS error of T, K and B at a noise of {here:g} m/s².",
        )
    if figure is None:
        return None
    axis = AXES.get(axes[0], spelled(axes[0]))
    figure = replace(
        figure,
        name="summary-question",
        along=axes[0],
        axis=axis,
        ratio=False,
        several=True,
    )
    drawing = next(iter(drawn(figure, cells)), None)
    if drawing is None:
        return None
    panels = [panel for panel in drawing.panels if isinstance(panel, Panel)]
    names = " and the ".join(AXES.get(each, spelled(each)) for each in axes)
    x = panels[0].series[0].x
    ends = ", ".join(_ends(panel, figure.value) for panel in panels)
    return replace(
        drawing,
        asked=f"How does the {_subject(figure)} depend on the {names}?",
        finding=f"From {x[0]:g} to {x[-1]:g}: {ends}.",
        panels=[
            replace(
                panel,
                log_x=spans(LITTLE, [s.x for s in panel.series]),
                log_y=spans(LITTLE, [s.y for s in panel.series]),
            )
            for panel in panels
        ],
        left_out=[*left_out, *drawing.left_out],
    )


def _of_any(cells: Sequence[CellResult]) -> Figure | None:
    """The statistic that represents a study."""
    row = next((row for cell in cells if (row := headline_row(cell))), None)
    if row is None:
        return None
    entries = row.statistic.entries
    what = row.statistic.family.words + (f" ({', '.join(entries)})" if entries else "")
    return Figure(
        name="", rows=[row.statistic], by=row.predictor, value=what,
        caption=f"{what[:1].upper()}{what[1:]}.",
    )  # fmt: skip


def _subject(figure: Figure) -> str:
    """What the question is about: an error, or whatever is no better if it is less."""
    row = figure.rows[0]
    family = row if isinstance(row, Family) else row.family
    return "error" if family.better in ("less", "zero") else family.words


def _ends(panel: Panel, value: str) -> str:
    """From where to where the first and the last line of a panel go."""
    unit = panel.y_label.removeprefix(value).lstrip(", ")
    measured = [series for series in panel.series if not series.line]
    lines = dict.fromkeys((measured[0], measured[-1]))
    return ", ".join(
        f"{panel.title} from {rounded(s.y[0])} to {rounded(s.y[-1])} {unit}".rstrip()
        + f" ({s.label})" * (len(lines) > 1)
        for s in lines
    )


# ---- section

EXPLAINED = {
    "T ": "T, K and B: misalignment of the axes, scale factors and bias of an "
    "accelerometer.",
    "the bound": "The bound: the least error that any unbiased method can have with "
    "these data (Cramér and Rao).",
    "theory": "Theory: what was predicted before anything was simulated.",
}
"""What the first screen uses without a word, by what stands in its lines."""


def summary_section(context: Context) -> Section | None:
    """Make the section."""
    run = context.run
    part = context.part
    studies = dict(part.counts) if part else {}
    if not studies:
        for cell in run.cells:
            studies[cell.study] = studies.get(cell.study, 0) + 1
    wrong = how_wrong(context)
    used = " ".join(line.said for line in wrong.first)
    return made(
        () if has_user_code(run) else figures(context),
        explained=[words for key, words in EXPLAINED.items() if key in used],
        answers=(
            wrong,
            as_theory_says(context),
            worse_than_before(context),
        ),
        answer=context.judged.answer,
        headline=headline(context.judged),
        sampled=sum(
            v.p_value is not None and not v.wide for v in context.judged.verdicts
        ),
        part=part.said if part else "",
        judged=context.judged.counts.total(),
        alpha=context.alpha,
        manifest=run.manifest,
        studies=studies,
        samples=sum(map(_samples, run.cells)),
    )


def _samples(cell: CellResult) -> int:
    """Trials of a cell; each may draw many numbers, which rows of noise count."""
    stated = [cell.parameters.get(key) for key in ("trials", "samples")]
    most = max((row.n for row in cell.rows), default=0)
    return next((n for n in stated if isinstance(n, int)), most) if most else 0


def figures(context: Context) -> list[Drawing]:
    """The figures that say most of the package's own algorithms."""
    asked = question_figure(context)
    # a noise axis with one level is no figure beside it
    return shown_of(context, "summary")[0] if asked is None else [asked]


def overview_section(context: Context) -> Section | None:
    """The two figures of the first screen, where a user's algorithms are there."""
    drawings = figures(context) if has_user_code(context.run) else []
    if not drawings:
        return None
    return made(drawings)
