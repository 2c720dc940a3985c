"""How wrong a user's algorithms are: each beside the best built-in one.

Both by the RMS error over the Cramer-Rao bound, its geometric mean over the settings in
which both have a result: a ratio of two algorithms is then the same whichever is named
first, and no setting that is hard for all of them stands for the rest.
"""

from collections.abc import Sequence

import numpy as np

from simval.judge.algorithms import (
    STUDIES,
    Measured,
    algorithm_of,
    called,
    over_bound,
    size_row,
)
from simval.plugins.loading import BUILTIN
from simval.report.answers import Line, angle, rounded
from simval.report.answers import called as named
from simval.report.contest import Contest, answer_of, contest_of
from simval.report.section import Context
from simval.report.sections.algorithm_tables import told
from simval.report.words import measured
from simval.studies.filter import REFERENCE
from simval.verdict import WORST_FIRST, Answer

BOUND = "\N{MULTIPLICATION SIGN} the bound"


def lines_of_algorithms(context: Context) -> list[Line]:
    """A line for each user's algorithm; of built-in ones alone, one for the best."""
    lines = []
    for study in STUDIES:
        cells = [cell for cell in context.run.cells if cell.study == study]
        names = {algorithm_of(cell) for cell in cells}
        if cells and names != {REFERENCE}:
            lines += _of(context, study, contest_of(cells))
    return lines


def _of(context: Context, study: str, contest: Contest) -> list[Line]:
    short = called(contest.algorithms)
    own = [name for name in contest.algorithms if name not in BUILTIN]
    built_in = [name for name in contest.algorithms if name in BUILTIN]
    if not own:
        name, value, count = best(contest, built_in, contest.settings)
        said = f"{measured(*value)} {BOUND}" if value else "not measured"
        where = f"{name}, the least of {len(built_in)}; {_over(count)}"
        answer: Answer = "pass" if value else "inconclusive"
        return [
            Line(
                what=named(study), said=said, where=where if value else "",
                link="algorithms", answer=answer,
            )
        ]  # fmt: skip
    return [_line(context, contest, name, short[name], built_in) for name in own]


def _line(
    context: Context, contest: Contest, name: str, short: str, built_in: Sequence[str]
) -> Line:
    """What is said of one algorithm of a user."""
    ended = answer_of(contest.of(name), context.verdicts)
    answer: Answer = next((word for word in WORST_FIRST if word == ended), "fail")
    settings = [s for s in contest.settings if contest.measured(name, s, over_bound)]
    value = mean(contest, name, settings)
    if value is None:
        said = f"no result{'' if ended in WORST_FIRST else f': {ended}'}"
        return Line(what=short, said=said, link="algorithms", answer=answer)
    beside, other, count = best(contest, built_in, settings)
    said, size = f"{measured(*value)} {BOUND}", _size(contest, name)
    if other is not None:
        # over the settings of both, so that like is set beside like
        common = [s for s in settings if contest.measured(beside, s, over_bound)]
        value = mean(contest, name, common) or value
        said = f"{measured(*value)} {BOUND}; {beside} {measured(*other)}"
    said = f"{size}; {said}" if size else said
    failing = told(contest.failures(name))
    if failing and failing != "nowhere":
        said += f"; fails at {failing}"
    return Line(
        what=short,
        said=said,
        where=_over(count or len(settings)),
        link="algorithms",
        answer=answer,
    )


def _size(contest: Contest, name: str) -> str:
    """From the least to the greatest RMS error of an algorithm."""
    rows = [row for cell in contest.of(name) if (row := size_row(cell)) is not None]
    if not rows:
        return ""
    spell = (
        angle
        if rows[0].unit == "rad"
        else (lambda value: f"{rounded(value)} {rows[0].unit}")
    )
    ends = dict.fromkeys(f([row.value for row in rows]) for f in (min, max))
    return f"{' to '.join(map(spell, ends))} RMS"


def best(
    contest: Contest, names: Sequence[str], settings: Sequence[str]
) -> tuple[str, Measured | None, int]:
    """The algorithm of the least mean where it has a result, and in how many."""
    found = []
    for name in names:
        own = [s for s in settings if contest.measured(name, s, over_bound)]
        value = mean(contest, name, own)
        if value is not None:
            found.append((name, value, len(own)))
    # one that has fewer results never stands for all
    most = max((count for _, _, count in found), default=0)
    whole = [each for each in found if each[2] == most]
    return min(whole, key=lambda each: each[1].value, default=("", None, 0))


def mean(contest: Contest, name: str, settings: Sequence[str]) -> Measured | None:
    """Geometric mean over settings of the RMS error over the bound."""
    values = [contest.measured(name, s, over_bound) for s in settings]
    found = [value for value in values if value is not None]
    if not found:
        return None
    value, error = np.array(found).T
    whole = float(np.exp(np.mean(np.log(value))))
    return Measured(whole, whole * float(np.hypot.reduce(error / value)) / len(found))


def _over(count: int) -> str:
    return f"geometric mean over {count} settings" if count > 1 else "one setting"
