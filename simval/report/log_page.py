"""Page of one log: answers, then figures and tables, then how it was made.

A calibration, filters and the noise of a log are such pages. Each kind states its
answers, figures and tables; this module is the page around them.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np

from simval import __version__
from simval.account import Account, Note, Quantity, Values
from simval.account.terminal import MARKS
from simval.arrays import Array
from simval.files import digest
from simval.imu.logs import Log
from simval.report.formatting import begun, slug
from simval.report.panels import AREA, COLOURS, Panel, Series
from simval.report.section import Section, made, template
from simval.report.table import Column, Table
from simval.shapes import Float

DIGITS = (
    Column("quantity"),
    Column("name", "code"),
    Column("unit", "unit"),
    Column("value", "number", 8),
    Column("standard deviation u", "number", 3),
    Column("expanded U = k u", "number", 3),
    Column("95 % from", "number", 8),
    Column("to", "number", 8),
    Column("least possible standard deviation", "number", 3),
)
"""Columns of a table with every digit, as the terminal's with --verbose."""
FOLDERS = re.compile(r"(?<![\w)\].])(?:/[^/\s:,;]+)+/")
"""The folders of a path in a sentence; the slashes of a unit follow its letters."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LogPage:
    """Contents of the page of a log."""

    account: Account  # answers, values, and what was read and how
    log: Log
    chapters: Sequence[Section] = ()  # figures
    command: str = ""  # makes the page again; empty leaves it out

    @property
    def name(self) -> str:
        """Name of the log's file alone, as pages are shared."""
        return PurePath(self.log.path).name

    @property
    def sections(self) -> tuple[Section, ...]:
        """The sections: answers, chapters, and where the numbers come from."""
        account = self.account
        facts = (
            ("Log", self.name),
            ("SHA-256", digest(self.log.path)),
            *((begun(x.label), FOLDERS.sub("", x.words)) for x in account.record),
            ("simval", __version__),
        )
        rests = [
            Note(words=f"How the values of {each.title} were found", lines=lines)
            for each in account.values
            if not each.folded
            and (lines := [f"{label}: {words}" for label, words, _ in each.facts])
        ]
        first = made(
            tables=[table for each in account.values for table in tables_of(each)],
            replies=account.replies,
            warnings=account.warnings,
            notes=[*rests, *account.notes],
        ).under("result", "Result")
        source = made(
            facts=[(name, value) for name, value in facts if value],
            command=self.command,
            said="\n".join(
                FOLDERS.sub("", f"{label:<18}{words}" if label else words)
                for label, words, _ in account.facts
            ),
        ).under("source", "Where these numbers are from")
        return first, *self.chapters, source


def tables_of(values: Values) -> Iterator[Table]:
    """Tables of the values, and folded behind them all their digits.

    Those that a terminal shows on request have their facts as a column, or a fold.
    """
    if not values.lines:
        return
    said = {label: words for label, words, _ in values.facts if values.folded}
    name, caption = slug(values.title), f"{values.title}: {values.how}".rstrip(": ")
    most = max(len(line.cells) for line in values.lines)
    heads = values.heads if most > 1 else ("value",)
    yield Table(
        name=name,
        caption=caption,
        columns=[
            Column("quantity"), *(Column(head, "quantity") for head in heads),
            *[Column("how")] * bool(said),
        ],
        rows=[
            (line.head, *zip(line.shown(MARKS), map(_size, line.cells), strict=True),
             *[None] * (len(heads) - len(line.cells)),
             *[said.get(line.label, "")] * bool(said))
            for line in values.lines
        ],
        fold=caption if values.folded and not said else "",
    )  # fmt: skip
    if values.folded:
        return
    yield Table(
        name=f"{name}-digits",
        caption=f"{values.title}, with intervals",
        columns=DIGITS,
        rows=[
            (line.label, x.name, line.unit, x.value, x.sd,
             *map(_finite, (0.5 * (x.high - x.low), x.low, x.high)), x.least)
            for line in values.lines
            for x in (cell.times(line.factor) for cell in line.cells)
        ],
        fold=f"{values.title}: every digit, with intervals",
    )  # fmt: skip


def _size(each: Quantity) -> float:
    # by which a column is sorted
    return each.high if each.value is None else each.value


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def render_log(page: LogPage) -> str:
    """Render the page of a log as HTML; the same page gives the same bytes."""
    return template("page").render(
        title=page.account.name,
        sections=page.sections,
        version=__version__,
        source=f"the log {page.name}",
    )


def linear(
    title: str, x_label: str, y_label: str, series: Sequence[Series], **more: Any
) -> Panel:
    """A panel with linear axes."""
    return Panel(
        title=title,
        x_label=x_label,
        y_label=y_label,
        series=series,
        log_x=False,
        **{"log_y": False, **more},
    )


def signal(
    time: Float[Array, " n"],
    values: Float[Array, " n"],
    label: str = "",
    colour: str = COLOURS[0],
) -> Series:
    """A signal over time as a line."""
    return Series(label=label, x=time, y=values, colour=colour, line="-")


def stated(
    time: Float[Array, " n"],
    low: Float[Array, " n"] | float,
    high: Float[Array, " n"],
    label: str,
) -> Series:
    """A band that is stated for a signal over time, as an area."""
    middle, half = (high + low) / 2.0, (high - low) / 2.0
    return Series(label=label, x=time, y=middle, band=half, line=AREA)


def numbered(
    values: Float[Array, " n"],
    marked: Sequence[int],
    label: str,
    places: Float[Array, " n"] | None = None,
) -> list[Series]:
    """Points in order or at given places, some of them marked with a label."""
    order = np.arange(float(len(values)))
    odd = np.isin(order, marked)
    places = order if places is None else places
    series = [
        Series(
            label="as the others" if odd.any() else "", x=places[~odd], y=values[~odd]
        )
    ]
    if odd.any():
        x, y = places[odd], values[odd]
        series.append(Series(label=label, x=x, y=y, colour=COLOURS[1], marker="D"))
    return series
