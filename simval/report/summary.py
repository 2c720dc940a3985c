"""First screen: the verdict with its number, key numbers, figures, why it fails.

**Key numbers** are those that the studies name in their headlines, each in one chosen
cell: that of the middle noise level (of two middle ones the smaller) and the most
poses, and of the algorithm that the suite names first; of several such cells the one
with the greatest error. Noise-free cells have no error to tell.

A run that fails opens with the reason (`failing`).

A suite with a question varies parameters of one study besides noise and effort. Then
the figure over the one that says most is on the first screen, a curve for each value of
the others: "how many poses do I need, and how long?" Where a run has a user's code, its
algorithms come next and the figures after them.
"""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from itertools import islice
from typing import NamedTuple

import numpy as np

from simval.change import EFFORT
from simval.figures import Figure, Headline, Quote
from simval.judge import needs
from simval.judge.algorithms import STUDIES as OF_ALGORITHMS
from simval.judge.gate import outcome
from simval.judge.needs import distance, headline_rows, replies_to
from simval.judge.result_lines import gate_account
from simval.judge.runs import origin_of
from simval.judge.settings import setting_words, varying
from simval.report.algorithms import has_user_code, lines_of_algorithms
from simval.report.answers import (
    Number,
    changes,
    in_order,
    number_of,
    number_of_row,
    relative,
)
from simval.report.checks import FIRST, failing_figures
from simval.report.comparison import moves_table
from simval.report.curves import PREFERRED, numeric, spans
from simval.report.failing import FAILING, failing_table, reason
from simval.report.formatting import angle_unit, begun, spelled
from simval.report.gallery import drawn
from simval.report.log_page import tables_of
from simval.report.panels import Drawing, Panel
from simval.report.section import Context, Section, made
from simval.report.study_sections import shown_of
from simval.report.table import Column
from simval.results import Row
from simval.spelling import counted, rounded, whole
from simval.statistics import Family
from simval.studies import STUDIES
from simval.sweep.run import CellResult
from simval.units import COUNT

# ---- what a cell says


class Reading(NamedTuple):
    """What a cell says, and how its error ranks among the cells of its study."""

    said: str
    numbers: Sequence[Number]
    ratio: Number  # what stands for all of them: over the bound, or over theory
    size: float
    n: int


def of_headline(headline: Headline, cell: CellResult) -> Reading | None:
    """What a cell says by its study's headline; None if a row is missing."""
    rows = {name: cell.row(q.of, q.by) for name, q in headline.quotes.items()}
    found = {name: row for name, row in rows.items() if row is not None}
    numbers = {
        name: number
        for name, q in headline.quotes.items()
        if name in found
        and (number := _quoted(name, q, cell.study, found[name])) is not None
    }
    if len(numbers) < len(rows):
        return None
    first = found[next(iter(rows))]
    ratio = numbers.pop("over", None)
    if ratio is not None:
        ratio = ratio._replace(unit=headline.says.partition("{over} ")[2])
    shown = list(numbers.values()) or [ratio] if ratio else list(numbers.values())
    said = headline.says.format(
        over=ratio.said.removesuffix(f" {ratio.unit}") if ratio else "",
        **{name: number.said for name, number in numbers.items()},
    )
    return Reading(said, shown, ratio or shown[0], first.value, first.n)


def _quoted(name: str, quote: Quote, study: str, row: Row) -> Number | None:
    """A number of a headline; None if its row is missing."""
    over, predicted = name == "over", row.prediction
    value, error = quote.times * row.value, quote.times * row.standard_error
    if quote.over:
        value, error = (x / predicted if predicted else np.nan for x in (value, error))
    if not np.isfinite([value, error]).all() or (over and not value > 0.0):
        return None
    if quote.root:
        value, error = float(np.sqrt(value)), error / 2.0 / float(np.sqrt(value))
    label = begun(spelled(study)) + {"over": ", error", "angle": ""}.get(
        name, f" {name}"
    )
    unit = angle_unit(value) if quote.angle else quote.unit or COUNT
    beside = "" if over else relative(row, quote.times * unit.factor)
    value, error = unit.factor * value, unit.factor * error
    return number_of(label, value, error, unit.name, beside)


def any_reading(cell: CellResult) -> Reading | None:
    """What a cell says if its study has no headline."""
    rows = headline_rows(cell)[:MOST]
    if not rows:
        return None
    study, what = begun(spelled(cell.study)), [row.statistic.words for row in rows]
    numbers = [
        number_of_row(f"{study}, {words}", row)
        for words, row in zip(what, rows, strict=True)
    ]
    first = numbers[0]
    said = "; ".join(filter(None, (f"{what[0]} {first.said}", first.beside)))
    return Reading(said, numbers, first, distance(rows[0]), rows[0].n)


# ---- the cell that is told

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


def chosen(
    study: str, cells: Sequence[CellResult]
) -> tuple[CellResult, Reading] | None:
    """The cell that stands for a study, and what it says."""
    own = STUDIES[study].headline if study in STUDIES else None
    readings = [
        (cell, reading)
        for cell in typical(cells)
        if (reading := (own and of_headline(own, cell)) or any_reading(cell))
        is not None
    ]
    return max(readings, key=lambda pair: pair[1].size, default=None)


def typical(cells: Sequence[CellResult], *, poses: bool = True) -> Sequence[CellResult]:
    """Cells of medium noise, with the first algorithm and, if asked, the most poses."""
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
    """Words that identify a cell within its study."""
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
    """Parameters that the run's question is about, the figure's axis first."""
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
    """Plot the error along the parameters that the suite asks about."""
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
    """The statistic that stands for a study."""
    row = next((row for cell in cells for row in headline_rows(cell)), None)
    if row is None:
        return None
    what = row.statistic.words
    return Figure(
        name="", rows=[row.statistic], by=row.predictor, value=what,
        caption=f"{what[:1].upper()}{what[1:]}.",
    )  # fmt: skip


def _subject(figure: Figure) -> str:
    """Name of what is better when it is less, such as an error."""
    row = figure.rows[0]
    family = row if isinstance(row, Family) else row.family
    return "error" if family.better in ("less", "zero") else family.words


def _ends(panel: Panel, value: str) -> str:
    """Say from where to where the first and the last line of a panel go."""
    unit = panel.y_label.removeprefix(value).lstrip(", ")
    measured = [series for series in panel.series if not series.line]
    lines = dict.fromkeys((measured[0], measured[-1]))
    return ", ".join(
        f"{panel.title} from {rounded(s.y[0])} to {rounded(s.y[-1])} {unit}".rstrip()
        + f" ({s.label})" * (len(lines) > 1)
        for s in lines
    )


# ---- key numbers

MOST = 5
"""Key numbers of a page."""
OF_FIRST = 3
"""Of them those of the most important study, where there are others."""


def readings(context: Context) -> dict[str, tuple[CellResult, Reading]]:
    """What each study says, by the cell that stands for it."""
    studies = in_order([cell.study for cell in context.run.cells])
    found = {study: chosen(study, context.cells(study)) for study in studies}
    return {study: each for study, each in found.items() if each is not None}


def key_numbers(
    context: Context, told: Mapping[str, tuple[CellResult, Reading]]
) -> tuple[list[Number], list[str]]:
    """Three to five numbers, and the settings in which they were measured."""
    algorithms = lines_of_algorithms(context)
    own = [line.keys for line in algorithms if line.keys]
    pools = [[*keys] for keys in own]
    for study, (cell, reading) in told.items():
        if study not in OF_ALGORITHMS or not algorithms:
            place = where(cell, context.cells(study), reading.n)
            numbers = dict.fromkeys((*reading.numbers, reading.ratio))
            setting = f"{begun(spelled(study))}: {place}"
            pools.append([(number, setting) for number in numbers])
    if not pools:
        return [], []
    first, *rest = pools
    many = max(1, min(OF_FIRST, MOST + 1 - len(own))) if rest else MOST
    found = [*first[:many], *(pool[0] for pool in rest)]
    left = [*first[many:], *(each for pool in rest for each in pool[1:])]
    found = [*found, *left[: max(0, OF_FIRST - len(found))]][:MOST]
    return [number for number, _ in found], list(dict.fromkeys(x for _, x in found))


# ---- section

EXPLAINED = {
    "T ": "T, K and B: misalignment of the axes, scale factors and bias of an "
    "accelerometer.",
    "the bound": "The bound: the least error that any unbiased method can have with "
    "these data (Cramér and Rao).",
    "theory": "Theory: what was predicted before anything was simulated.",
}
"""What the first screen uses without a word, by what stands in its numbers."""


def summary_section(context: Context) -> Section | None:
    """Make the first screen."""
    judged = context.judged
    told = readings(context)
    numbers, settings = key_numbers(context, told)
    used = " ".join(f"{each.label} {each.unit} {each.beside}" for each in numbers)
    first, _, rest = outcome(judged).partition("; ")
    due = reason(context)
    found = changes(context)
    table = failing_table(context)
    moves = [
        replace(moves_table(change.moves, {}), name=f"changed{i}", shown=FAILING)
        for i, change in enumerate(found)
        if change.moves
    ]
    sampled = sum(v.p_value is not None and not v.wide for v in judged.verdicts)
    total = judged.counts.total()
    return made(
        first_figures(context),
        [*([table] if table else []), *moves],
        asked=replies_to(judged.asked),
        answers=[
            replace(table, columns=(Column("setting"), *table.columns[1:]))
            for each in needs.tables_of(judged.asked)
            for table in islice(tables_of(each), 1)  # without every digit
        ],
        answer=judged.answer,
        headline=due.said if due else f"{begun(first)}.",
        notes=[
            f"{begun(outcome(judged) if due else rest)}." if due or rest else "",
            context.part.said if context.part else "",
            "" if due else gate_account(judged).replies[0].do,
        ],
        reason=due,
        numbers=numbers,
        settings=settings,
        explained=[words for key, words in EXPLAINED.items() if key in f"{used} "],
        changes=found,
        report=f"simval report {shlex.quote(context.folder)}",
        rate=_rate(sampled, total, context.alpha),
    )


def _rate(sampled: int, total: int, alpha: float) -> str:
    """Say which checks share the false-alarm rate."""
    if not total:
        return ""
    rate = f"the false-alarm rate of {alpha:g} for all together"
    if not sampled:
        return "No check has to do with chance."
    if sampled == total:
        return f"All checks rest on random samples and share {rate}."
    return (
        f"{whole(sampled)} of the checks rest on random samples and share {rate}; the "
        "others are deterministic."
    )


def source_line(context: Context) -> list[str]:
    """Say where a page comes from: suite, date, size and seeds."""
    run, part, origin = context.run, context.part, origin_of(context.run)
    seeds = [str(seed) for seed in run.manifest["grid"]["seed"]]
    trials = sum(map(_samples, run.cells))
    shown = " in those shown" if part and part.said else ""
    found = [f"{run.manifest['suite']} suite"]
    if origin.started:
        day = datetime.fromisoformat(origin.started)
        found.append(f"{day.day} {day:%B %Y, %H:%M}")
    found += [
        counted(run.manifest["cells"], "cell"),
        f"{counted(trials, 'trial')}{shown}",
        f"seed {', '.join(seeds)}" if len(seeds) < FAILING else f"{len(seeds)} seeds",
    ]
    if context.against is not None:
        found.append(f"against {context.against.run.folder.name}")
    return found


def _samples(cell: CellResult) -> int:
    """Number of trials of a cell."""
    stated = [cell.parameters.get(key) for key in ("trials", "samples")]
    most = max((row.n for row in cell.rows), default=0)
    return next((n for n in stated if isinstance(n, int)), most) if most else 0


def figures(context: Context) -> list[Drawing]:
    """The most important figures of the package's own algorithms."""
    asked = question_figure(context)
    # a noise axis with one level is no figure beside it
    return shown_of(context, "summary")[0] if asked is None else [asked]


def first_figures(context: Context) -> list[Drawing]:
    """Figures of the first screen: of what fails, else of built-in algorithms."""
    return failing_figures(context)[:FIRST] or (
        [] if has_user_code(context.run) else figures(context)
    )


def overview_section(context: Context) -> Section | None:
    """The package's own figures, if others are on the first screen."""
    drawings = figures(context)
    names = {drawing.name for drawing in first_figures(context)}
    if not drawings or names & {drawing.name for drawing in drawings}:
        return None
    return made(drawings)
