"""Figures of algorithms side by side: accuracy as dots, failures as a map."""

from collections.abc import Mapping, Sequence

import numpy as np

from simval.judge.algorithms import Measured, apart, called, over_bound
from simval.report.answers_algorithms import BOUND, mean
from simval.report.contest import Contest
from simval.report.curves import MAX_GROUPS
from simval.report.notes import Measured as Said
from simval.report.notes import note
from simval.report.panels import COLOURS, MARKERS, DotPanel, Drawing, HeatPanel, Series
from simval.report.slope import simultaneous

MAX_ROWS = 60
"""Algorithms drawn, each a row of the figure; the table has all."""


def dots(name: str, who: str, contest: Contest) -> Drawing | None:
    """RMS error over the bound of each algorithm in each setting, with bands."""
    drawn, settings = contest.algorithms[:MAX_ROWS], contest.settings[:MAX_GROUPS]
    short = called(contest.algorithms)
    found = [
        (i, place, measured)
        for i, setting in enumerate(settings)
        for place, algorithm in enumerate(drawn)
        if (measured := contest.measured(algorithm, setting, over_bound)) is not None
    ]
    if not found:
        return None
    z = simultaneous(sum(measured.error > 0.0 for _, _, measured in found))
    series = []
    for i, setting in enumerate(settings):
        own = [(place, *measured) for k, place, measured in found if k == i]
        notes = [
            _note(contest, drawn[place], setting, measured)
            for k, place, measured in found
            if k == i
        ]
        if own:
            place, value, error = np.array(own, dtype=float).T
            series.append(
                Series(
                    label=setting if len(settings) > 1 else "",
                    x=value,
                    y=place,
                    band=np.where(error > 0.0, z * error, np.nan),
                    colour=COLOURS[i % len(COLOURS)],
                    marker=MARKERS[i % len(MARKERS)],
                    notes=notes,
                )
            )
    alone = f" ({settings[0]})" if len(settings) == 1 else ""
    return Drawing(
        name=f"{name}-accuracy",
        asked="How near to the bound is each?",
        finding=_ranked(contest, short),
        caption=(
            f"RMS error of each algorithm over the Cramér-Rao bound{alone}: 1, the "
            "dashed line, is as good as any unbiased one can be to first order. Bars: "
            "95 % for all points of the figure together; a point without one is not "
            "sampled."
        ),
        alternative=(
            f"RMS error of {len(drawn)} {who} over the Cramér-Rao bound, a row for "
            "each; the table below has the numbers"
        ),
        panels=[
            DotPanel(
                title=f"accuracy of {who}",
                x_label="RMS error / Cramér-Rao bound (dashed: the bound)",
                names=[short[name] for name in drawn],
                series=tuple(series),
                reference=(1.0, "the bound"),
            )
        ],
        columns=1,
        left_out=[*contest.algorithms[MAX_ROWS:], *contest.settings[MAX_GROUPS:]],
    )


def _note(contest: Contest, algorithm: str, setting: str, found: Measured) -> str:
    """What the page says of a dot: its ratio, and the first cell that it is of."""
    cell = contest.cells[algorithm, setting][0]
    return note(cell, Said(*found, prediction=np.nan, unit=BOUND))


def _ranked(contest: Contest, short: Mapping[str, str]) -> str:
    """The best and the worst, by the mean over settings in which all have a result."""
    own = {
        name: {s for s in contest.settings if contest.measured(name, s, over_bound)}
        for name in short
    }
    seen = [name for name in short if own[name]]
    shared = [s for s in contest.settings if all(s in own[name] for name in seen)]
    means = [(mean(contest, name, shared), name) for name in seen]
    found = sorted((m.value, name) for m, name in means if m is not None)
    if not found:
        return ""
    many, of = len(shared), len(contest.settings)
    over = f" (geometric mean over {many} settings)" if many > 1 else ""
    if many < of:
        over = (
            f" ({'geometric mean over' if many > 1 else 'in'} {many} of {of} settings)"
        )
    (best, first), (worst, last) = found[0], found[-1]
    if len(found) == 1:
        return f"{short[first]} has {best:.3g} times the error of the bound{over}."
    cells = {
        name: [cell for s in shared for cell in contest.cells[name, s]]
        for _, name in found
    }
    # as `simval compare` would judge the pair; who is not told apart is not ranked
    near, far = (
        [name for _, name in found if name == end or not apart(cells[end], cells[name])]
        for end in (first, last)
    )
    if last in near:
        return (
            f"No difference is seen between {short[first]}, with {best:.3g} times the "
            f"error of the bound, and {short[last]}, with {worst:.3g} times{over}."
        )
    nearest, farthest = (_all(end, tied, short) for end, tied in
                         ((first, near), (last, far)))  # fmt: skip
    return (
        f"{nearest} is nearest to the bound, with {best:.3g} times its error, and "
        f"{farthest} farthest, with {worst:.3g} times{over}."
    )


def _all(name: str, tied: Sequence[str], short: Mapping[str, str]) -> str:
    """An algorithm, and those that no difference is seen to."""
    others = ", ".join(short[each] for each in tied if each != name)
    return f"{short[name]} (no difference seen to {others})" if others else short[name]


def failing(name: str, who: str, contest: Contest) -> Drawing | None:
    """Share of exact cases that fail by class, if any fails."""
    drawn, short = contest.algorithms[:MAX_ROWS], called(contest.algorithms)
    shares = [contest.failures(algorithm) for algorithm in drawn]
    classes = list(dict.fromkeys(key for each in shares for key in each))
    if not any(share.value > 0.0 for each in shares for share in each.values()):
        return None
    table = np.full((len(drawn), len(classes)), np.nan)
    declared = np.zeros_like(table)
    for i, each in enumerate(shares):
        for key, share in each.items():
            table[i, classes.index(key)] = share.value
            declared[i, classes.index(key)] = share.declared
    return Drawing(
        name=f"{name}-failures",
        caption=(
            "Where they fail: percent of the exact cases of a class that an algorithm "
            "gets wrong; an empty field is none. In brackets what it declares itself, "
            "which is not judged. A question mark: not measured."
        ),
        alternative=(
            f"Share of failures of {len(drawn)} {who} in {len(classes)} classes of "
            "attitudes, a row for each; the table below names the classes"
        ),
        panels=[
            HeatPanel(
                title="cases that fail, %",
                names=[short[name] for name in drawn],
                columns=classes,
                shares=table,
                expected=declared,
            )
        ],
        columns=1,
        left_out=contest.algorithms[MAX_ROWS:],
    )
