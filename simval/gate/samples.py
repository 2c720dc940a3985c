"""How many samples the verdicts of a run need, and how many it spends.

A verdict needs as many as make the smallest discrepancy that is found with the stated
power, eq. (V2) of `simval.verdict`, just the practical margin. What a row sees is that
discrepancy and the remainder together, as a share of the predicted value.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import ceil, isnan

from simval.verdict import PRACTICAL, Verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Spent:
    """The rows of one kind of statistic of a study that are judged by one check.

    Attributes
    ----------
    study, check, statistic : str
        Which rows.
    rows : int
        How many.
    needed, spent : int
        Samples that the most demanding of them needs, and those of the one with the
        fewest.
    seen : float
        Share of the spread of a sample or of the prediction, whichever is greater,
        that is seen beyond the remainder; the greatest of the rows.
    seconds : float
        Processor time of the study, s.
    """

    study: str
    check: str
    statistic: str
    rows: int
    needed: int
    spent: int
    seen: float
    seconds: float


def samples_spent(
    verdicts: Iterable[Verdict], seconds: Mapping[str, float]
) -> tuple[Spent, ...]:
    """Samples that each kind of row needs and spends.

    Parameters
    ----------
    verdicts : iterable of Verdict
        From `simval.verdict.judge`; those over all cells of a study are left out.
    seconds : mapping
        Processor time of each cell, by its name, s.

    Returns
    -------
    tuple of Spent
        By study, check and statistic.
    """
    kinds: dict[tuple[str, str, str], list[Verdict]] = {}
    for verdict in verdicts:
        if verdict.cell.name and not isnan(verdict.detectable):
            row = verdict.row
            kind = (verdict.cell.study, row.check, row.statistic.family.name)
            kinds.setdefault(kind, []).append(verdict)
    return tuple(
        Spent(
            study=study,
            check=check,
            statistic=statistic,
            rows=len(found),
            needed=ceil(max(each.samples_needed for each in found)),
            spent=min(each.row.n for each in found),
            seen=max(each.detectable / each.margin * PRACTICAL for each in found),
            seconds=sum(s for n, s in seconds.items() if n.startswith(f"{study}(")),
        )
        for (study, check, statistic), found in sorted(kinds.items())
    )
