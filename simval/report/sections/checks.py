"""Every check against theory: failing ones first, then what each family found."""

from simval.report.section import Context, Section, made
from simval.verdict import Verdict

ORDER = {"fail": 0, "inconclusive": 1, "pass": 2}
SHOWN = 400


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
    verdicts = sorted(context.verdicts, key=_rank)
    groups: dict[tuple[str, str, str], list[str]] = {}
    for v in context.verdicts:
        key = (v.cell.partition("(")[0], v.row.predictor, str(v.row.check))
        groups.setdefault(key, []).append(v.answer)
    return made(
        "checks",
        "Checks",
        groups=sorted(groups.items()),
        verdicts=verdicts[:SHOWN],
        hidden=max(0, len(verdicts) - SHOWN),
        alpha=context.alpha,
    )


def _rank(verdict: Verdict) -> tuple[int, float, str]:
    p = verdict.p_value if verdict.p_value is not None else 1.0
    return ORDER[verdict.answer], p, verdict.cell
