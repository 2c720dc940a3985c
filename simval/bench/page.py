"""The page of many runs of the races: their ratios over commits, and the steps."""

from collections.abc import Iterator, Sequence
from importlib.metadata import version

import numpy as np

from simval.bench.history import Line, Step, lines_of, steps_of
from simval.bench.record import Kept, Record
from simval.report.environment import template
from simval.report.panels import COLOURS, GREY, Drawing, Panel, Series
from simval.report.section import Section, made
from simval.report.table import Column, Table
from simval.report.words import number, slug


def render_history(
    records: Sequence[Record], name: str, races: Sequence[str] = ()
) -> str:
    """Render runs of the races as one HTML page; the same runs give the same bytes."""
    return template("page").render(
        title=f"{name}: {len(records)} runs of the races",
        sections=_sections(records, races),
        version=version("simval"),
        source=f"the JSON files in {name}",
    )


def told(step: Step, records: Sequence[Record]) -> str:
    """A step as a sentence."""
    line, since = step.line, records[step.since]
    before = next(records[at] for at, kept in line.points if kept is step.before)
    ratios = " to ".join(
        f"{k.ratio:.3g} ({_ends(k)})" for k in (step.before, step.after)
    )
    changed = "slower" if step.time > 1.0 else "faster"
    differs = [
        f"{what} {a or 'unknown'} before and {b or 'unknown'} since"
        for what, a, b in (
            ("processor", before.processor, since.processor),
            ("Monte Carlo block", before.block, since.block),
        )
        if a != b
    ]
    more = f"; {', '.join(differs)}" if differs else ""
    return (
        f"{line.race}, {line.contender}: {changed} since {since.label}, "
        f"{step.time:.2f} times the time: ratio {ratios}{more}"
    )


def _ends(kept: Kept) -> str:
    return f"{kept.low:.3g} to {kept.high:.3g}"


def _sections(records: Sequence[Record], races: Sequence[str]) -> tuple[Section, ...]:
    lines = lines_of(records, races)
    steps = [step for line in lines for step in steps_of(line)]
    return (
        made(
            "races",
            "Ratios over commits",
            list(_drawings(records, lines, steps)),
            [_steps(records, steps)],
            steps=len(steps),
            lines=len(lines),
            runs=len(records),
        ),
        made("runs", "The runs", tables=[_runs(records)]),
        made("rates", "Every rate", tables=[_rates(records, lines)]),
    )


def _drawings(
    records: Sequence[Record], lines: Sequence[Line], steps: Sequence[Step]
) -> Iterator[Drawing]:
    """A figure for each race and reference, those with a step first and open."""
    groups: dict[tuple[str, str], list[Line]] = {}
    for line in lines:
        groups.setdefault((line.race, line.reference), []).append(line)
    names: set[str] = set()
    for (race, reference), some in sorted(
        groups.items(), key=lambda item: not _of(steps, item[1])
    ):
        found = _of(steps, some)
        name = slug(race) or "race"
        name = name if name not in names else f"{name}-{len(names)}"
        names.add(name)
        sentences = [told(step, records) for step in found]
        finding = f"{sentences[-1]}." if sentences else ""
        yield Drawing(
            name=name,
            asked=f"How did the race {race} change?",
            finding=finding or "No ratio left its level.",
            fold="" if found else f"{race}: no step",
            caption=(
                f"Rate divided by that of the reference ({reference}), over the runs "
                "by their number in the table of runs. Bars: intervals of the median "
                "over the rounds."
            ),
            alternative=f"Ratios of {len(some)} contenders over {len(records)} runs. "
            f"{finding or 'No ratio left its level.'}",
            panels=[_panel(records, line) for line in some],
        )


def _of(steps: Sequence[Step], lines: Sequence[Line]) -> list[Step]:
    return [step for step in steps if step.line in lines]


def _panel(records: Sequence[Record], line: Line) -> Panel:
    kept = [point for _, point in line.points]
    x = np.array([place + 1.0 for place, _ in line.points])
    bars = [
        Series(
            label="",
            x=np.array([at, at]),
            y=np.array([point.low, point.high]),
            colour=GREY,
            line="-",
        )
        for at, point in zip(x, kept, strict=True)
    ]
    points = Series(
        label="",
        x=x,
        y=np.array([point.ratio for point in kept]),
        colour=COLOURS[0],
        notes=[
            f"{records[place].label}: {point.ratio:.3g} ({_ends(point)}), "
            f"{number(point.rate, 3)} {point.item}/s"
            for place, point in line.points
        ],
    )
    top = max(point.high for point in kept)
    return Panel(
        title=line.contender,
        x_label="run, in order",
        y_label="ratio",
        series=(*bars, points),
        log_x=False,
        log_y=False,
        limits=(0.0, 1.1 * top),
    )


def _steps(records: Sequence[Record], steps: Sequence[Step]) -> Table:
    return Table(
        name="steps",
        caption="Ratios whose intervals have nothing in common with those of the run "
        "where their level began",
        columns=(
            Column("race"),
            Column("contender"),
            Column("which way", "answer"),
            Column("since", "code"),
            Column("time, in that before", "number", 3),
            Column("ratio before", "number", 3),
            Column("ratio after", "number", 3),
            Column("processor", choice=False),
        ),
        rows=[
            (
                step.line.race,
                step.line.contender,
                "worse" if step.time > 1.0 else "better",
                records[step.since].label,
                step.time,
                step.before.ratio,
                step.after.ratio,
                records[step.since].processor,
            )
            for step in steps
        ],
    )


def _runs(records: Sequence[Record]) -> Table:
    return Table(
        name="runs",
        caption="The runs in the order of their commits",
        columns=(
            Column("run", "number"),
            Column("file", "code"),
            Column("commit", "code"),
            Column("of"),
            Column("processor"),
            Column("Monte Carlo block"),
            Column("contenders", "number"),
            Column("rounds", "number"),
        ),
        rows=[
            (
                place + 1,
                record.name,
                record.label,
                record.committed[:10],
                record.processor,
                record.block,
                len(record.kept),
                min((kept.rounds for kept in record.kept), default=0),
            )
            for place, record in enumerate(records)
        ],
    )


def _rates(records: Sequence[Record], lines: Sequence[Line]) -> Table:
    rows = [
        (
            line.race,
            line.contender,
            place + 1,
            records[place].label,
            kept.ratio,
            kept.low,
            kept.high,
            kept.rate,
            f"{kept.item}/s",
            f"{kept.clock} time",
            kept.other,
        )
        for line in lines
        for place, kept in line.points
    ]
    return Table(
        name="every-rate",
        caption="Ratios with their intervals; a rate is that of its machine and of "
        "what else ran on it",
        columns=(
            Column("race"),
            Column("contender"),
            Column("run", "number"),
            Column("commit", "code"),
            Column("ratio", "number", 3),
            Column("from", "number", 3),
            Column("to", "number", 3),
            Column("rate", "number", 3),
            Column("unit", "unit"),
            Column("clock"),
            Column("other work"),
        ),
        rows=rows,
        fold=f"Every rate: {len(rows):,}" if rows else "",
    )
