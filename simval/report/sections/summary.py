"""The first screen: the verdict in one line, three answers, and the two figures.

The answers: how wrong the algorithms are, whether that is as theory says, and whether
it is worse than before.

Where a run has a user's code, its algorithms come next and the figures after them
(`overview`).
"""

from collections.abc import Sequence
from functools import partial

from simval.judge import headline
from simval.report.answers_before import worse_than_before
from simval.report.answers_theory import as_theory_says
from simval.report.answers_wrong import chosen, how_wrong
from simval.report.curves import (
    Groups,
    bar_width,
    curve,
    grouped,
    statistic,
)
from simval.report.findings import claiming
from simval.report.measures import GROUPS, moment
from simval.report.panels import Drawing, Panel, Series
from simval.report.question import question_figure
from simval.report.section import Context, Section, made
from simval.report.sections import attitude, calibration
from simval.report.sections.algorithms import has_user_code
from simval.report.sections.attitude import NOISE, beside_predictions, remainders
from simval.report.units import DEGREE_OF_QUATERNION, OF_A_CALIBRATION
from simval.statistics import COVARIANCE, CRAMER_RAO, EXACT, FIRST_ORDER, RMS
from simval.sweep.run import CellResult

EXPLAINED = {
    "T ": "T, K and B: misalignment of the axes, scale factors and bias of an "
    "accelerometer.",
    "the bound": "The bound: the least error that any unbiased method can have with "
    "these data (Cramér and Rao).",
    "theory": "Theory: what was predicted before anything was simulated.",
}
"""What the first screen uses without a word, by what stands in its lines."""

RIGHT_OF_IT = (
    " Right: how far the covariance of each is from exact, on a scale that shows the "
    "differences."
)


def section(context: Context) -> Section | None:
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
        "summary",
        "Verdict",
        () if has_user_code(run) else figures(context),
        explained=[words for key, words in EXPLAINED.items() if key in used],
        answers=(
            wrong,
            as_theory_says(context),
            worse_than_before(context),
        ),
        answer=context.judged.answer,
        headline=headline(context.judged),
        sampled=sum(v.p_value is not None for v in context.judged.verdicts),
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
    """The two figures that say most of the package's own algorithms."""
    asked = question_figure(context)
    drawings = [asked, calibration_figure(context), attitude_figure(context)]
    if asked is not None:  # a noise axis with one level is no figure beside it
        drawings = [asked]
    return [drawing for drawing in drawings if drawing is not None]


def calibration_figure(context: Context) -> Drawing | None:
    """Calibration error against noise with the Cramer-Rao bound."""
    cells = [
        cell
        for cell in context.cells("calibration")
        if cell.parameters["noise_std"] > 0.0
    ]
    if not cells:
        return None
    label, members = _longest("calibration", grouped(cells, "noise_std"))
    measured, bounds = (
        [curve("", members, "noise_std", statistic(RMS(name), by)) for name in GROUPS]
        for by in (FIRST_ORDER, CRAMER_RAO)
    )
    z = bar_width(measured)
    series: list[Series] = []
    for i, (name, c, bound) in enumerate(zip(GROUPS, measured, bounds, strict=True)):
        unit = OF_A_CALIBRATION[name]
        if c is not None:
            c = c.scaled(unit)
            series += [c.points(z, i, f"{GROUPS[name]}, {unit.name}"), c.predicted()]
        if bound is not None:
            series.append(bound.scaled(unit).predicted(":"))
    if not series:
        return None
    drawing = Drawing(
        name="summary-calibration",
        caption=(
            f"Calibration error against noise{f' ({label})' if label else ''}. Points: "
            "simulation with bars that hold for all together (95 %). Solid: theory; "
            "dotted: Cramér-Rao bound."
        ),
        alternative=(
            "RMS error of misalignment, scale and bias against the noise per sample, "
            "simulated points beside theory and the Cramér-Rao bound"
        ),
        panels=[
            Panel(
                title="calibration",
                x_label="noise per sample, m/s²",
                y_label="RMS error",
                series=tuple(series),
            )
        ],
    )
    return claiming(drawing, calibration.rms_claim(cells))


def attitude_figure(context: Context) -> Drawing | None:
    """Attitude error against noise with all predictions, and what each leaves out."""
    cells = context.cells("attitude")
    if not cells:
        return None
    label, members = _longest("attitude", grouped(cells, "noise_std"))
    measured = curve("", members, "noise_std", statistic(RMS(), EXACT))
    if measured is None:
        return None
    panels = [
        Panel(
            title="attitude",
            x_label=NOISE,
            y_label="RMS error, degrees",
            series=tuple(
                beside_predictions(
                    members, partial(statistic, RMS()), unit=DEGREE_OF_QUATERNION
                )
            ),
        )
    ]
    if curve("", members, "noise_std", moment(COVARIANCE, EXACT)) is not None:
        panels += remainders(members, COVARIANCE)
    drawing = Drawing(
        name="summary-attitude",
        caption=(
            f"Attitude error against noise{f' ({label})' if label else ''}. Points: "
            "simulation with bars that hold for all together (95 %); lines: second "
            "order, the source's fourth order, the complete fourth order, exact."
            f"{RIGHT_OF_IT if len(panels) > 1 else ''}"
        ),
        alternative=(
            "RMS attitude error against the noise, simulated points beside "
            "four predictions; and the distance of each prediction from the exact one"
        ),
        panels=panels,
    )
    return claiming(drawing, attitude.rms_claim(cells))


def _longest(study: str, groups: Groups) -> tuple[str, Sequence[CellResult]]:
    """The group with the most noise levels; of equals that of the answer above it."""
    told = chosen(study, [cell for group in groups.values() for cell in group])
    own = told[0].named if told else None

    def levels(group: tuple[str, Sequence[CellResult]]) -> tuple[int, bool]:
        noises = {cell.parameters["noise_std"] for cell in group[1]}
        return len(noises), any(cell.named == own for cell in group[1])

    return max(reversed(list(groups.items())), key=levels)
