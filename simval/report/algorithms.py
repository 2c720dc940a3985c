"""Comparison of algorithms, built-in ones and a user's: errors and speed.

Where a run has a user's code this is what comes first after the verdict, which has a
line for each: against the best built-in one, both by the RMS error over the Cramer-Rao
bound, its geometric mean over the settings in which both have a result. A ratio of two
algorithms is then the same whichever is named first, and no setting that is hard for
all of them stands for the rest.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simval import statistics as stat
from simval.figures import Figure, along_entry
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
    of_family,
    over_bound,
    size_row,
)
from simval.judge.settings import setting_words
from simval.plugins.loading import BESIDE, BUILTIN
from simval.ranking import Ranking, ranked
from simval.report.answers import Line, Number, closest, number_of, number_of_row
from simval.report.curves import MAX_GROUPS, along_axis, grouped, simultaneous, upright
from simval.report.curves import Measured as Said
from simval.report.formatting import angle, angle_unit, begun, spelled
from simval.report.gallery import drawn as drawn_figure
from simval.report.panels import DotPanel, Drawing, HeatPanel
from simval.report.section import Context, Section, made
from simval.report.study_sections import numbers
from simval.report.table import Column, Kind, Table, tabulated
from simval.results import CellName
from simval.spelling import rounded
from simval.studies.filter import REFERENCE
from simval.sweep import Run
from simval.sweep.run import CellResult
from simval.units import MILLIRADIAN, OF_A_CALIBRATION, PPM, Unit, of_row
from simval.verdict import ENDINGS, WORST_FIRST, Verdict

# ---- contest


@dataclass(frozen=True, slots=True, kw_only=True)
class Contest:
    """Algorithms that were measured in the same settings."""

    study: str
    algorithms: tuple[str, ...]  # in the order of the suite
    # what varies but for the algorithm, its seed and its effort, in words
    settings: tuple[str, ...]
    # of an algorithm in a setting, one for each seed; some may have no result
    cells: Mapping[tuple[str, str], tuple[CellResult, ...]]
    # RMS error over the bound, by algorithm, in the settings in which it has a result
    accuracy: Mapping[str, Mapping[str, Measured]]
    # greatest share of exact cases of a class that fail, by algorithm
    failures: Mapping[str, Mapping[str, Share]]

    def of(self, algorithm: str) -> list[CellResult]:
        """Cells of one algorithm."""
        found = (self.cells.get((algorithm, setting), ()) for setting in self.settings)
        return [cell for cells in found for cell in cells]

    def mean(
        self, algorithm: str, settings: Collection[str] | None = None
    ) -> tuple[Measured | None, list[str]]:
        """Geometric mean of its accuracy, and the settings over which it is taken."""
        own = self.accuracy[algorithm]
        shared = [s for s in own if settings is None or s in settings]
        if not shared:
            return None, []
        value, error = np.array([own[s] for s in shared]).T
        whole = float(np.exp(np.mean(np.log(value))))
        spread = whole * float(np.hypot.reduce(error / value)) / len(shared)
        return Measured(whole, spread), shared


def contest_of(cells: Sequence[CellResult]) -> Contest:
    """Sort the cells of one study by algorithm and setting."""
    names = tuple(dict.fromkeys(map(algorithm_of, cells)))
    found: dict[tuple[str, str], tuple[CellResult, ...]] = {}
    accuracy: dict[str, dict[str, Measured]] = {name: {} for name in names}
    settings: dict[str, None] = {}
    for label, members in grouped(cells, "algorithm").items():
        setting = label or _only(members[0])
        settings[setting] = None
        for name in names:
            own = tuple(c for c in members if algorithm_of(c) == name)
            sizes = [size for cell in own if (size := over_bound(cell)) is not None]
            if own:
                found[name, setting] = own
            if sizes:  # the mean over the seeds
                value, error = np.array(sizes).T
                spread = float(np.hypot.reduce(error)) / len(sizes)
                accuracy[name][setting] = Measured(float(value.mean()), spread)
    worst: dict[str, dict[str, Share]] = {name: {} for name in names}
    for cell in cells:
        shares = worst[algorithm_of(cell)]
        for kind, share in failures(cell).items():
            if kind not in shares or share.value > shares[kind].value:
                shares[kind] = share
    return Contest(
        study=cells[0].study,
        algorithms=names,
        settings=tuple(settings),
        cells=found,
        accuracy=accuracy,
        failures=worst,
    )


def _only(cell: CellResult) -> str:
    """The single setting in words: its noise, or its scenario."""
    noise = cell.parameters.get("noise_std")
    if isinstance(noise, float):
        return setting_words(cell.study, "noise_std", noise)
    return str(cell.parameters.get("scenario") or "all")


def answer_of(cells: Iterable[CellResult], verdicts: Iterable[Verdict]) -> str:
    """Worst answer for the cells of an algorithm, or how one without a result ended."""
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

Times = Mapping[str, Mapping[str, float]]
"""What was timed, by the name of the cell."""


def side_by_side(contest: Contest, verdicts: Sequence[Verdict], times: Times) -> Table:
    """Table with a row for each algorithm."""
    study, many = contest.study, len(contest.settings)
    reference = next((own[0] for f, own in BESIDE.items() if f.startswith(study)), "")
    shown = (
        f"{MAX_SETTINGS} of {many} settings" if many > MAX_SETTINGS else "each setting"
    )

    def timed(name: str, what: str) -> float | None:
        """Median over the cells of an algorithm."""
        found = [times[c.name][what] for c in contest.of(name) if c.name in times]
        return float(np.median(found)) if found else None

    def milliseconds(name: str) -> float | None:
        seconds = timed(name, "seconds")
        return None if seconds is None else 1e3 * seconds

    def operations(name: str) -> float | None:
        rows = [row for c in contest.of(name) for row in of_family(c, stat.OPERATIONS)]
        found = [row.value for row in rows if "median" in row.statistic.entries]
        return float(np.median(found)) if found else None

    def worst(name: str, measure: Any, far: Any) -> Any:
        found = [measure(cell) for cell in contest.of(name)]
        return max((x for x in found if x is not None), key=far, default=None)

    fields: dict[Column, Any] = {
        Column("algorithm", "code"): str,
        Column("checks", "answer"): lambda n: answer_of(contest.of(n), verdicts),
        **{
            Column(setting, "measured"): lambda n, s=setting: contest.accuracy[n].get(s)
            for setting in contest.settings[:MAX_SETTINGS]
        },
        Column("bias", "number", 2, shown="bias over bound"): lambda n: worst(
            n, bias_over_bound, float
        ),
        Column("NEES", "measured", shown="NEES over its mean"): lambda n: worst(
            n, honesty, lambda ratio: abs(ratio.value - 1.0)
        ),
        Column("call, ms", "number", 3): milliseconds,
        Column("× built-in", "number", 3): lambda n: timed(n, "ratio"),
    }
    counted = ""
    if any(operations(name) is not None for name in contest.algorithms):
        fields[Column("operations", "number", 5)] = operations
        counted = ", operations of a call"
    if any(contest.failures.values()):
        fields[Column("fails at")] = lambda n: fails_at(contest.failures[n])
    return tabulated(
        contest.algorithms,
        fields,
        name=f"{study}-algorithms",
        caption=(
            f"RMS error over the bound in {shown}. Then, over all settings: greatest "
            "bias over the bound, worst NEES over its mean, time of a call in ms and "
            f"over that of {reference} (× built-in){counted}, and the class in which "
            "it fails most"
        ),
    )


def fails_at(shares: Mapping[str, Share]) -> str:
    """Name the class in which most cases fail, and how many other classes fail."""
    if not shares:
        return ""
    bad = [(share.value, name) for name, share in shares.items() if share.value > 0.0]
    if not bad:
        return "nowhere"
    worst, name = min(bad, key=lambda each: (-each[0], each[1]))
    declared = " (declared)" if shares[name].declared else ""
    more = f", +{len(bad) - 1}" if len(bad) > 1 else ""
    return f"{name} {100.0 * worst:.3g} %{declared}{more}".replace(" ", SPACE)


def by_cell(contest: Contest) -> Table:
    """Table with a row for each cell that has a result."""
    settings = {
        cell.name: setting
        for setting in contest.settings
        for name in contest.algorithms
        for cell in contest.cells.get((name, setting), ())
        if cell.rows
    }
    cells = {
        cell.name: cell for name in contest.algorithms for cell in contest.of(name)
    }
    whole = next(filter(None, map(size_row, cells.values())), None)
    sizes: dict[Column, Any] = {
        _in_unit("RMS of T", "1", MILLIRADIAN, "measured"): lambda c: group_rms(c, "S"),
        _in_unit("RMS of K", "1", PPM, "measured"): lambda c: group_rms(c, "K"),
        Column("RMS of B, raw", "measured"): lambda c: group_rms(c, "B"),
    }
    if whole is not None:  # in the unit that a person reads
        unit = of_row(whole.unit)
        if whole.unit == "rad":
            unit = angle_unit(whole.value)
        sizes = {
            _in_unit("RMS error", whole.unit, unit, "measured"): lambda c: _whole(c)[0],
            _in_unit("bound", whole.unit, unit, "number"): lambda c: _whole(c)[1],
        }
    return tabulated(
        [cells[name] for name in settings],
        {
            Column("algorithm", "code"): algorithm_of,
            Column("setting"): lambda c: settings[c.name],
            **sizes,
            Column("over the bound", "measured"): over_bound,
            Column("bias over the bound", "number", 3): bias_over_bound,
            Column("NEES over its mean", "measured"): honesty,
            Column("seed", "number", 12): lambda c: c.seed,
        },
        name=f"{contest.study}-cells",
        caption=f"Each {contest.study} in each setting: its error, that over the "
        "bound, and whether it states it right (NEES)",
        shown=MAX_CELLS,
    )


def _whole(cell: CellResult) -> tuple[Any, Any]:
    """Size of the whole error with its standard error, and the bound."""
    row = size_row(cell)
    return ((row.value, row.standard_error), row.prediction) if row else (None, None)


def _in_unit(title: str, unit: str, shown: Unit, kind: Kind) -> Column:
    return Column(
        f"{title}, {unit}", kind, shown=f"{title}, {shown.name}", factor=shown.factor
    )


# ---- figures

MAX_ROWS = 60
"""Algorithms drawn, each a row of the figure; the table has all."""


def dots(who: str, contest: Contest) -> Drawing | None:
    """Plot the RMS error over the bound of each algorithm in each setting."""
    drawn, settings = contest.algorithms[:MAX_ROWS], contest.settings[:MAX_GROUPS]
    short = called(contest.algorithms)
    found = [
        along_axis(setting if len(settings) > 1 else "", points)
        for setting in settings
        if (
            points := [  # each with the first of its cells
                (
                    place,
                    contest.cells[name, setting][0],
                    Said(*size, np.nan, unit=BOUND),
                )
                for place, name in enumerate(drawn)
                if (size := contest.accuracy[name].get(setting)) is not None
            ]
        )
    ]
    if not found:
        return None
    z = simultaneous(sum(int(np.sum(c.error > 0.0)) for c in found))
    series = [
        replace(
            upright(c.points(z, i)),
            band=np.where(c.error > 0.0, z * c.error, np.nan),
        )
        for i, c in enumerate(found)
    ]
    alone = f" ({settings[0]})" if len(settings) == 1 else ""
    return Drawing(
        name=f"{contest.study}-accuracy",
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
                series=series,
                reference=(1.0, "the bound"),
            )
        ],
        columns=1,
        left_out=[*contest.algorithms[MAX_ROWS:], *contest.settings[MAX_GROUPS:]],
    )


def _ranked(contest: Contest, short: Mapping[str, str]) -> str:
    """The best and the worst algorithm over the settings in which all have results."""
    seen = [name for name in short if contest.accuracy[name]]
    of = contest.settings
    shared = [s for s in of if all(s in contest.accuracy[name] for name in seen)]
    means = {name: m.value for name in seen if (m := contest.mean(name, shared)[0])}
    if not means:
        return ""
    how = "geometric mean over" if len(shared) > 1 else "in"
    over = f" ({how} {len(shared)} settings)" if len(shared) > 1 else ""
    if len(shared) < len(of):
        over = f" ({how} {len(shared)} of {len(of)} settings)"
    found = ranking(contest, means, shared)
    first, last = found.order[0], found.order[-1]
    best, worst = means[first], means[last]
    if first == last:
        return f"{short[first]} has {best:.3g} times the error of the bound{over}."
    if found.tied:
        return (
            f"No difference is seen between {short[first]}, with {best:.3g} times the "
            f"error of the bound, and {short[last]}, with {worst:.3g} times{over}."
        )
    return (
        f"{short[first]}{_beside(found.best, short)} is nearest to the bound, with "
        f"{best:.3g} times its error, and {short[last]}{_beside(found.worst, short)} "
        f"farthest, with {worst:.3g} times{over}."
    )


def ranking(
    contest: Contest, means: Mapping[str, float], settings: Sequence[str]
) -> Ranking:
    """Rank algorithms by their means; ties are judged as `simval compare` does."""
    of = contest.cells
    cells = {n: [c for s in settings for c in of.get((n, s), ())] for n in means}
    return ranked(means, lambda one, other: apart(cells[one], cells[other]))


def _beside(tied: Sequence[str], short: Mapping[str, str]) -> str:
    """Name the algorithms that tie with the first one, in brackets."""
    others = ", ".join(short[name] for name in tied[1:])
    return f" (no difference seen to {others})" if others else ""


def failing(who: str, contest: Contest) -> Drawing | None:
    """Plot the share of exact cases that fail in each class; None if none fails."""
    drawn, short = contest.algorithms[:MAX_ROWS], called(contest.algorithms)
    shares = [contest.failures[name] for name in drawn]
    classes = list(dict.fromkeys(key for each in shares for key in each))
    if not any(share.value > 0.0 for each in shares for share in each.values()):
        return None
    none = Share(np.nan, False)
    table = np.array([[own.get(kind, none) for kind in classes] for own in shares])
    return Drawing(
        name=f"{contest.study}-failures",
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
                shares=table[..., 0],
                expected=table[..., 1],
            )
        ],
        columns=1,
        left_out=contest.algorithms[MAX_ROWS:],
    )


# ---- lines of the first screen

BOUND = "\N{MULTIPLICATION SIGN} the bound"


def lines_of_algorithms(context: Context) -> list[Line]:
    """A line for each user's algorithm, or one for the best built-in one."""
    return [
        line
        for contest in contests(context.run)
        for line in (
            [_line(context, contest, name) for name in contest.algorithms if own(name)]
            or [_line_of_best(contest)]
        )
    ]


def own(algorithm: str) -> bool:
    """True for an algorithm of a user."""
    return algorithm not in BUILTIN


def contests(run: Run) -> list[Contest]:
    """The contest of each kind of algorithm; the reference filter alone is none."""
    studies = [[c for c in run.cells if c.study == study] for study in STUDIES]
    found = [contest_of(cells) for cells in studies if cells]
    return [each for each in found if each.algorithms != (REFERENCE,)]


def _line_of_best(contest: Contest) -> Line:
    """Line about the best built-in algorithm, where no user's was measured."""
    found, value, count = best(contest, contest.settings)
    what = begun(spelled(contest.study))
    if value is None:
        said = "Not measured."
        return Line(what=what, said=said, link="algorithms", answer="inconclusive")
    number = number_of(f"{what}, best error", *value, BOUND)
    return Line(
        what=what,
        said=f"{found[0]}, {_place(found, contest)}.",
        number=number,
        keys=[(number, f"{what}: {_over(contest, count)}")],
        link="algorithms",
    )


def _place(tied: Sequence[str], contest: Contest) -> str:
    """Say that the first one is best of all, and who ties with it."""
    short = called(contest.algorithms)
    return f"the least of {len(contest.algorithms)}{_beside(tied, short)}"


def _line(context: Context, contest: Contest, name: str) -> Line:
    """Line about one algorithm of a user."""
    cells = contest.of(name)
    ended, names = answer_of(cells, context.verdicts), {cell.named for cell in cells}
    share, checks = closest([v for v in context.verdicts if v.cell in names])
    why = next((cell.reason for cell in cells if cell.ending == ended), "")
    line = Line(
        what=called(contest.algorithms)[name],
        said=": ".join(filter(None, ("No result", why.partition(";")[0]))) + ".",
        link="algorithms",
        answer=next(
            (word for word in WORST_FIRST if word == ended),
            "fail" if ended == "crashed" else "inconclusive",
        ),
        share=share,
        checks=checks if any(cell.rows for cell in cells) else "",
    )
    value, settings = contest.mean(name)
    if value is None:
        return line
    (beside, *_), other, count = best(contest, settings)
    against = ""
    if other is not None:
        # over the settings of both, so that like is set beside like
        value = contest.mean(name, contest.accuracy[beside])[0] or value
        against = f"{beside} {number_of('', *other).said}"
    rows = [row for cell in contest.of(name) if (row := size_row(cell)) is not None]
    size = ""
    if rows:
        sizes = dict.fromkeys(f(row.value for row in rows) for f in (min, max))
        unit = rows[0].unit
        told = (angle(x) if unit == "rad" else f"{rounded(x)} {unit}" for x in sizes)
        size = f"{' to '.join(told)} RMS"
    failing = fails_at(contest.failures[name])
    fails = f"fails at {failing}" if failing not in ("", "nowhere") else ""
    said = "; ".join(filter(None, (size, against, fails)))
    number = number_of(f"{line.what}, error", *value, BOUND, against)
    failed = {v.cell for v in context.verdicts if v.answer == "fail"}
    shown = [s for s in contest.settings if (name, s) in contest.cells]
    place, cell = max(
        ((s, c) for s in shown for c in contest.cells[name, s] if c.rows),
        key=lambda each: each[1].named in failed,
    )
    return replace(
        line,
        said=f"{begun(said)}.",
        number=number,
        keys=[
            (number, f"{line.what}: {_over(contest, count or len(settings))}"),
            *((n, f"{line.what}: {place}") for n in _numbers(line.what, cell)),
        ],
    )


SAID = (stat.NEES, stat.NIS, stat.SQUARED_ERROR, stat.RMS, stat.SETTLING)
"""What the first screen has of an algorithm beside the size of its error, in order."""


def _numbers(who: str, cell: CellResult) -> Iterator[Number]:
    """Sizes of a cell's errors, and whether the algorithm states them right."""
    whole = size_row(cell)
    groups = {k: row for k in OF_A_CALIBRATION if (row := group_rms(cell, k))}
    for kind, row in groups.items():
        letter = kind.replace("S", "T")
        unit = OF_A_CALIBRATION[kind]
        yield number_of_row(f"{who}, RMS error of {letter}", row, unit)
    rows = [] if groups or whole is None else [whole]
    rows += [row for family in SAID for row in of_family(cell, family)]
    for row in dict.fromkeys(rows):
        words = row.statistic.family.words, *row.statistic.entries
        yield number_of_row(", ".join((who, *words)), row)
    if shares := failures(cell):
        most = max(share.value for share in shares.values())
        label = f"{who}, worst share of exact cases that fail"
        yield number_of(label, 100.0 * most, 0.0, "%", fails_at(shares))


def best(
    contest: Contest, settings: Collection[str]
) -> tuple[tuple[str, ...], Measured | None, int]:
    """The best built-in algorithm with those that tie, its mean, and its settings.

    After it come those that are not told apart from it.
    """
    names = [name for name in contest.algorithms if not own(name)]
    found = [(name, *contest.mean(name, settings)) for name in names]
    # one that has fewer results never stands for all
    most = max((len(shared) for _, _, shared in found), default=0)
    whole = {n: m for n, m, shared in found if m and len(shared) == most}
    if not whole:
        return ("",), None, 0
    means = {name: mean.value for name, mean in whole.items()}
    tied = ranking(contest, means, [s for s in contest.settings if s in settings]).best
    return tied, whole[tied[0]], most


def _over(contest: Contest, count: int) -> str:
    if len(contest.settings) == 1:
        return contest.settings[0]
    return f"geometric mean over {count} settings" if count > 1 else "one setting"


ROUNDING = Figure(
    name="rounding",
    asked="What does rounding cost where two vectors are nearly parallel?",
    rows=[stat.ROUNDING_AT],
    along=along_entry,
    axis="sine of the angle between the vectors",
    lines="algorithm",
    value="greatest error without noise",
    compared=False,
    caption=(
        "Greatest error of exact cases. What takes the vectors as they are loses "
        "digits as the sine falls, what makes Davenport's matrix or its like of them "
        "loses as many again. An answer that is no attitude is drawn at a half turn."
    ),
)

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
    """The section about algorithms of one kind."""

    title: str
    drawings: tuple[Drawing, ...]
    tables: tuple[Table, ...]
    call: str  # what one call does
    classes: int  # of exact cases, in which an algorithm may fail; 0 without any
    failing: bool  # whether one does


def algorithms_section(context: Context) -> Section | None:
    """Make the section on algorithms."""
    parts = [_part(context, contest) for contest in contests(context.run)]
    if not parts:
        return None
    return made(
        [drawing for part in parts for drawing in part.drawings],
        [table for part in parts for table in part.tables],
        parts=parts,
    )


def _part(context: Context, contest: Contest) -> Part:
    study, who = contest.study, CALLED[contest.study]
    accuracy, failures = dots(who, contest), failing(who, contest)
    times = context.run.timing.get("calls", {})
    cells = context.cells(study)
    rest = (by_cell(contest), numbers(study, cells))
    digits = drawn_figure(ROUNDING, cells) if study == "estimator" else []
    return Part(
        title=who.capitalize(),
        drawings=(*(d for d in (accuracy, failures) if d is not None), *digits),
        tables=(
            side_by_side(contest, context.verdicts, times),
            *(table for table in rest if table.rows),
        ),
        call=CALL[study],
        classes=max(map(len, contest.failures.values())),
        failing=failures is not None,
    )


def has_user_code(run: Run) -> bool:
    """True if a run measures an algorithm of a user."""
    return any(cell.study in STUDIES and own(algorithm_of(cell)) for cell in run.cells)
