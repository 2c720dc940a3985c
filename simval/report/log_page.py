"""The page of one log: three answers, then figures and tables, then its source.

A calibration, filters and the noise of a log are such pages. Each kind states its
answers, figures and tables; this module is the page around them.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np

from simval import __version__
from simval.account import Account, Note
from simval.arrays import Array
from simval.files import digest
from simval.imu.logs import Log
from simval.report.panels import COLOURS, Panel, Series
from simval.report.section import Section, made, template
from simval.report.table import Table
from simval.shapes import Float

FOLDERS = re.compile(r"(?<![\w)\].])(?:/[^/\s:,;]+)+/")
"""The folders of a path in a sentence; the slashes of a unit follow its letters."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LogPage:
    """Contents of the page of a log."""

    account: Account  # answers, and what was read and how
    log: Log
    tables: Sequence[Table]  # of the first section, below the answers
    notes: Sequence[Note] = ()  # below these
    chapters: Sequence[Section] = ()  # figures and tables
    command: str = ""  # makes the page again; empty leaves it out

    @property
    def name(self) -> str:
        """Name of the log's file: pages are shared, so they never show where it is."""
        return PurePath(self.log.path).name

    @property
    def sections(self) -> tuple[Section, ...]:
        """Answers, chapters, and where the numbers are from."""
        facts = (
            ("Log", self.name),
            ("SHA-256", digest(self.log.path)),
            ("simval", __version__),
        )
        first = made(
            tables=self.tables,
            replies=self.account.replies,
            warnings=self.account.warnings,
            notes=self.notes,
        ).under("result", "Result")
        source = made(
            facts=[(name, value) for name, value in facts if value],
            command=self.command,
            said="\n".join(
                FOLDERS.sub("", f"{label:<18}{words}" if label else words)
                for label, words, _ in self.account.facts
            ),
        ).under("source", "Where these numbers are from")
        return first, *self.chapters, source


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
    """A panel over time or a count."""
    return Panel(
        title=title,
        x_label=x_label,
        y_label=y_label,
        series=series,
        log_x=False,
        **{"log_y": False, **more},
    )


def signal(
    time: Float[Array, " n"], values: Float[Array, " n"], colour: str, label: str = ""
) -> Series:
    """A signal over time as a line."""
    return Series(label=label, x=time, y=values, colour=colour, line="-")


def numbered(
    values: Float[Array, " n"],
    marked: Sequence[int],
    label: str,
    places: Float[Array, " n"] | None = None,
) -> list[Series]:
    """Points in their order, or at some places, some marked under a label."""
    order = np.arange(float(len(values)))
    odd = np.isin(order, marked)
    places = order if places is None else places
    series = [Series(label="", x=places[~odd], y=values[~odd])]
    if odd.any():
        x, y = places[odd], values[odd]
        series.append(Series(label=label, x=x, y=y, colour=COLOURS[1], marker="D"))
    return series
