"""The first screen: the verdict in one line, and what was run."""

from simval.report.section import Context, Section, made
from simval.verdict import overall

WORDS = {
    "pass": "every check agrees with theory",
    "fail": "at least one check disagrees with theory",
    "inconclusive": "something was not measured, or not well enough to judge",
}


def section(context: Context) -> Section | None:
    """Make the section.

    Parameters
    ----------
    context : Context
        The run and its verdicts.

    Returns
    -------
    Section or None
        Always a section.
    """
    run, verdicts = context.run, context.verdicts
    unfinished = [cell for cell in run.cells if cell.status != "done"]
    answer = overall(verdicts)
    if answer == "pass" and unfinished:
        answer = "inconclusive"
    counts = {
        name: sum(v.answer == name for v in verdicts)
        for name in ("pass", "fail", "inconclusive")
    }
    studies: dict[str, int] = {}
    for cell in run.cells:
        studies[cell.study] = studies.get(cell.study, 0) + 1
    return made(
        "summary",
        "Verdict",
        answer=answer,
        words=WORDS[answer],
        counts=counts,
        sampled=sum(v.p_value is not None for v in verdicts),
        alpha=context.alpha,
        manifest=run.manifest,
        studies=studies,
        unfinished=len(unfinished),
        samples=sum(max((r.n for r in cell.rows), default=0) for cell in run.cells),
    )
