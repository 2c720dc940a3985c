"""The page of a series of runs: what became better or worse, and since which commit."""

from collections.abc import Iterator

import numpy as np

from simval.compare import Line, Move, Trend
from simval.compare.series import ordered_by
from simval.compare.trend import WAYS
from simval.report.comparison import MAX_FIGURES, OPEN
from simval.report.environment import template
from simval.report.moves import SHOWN, moves_table
from simval.report.panels import COLOURS, Drawing, Panel, Series
from simval.report.section import Section, made
from simval.report.slope import simultaneous
from simval.report.table import Column, Table
from simval.report.words import number, spelled


def render_trend(trend: Trend, name: str) -> str:
    """Render a series of runs as one HTML page.

    Parameters
    ----------
    trend : Trend
        As from `simval.compare.trend_of`.
    name : str
        What the series is called: the name of its folder.

    Returns
    -------
    str
        The page; the same runs give the same bytes.
    """
    return template("page").render(
        title=f"{name}: {len(trend.origins)} runs of {trend.origins[-1].suite}",
        sections=trend_sections(trend),
        version=_version(),
        source=f"the run folders in {name}",
    )


def _version() -> str:
    from importlib.metadata import version

    return version("simval")


def trend_sections(trend: Trend) -> tuple[Section, ...]:
    """Make the sections of the page."""
    drawings = list(_drawings(trend))
    names = {drawing.finding: drawing.name for drawing in drawings}
    figures = [names.get(since_told(trend, run, move)) for run, move in trend.moves]
    moves = [move for _, move in trend.moves]
    since = [trend.origins[run].label for run, _ in trend.moves]
    steps = sum(len(move.steps) for move in moves)
    ways = [(sum(m.standing == way for m in moves), way) for way in WAYS]
    return (
        made(
            "trend",
            "What changed since when",
            drawings,
            [moves_table(moves, figures, since)],
            trend=trend,
            steps=steps,
            ways=ways,
            ordered=ordered_by(trend.origins),
        ),
        made("runs", "The runs", tables=[_runs(trend)]),
        made("values", "Every statistic", tables=[_lines(trend)]),
    )


def since_told(trend: Trend, run: int, move: Move) -> str:
    """A move with the commit that it is since."""
    return f"{move.way.capitalize()} since {trend.origins[run].label}: {move.sentence}."


def _drawings(trend: Trend) -> Iterator[Drawing]:
    """The line of the value that moved most, of each of the largest moves."""
    steps = {(b.run, b.step.cell, b.step.statistic): b.line for b in trend.breaks}
    seen: set[int] = set()
    for run, move in trend.moves:
        at = steps[run, move.worst.cell, move.worst.statistic]
        if at in seen:
            continue
        told = since_told(trend, run, move)
        fold = told if len(seen) >= OPEN else ""
        seen.add(at)
        yield _drawing(trend, at, told, fold, f"trend{len(seen)}")
        if len(seen) == MAX_FIGURES:
            return


def _drawing(trend: Trend, at: int, told: str, fold: str, name: str) -> Drawing:
    line = trend.lines[at]
    power = _power(line)
    shown = 10.0**-power
    z = simultaneous(len(line.points))
    x = np.array([point.run + 1.0 for point in line.points])
    points = Series(
        label="measured",
        x=x,
        y=shown * np.array([point.value for point in line.points]),
        band=shown * z * np.array([point.row.standard_error for point in line.points]),
        colour=COLOURS[0],
        notes=[_note(trend, line, i) for i in range(len(line.points))],
    )
    return Drawing(
        name=name,
        caption=(
            f"{line.statistic} of {line.cell} over the runs, by their number in the "
            f"table of runs. Lines are the levels between steps. Bars: {z:.2f} "
            "standard errors, 95 % for all points together."
        ),
        alternative=f"{line.statistic} over {len(line.points)} runs. {told}",
        panels=[
            Panel(
                title=f"{spelled(line.study)}, {line.statistic}",
                x_label="run, in order",
                y_label=_label(power, line.statistic.unit),
                series=(*_levels(trend, at, shown), points),
                log_x=False,
                log_y=False,
            )
        ],
        finding=told,
        fold=fold,
    )


def _label(power: int, unit: str) -> str:
    parts = (f"1e{power}" if power else "", "" if unit == "1" else unit)
    words = " ".join(filter(None, parts))
    return f"value, {words}" if words else "value"


def _power(line: Line) -> int:
    """Power of ten that the axis is in; 0 where numbers can be read as they are."""
    most = max(abs(p.value) for p in line.points if np.isfinite(p.value))
    power = int(f"{most:e}".partition("e")[2])
    return power if power < -2 or power > 4 else 0


def _levels(trend: Trend, at: int, shown: float) -> Iterator[Series]:
    """A line for each level between two steps."""
    breaks = [b for b in trend.breaks if b.line == at]
    runs = [point.run for point in trend.lines[at].points]
    values = [breaks[0].step.before, *(b.step.after for b in breaks)]
    starts = [runs[0], *(b.run for b in breaks)]
    stops = [*(b.run for b in breaks), runs[-1] + 1]
    for i, (value, start, stop) in enumerate(zip(values, starts, stops, strict=True)):
        yield Series(
            label="" if i else "level",
            x=np.array([start + 0.5, stop + 0.5]),
            y=shown * np.array([value, value]),
            colour=COLOURS[1],
            line="-",
        )


def _note(trend: Trend, line: Line, i: int) -> str:
    point = line.points[i]
    origin = trend.origins[point.run]
    error = point.row.standard_error
    size = f"{number(point.value)} ± {number(error, 2)}"
    return f"{origin.words}: {size if error else number(point.value)}"


def _runs(trend: Trend) -> Table:
    rows = [
        (
            run + 1,
            origin.name,
            origin.commit,
            origin.committed[:10],
            origin.started[:10],
            ", ".join(map(str, origin.seeds)),
            *(trend.count(run, way) for way in WAYS),
            trend.within[run],
        )
        for run, origin in enumerate(trend.origins)
    ]
    return Table(
        name="runs",
        caption="How many statistics have a step at each run, and which way; how many "
        "moved within chance on the noise of the run before",
        columns=(
            Column("run", "number"),
            Column("folder", "code"),
            Column("commit", "code"),
            Column("of"),
            Column("made"),
            Column("seeds"),
            *(Column(way, "number") for way in WAYS),
            Column("within chance", "number"),
        ),
        rows=rows,
    )


def _lines(trend: Trend) -> Table:
    """First and last value of each statistic, and since when it is at its level."""
    since = {b.line: b for b in trend.breaks}  # the last one of each line
    rows = []
    for at, line in enumerate(trend.lines):
        first, last = line.points[0], line.points[-1]
        step = since.get(at)
        rows.append(
            (
                "" if step is None else WORDS[step.step.standing],
                "" if step is None else trend.origins[step.run].label,
                (first.value, first.row.standard_error),
                (last.value, last.row.standard_error),
                line.statistic.unit,
                str(line.statistic),
                line.cell,
                len(line.points),
            )
        )
    rows.sort(key=lambda row: not row[0])
    return Table(
        name="statistics",
        caption="Every statistic: its last step, its first and its last value",
        columns=(
            Column("last step", "answer"),
            Column("since", "code"),
            Column("first", "measured"),
            Column("last", "measured"),
            Column("unit", "unit"),
            Column("statistic"),
            Column("cell", "code"),
            Column("runs", "number"),
        ),
        rows=rows,
        shown=SHOWN,
        fold=f"Every statistic: {len(rows):,}" if rows else "",
    )


WORDS = {"worse": "worse", "better": "better", "neither": "moved"}


def values_table(trend: Trend) -> Table:
    """Make the tidy long table: a row for each statistic and run."""
    steps = {(b.line, b.run): b.step.standing for b in trend.breaks}
    rows = [
        (
            line.study,
            point.cell,
            str(line.statistic),
            line.statistic.unit,
            point.run + 1,
            trend.origins[point.run].name,
            trend.origins[point.run].commit,
            trend.origins[point.run].committed,
            trend.origins[point.run].started,
            (point.row.value, point.row.standard_error),
            point.row.n,
            WORDS.get(steps.get((at, point.run), ""), ""),
        )
        for at, line in enumerate(trend.lines)
        for point in line.points
    ]
    about = ("study", "cell", "statistic", "unit")
    names = (*about, "run", "folder", "commit", "committed", "started")
    return Table(
        name="series",
        caption="Every value of every run",
        columns=(
            *(Column(name) for name in names),
            Column("value", "measured"),
            Column("n", "number"),
            Column("step"),
        ),
        rows=rows,
    )
