"""Algorithms side by side, the package's own and a user's: how wrong, where, how fast.

Where a run has a user's code this is what comes first after the verdict, which has a
line for each: beside the best built-in one, both by the RMS error over the Cramer-Rao
bound, its geometric mean over the settings in which both have a result. A ratio of two
algorithms is then the same whichever is named first, and no setting that is hard for
all of them stands for the rest.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.judge.algorithms import (
    STUDIES,
    Measured,
    Share,
    algorithm_of,
    apart,
    bias_over_bound,
    called,
    failures,
    group_rms,
    honesty,
    over_bound,
    size_row,
)
from simval.plugins.loading import BESIDE, BUILTIN
from simval.report.answers import LEAST_DEGREES, Line, angle, rounded
from simval.report.answers import called as named
from simval.report.any_study import numbers
from simval.report.curves import MAX_GROUPS, grouped, note, simultaneous
from simval.report.curves import Measured as Said
from simval.report.panels import COLOURS, MARKERS, DotPanel, Drawing, HeatPanel, Series
from simval.report.section import Context, Section, made
from simval.report.table import Column, Kind, Table
from simval.report.words import measured, setting_words
from simval.results import CellName, Row
from simval.studies.filter import REFERENCE
from simval.sweep import Run
from simval.sweep.run import CellResult
from simval.units import DEGREE, MILLIRADIAN, PPM, Unit, of_row
from simval.verdict import ENDINGS, WORST_FIRST, Answer, Verdict

# ---- contest


@dataclass(frozen=True, slots=True, kw_only=True)
class Contest:
    """Algorithms that were measured in the same settings."""

    algorithms: tuple[str, ...]  # in the order of the suite
    # what varies but for the algorithm, its seed and its effort, in words
    settings: tuple[str, ...]
    # of an algorithm in a setting, one for each seed; some may have no result
    cells: Mapping[tuple[str, str], tuple[CellResult, ...]]

    def of(self, algorithm: str) -> tuple[CellResult, ...]:
        """Cells of an algorithm."""
        found = (self.cells.get((algorithm, setting), ()) for setting in self.settings)
        return tuple(cell for cells in found for cell in cells)

    def measured(
        self, algorithm: str, setting: str, measure: Callable[..., Measured | None]
    ) -> Measured | None:
        """Mean over the seeds of what is measured of an algorithm in a setting."""
        found = [measure(cell) for cell in self.cells.get((algorithm, setting), ())]
        values = [each for each in found if each is not None]
        if not values:
            return None
        value, error = np.array(values).T
        return Measured(float(value.mean()), float(np.hypot.reduce(error)) / len(value))

    def failures(self, algorithm: str) -> Mapping[str, Share]:
        """Greatest share of failures by class; no noise is in them."""
        worst: dict[str, Share] = {}
        for cell in self.of(algorithm):
            for name, share in failures(cell).items():
                if name not in worst or share.value > worst[name].value:
                    worst[name] = share
        return worst


def contest_of(cells: Sequence[CellResult]) -> Contest:
    """Sort the cells of one study by algorithm and setting."""
    names = tuple(dict.fromkeys(map(algorithm_of, cells)))
    found: dict[tuple[str, str], tuple[CellResult, ...]] = {}
    settings: dict[str, None] = {}
    for label, members in grouped(cells, "algorithm").items():
        setting = label or _only(members[0])
        settings[setting] = None
        for name in names:
            own = tuple(c for c in members if algorithm_of(c) == name)
            if own:
                found[name, setting] = own
    return Contest(algorithms=names, settings=tuple(settings), cells=found)


def _only(cell: CellResult) -> str:
    noise = cell.parameters.get("noise_std")
    known = isinstance(noise, float)
    return setting_words(cell.study, "noise_std", noise) if known else _scenario(cell)


def _scenario(cell: CellResult) -> str:
    return str(cell.parameters.get("scenario") or "all")


def answer_of(cells: Iterable[CellResult], verdicts: Iterable[Verdict]) -> str:
    """Worst answer to the cells of an algorithm, or how one without a result ended."""
    names: set[CellName] = set()
    endings = set()
    for cell in cells:
        names.add(cell.named)
        endings.add(cell.ending)
    answers = {v.answer for v in verdicts if v.cell in names}
    return next((word for word in ENDINGS if word in endings | answers), "")


# ---- tables

MAX_SETTINGS = 4
"""Settings with a column of their own; the table of cells has all."""
SPACE = "\N{NO-BREAK SPACE}"
"""Keeps the words of a field in one line."""
MAX_CELLS = 60
DEGREES = Unit("degrees", DEGREE.factor)

Times = Mapping[str, Mapping[str, float]]
"""What was timed, by the name of the cell."""


def side_by_side(
    study: str, contest: Contest, verdicts: Sequence[Verdict], times: Times
) -> Table:
    """A row for each algorithm."""
    settings = contest.settings[:MAX_SETTINGS]
    reference = next((own[0] for f, own in BESIDE.items() if f.startswith(study)), "")
    many = len(contest.settings)
    shown = (
        f"{MAX_SETTINGS} of {many} settings" if many > MAX_SETTINGS else "each setting"
    )
    with_failures = any(contest.failures(name) for name in contest.algorithms)
    rows = []
    for name in contest.algorithms:
        cells = contest.of(name)
        biases = [bias_over_bound(cell) for cell in cells]
        fails = (told(contest.failures(name)),) if with_failures else ()
        rows.append(
            (
                name,
                answer_of(cells, verdicts),
                *(contest.measured(name, setting, over_bound) for setting in settings),
                max((b for b in biases if b is not None), default=None),
                _worst_honesty(cells),
                *_time(cells, times),
                *fails,
            )
        )
    return Table(
        name=f"{study}-algorithms",
        caption=(
            f"RMS error over the bound in {shown}; then, over all of them: greatest "
            "bias over the bound, worst NEES over its mean, time of a call, the same "
            f"over that of {reference}, where it fails"
        ),
        columns=(
            Column("algorithm", "code"),
            Column("checks", "answer"),
            *(Column(setting, "measured") for setting in settings),
            Column("bias", "number", 2, shown="bias / bound"),
            Column("NEES", "measured", shown="NEES / mean"),
            Column("call, ms", "number", 3),
            Column("× built-in", "number", 3),
            *((Column("fails at"),) if with_failures else ()),
        ),
        rows=rows,
    )


def told(shares: Mapping[str, Share]) -> str:
    """Name the class in which most cases fail, and count the others."""
    if not shares:
        return ""
    bad = [(share.value, name) for name, share in shares.items() if share.value > 0.0]
    if not bad:
        return "nowhere"
    worst, name = min(bad, key=lambda each: (-each[0], each[1]))
    declared = " (declared)" if shares[name].declared else ""
    more = f", +{len(bad) - 1}" if len(bad) > 1 else ""
    return f"{name} {100.0 * worst:.3g} %{declared}{more}".replace(" ", SPACE)


def _worst_honesty(cells: Sequence[CellResult]) -> tuple[float, float] | None:
    found = [each for cell in cells if (each := honesty(cell)) is not None]
    return max(found, key=lambda each: abs(each.value - 1.0), default=None)


def _time(cells: Sequence[CellResult], times: Times) -> tuple[Any, Any]:
    """Milliseconds of a call and how many times the reference's, medians over cells."""
    found = [times[cell.name] for cell in cells if cell.name in times]
    if not found:
        return None, None
    return (
        1e3 * float(np.median([each["seconds"] for each in found])),
        float(np.median([each["ratio"] for each in found])),
    )


def by_cell(study: str, contest: Contest) -> Table:
    """A row for each cell that has a result."""
    rows: list[tuple[Any, ...]] = []
    whole = next((r for c in contest.cells.values() if (r := size_row(c[0]))), None)
    for setting in contest.settings:
        for name in contest.algorithms:
            for cell in contest.cells.get((name, setting), ()):
                if not cell.rows:
                    continue
                rows.append((algorithm_of(cell), setting, *_sizes(cell, whole)))
    return Table(
        name=f"{study}-cells",
        caption=f"Each {study} in each setting",
        columns=(
            Column("algorithm", "code"),
            Column("setting"),
            *(
                (
                    _sized("RMS error", "measured", whole),
                    _sized("bound", "number", whole),
                )
                if whole is not None
                else (
                    _in_unit("RMS of T", "1", MILLIRADIAN, "measured"),
                    _in_unit("RMS of K", "1", PPM, "measured"),
                    Column("RMS of B, raw", "measured"),
                )
            ),
            Column("over the bound", "measured"),
            Column("bias over the bound", "number", 3),
            Column("NEES over its mean", "measured"),
            Column("seed", "number", 12),
        ),
        rows=rows,
        shown=MAX_CELLS,
    )


def _sized(title: str, kind: Kind, row: Row) -> Column:
    """A column of sizes like that of a row, in the unit that a person reads."""
    small = row.unit == "rad" and row.value < LEAST_DEGREES
    degrees = DEGREES if row.unit == "rad" else of_row(row.unit)
    return _in_unit(title, row.unit, MILLIRADIAN if small else degrees, kind)


def _in_unit(title: str, unit: str, shown: Unit, kind: Kind) -> Column:
    return Column(
        f"{title}, {unit}", kind, shown=f"{title}, {shown.name}", factor=shown.factor
    )


def _sizes(cell: CellResult, whole: Row | None) -> tuple[Any, ...]:
    size: list[Any]
    if whole is None:
        size = [group_rms(cell, letter) for letter in "SKB"]
    elif (row := size_row(cell)) is not None:
        size = [(row.value, row.standard_error), row.prediction]
    else:
        size = [None, None]
    return (*size, over_bound(cell), bias_over_bound(cell), honesty(cell), cell.seed)


# ---- figures

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


# ---- lines of the first screen

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


# ---- section

CALLED = {
    "estimator": "attitude estimators",
    "calibrator": "calibrators",
    "filter": "attitude filters",
}
CALL = {
    "estimator": "A call estimates 1024 attitudes.",
    "calibrator": "A call calibrates one set of poses.",
    "filter": "A call is two seconds of one trial; the built-in one is made for many.",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """What is shown of the algorithms of one kind."""

    title: str
    drawings: tuple[Drawing, ...]
    tables: tuple[Table, ...]
    call: str  # what one call does
    classes: int  # of exact cases, in which an algorithm may fail; 0 without any
    failing: bool  # whether one does


def algorithms_section(context: Context) -> Section | None:
    """Make the section."""
    parts = [part for study in STUDIES if (part := _part(context, study)) is not None]
    if not parts:
        return None
    return made(
        "algorithms",
        "Algorithms side by side",
        [drawing for part in parts for drawing in part.drawings],
        [table for part in parts for table in part.tables],
        parts=parts,
    )


def _part(context: Context, study: str) -> Part | None:
    cells = [cell for cell in context.run.cells if cell.study == study]
    alone = {algorithm_of(cell) for cell in cells} == {REFERENCE}
    if not cells or alone:  # of the reference filter there is a section of its own
        return None
    contest, who = contest_of(cells), CALLED[study]
    accuracy, failures = dots(study, who, contest), failing(study, who, contest)
    times = context.run.timing.get("calls", {})
    rest = (by_cell(study, contest), numbers(study, context.cells(study)))
    return Part(
        title=who.capitalize(),
        drawings=tuple(d for d in (accuracy, failures) if d is not None),
        tables=(
            side_by_side(study, contest, context.verdicts, times),
            *(table for table in rest if table.rows),
        ),
        call=CALL[study],
        classes=max(len(contest.failures(name)) for name in contest.algorithms),
        failing=failures is not None,
    )


def has_user_code(run: Run) -> bool:
    """Whether a run measures an algorithm that is not the package's own."""
    return any(
        cell.study in STUDIES and algorithm_of(cell) not in BUILTIN
        for cell in run.cells
    )
