"""The first screen: the verdict in one line, three answers, and the two figures.

The answers: how wrong the algorithms are, whether that is as theory says, and whether
it is worse than before.

Where a run has a user's code, its algorithms come next and the figures after them
(`overview`).
"""

from simval.judge import headline
from simval.report.answers_before import worse_than_before
from simval.report.answers_theory import as_theory_says
from simval.report.answers_wrong import how_wrong
from simval.report.declared import shown_of
from simval.report.panels import Drawing
from simval.report.question import question_figure
from simval.report.section import Context, Section, made
from simval.report.sections.algorithms import has_user_code
from simval.sweep.run import CellResult

EXPLAINED = {
    "T ": "T, K and B: misalignment of the axes, scale factors and bias of an "
    "accelerometer.",
    "the bound": "The bound: the least error that any unbiased method can have with "
    "these data (Cramér and Rao).",
    "theory": "Theory: what was predicted before anything was simulated.",
}
"""What the first screen uses without a word, by what stands in its lines."""


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
    """The figures that say most of the package's own algorithms."""
    asked = question_figure(context)
    # a noise axis with one level is no figure beside it
    return shown_of(context, "summary")[0] if asked is None else [asked]
