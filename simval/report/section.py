"""A section of the page, and what it is made from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from simval.judge import GateResult, RunComparison
from simval.report.environment import template
from simval.report.notes import folder_of
from simval.report.panels import Drawing
from simval.report.part import Part
from simval.report.table import Table
from simval.sweep import Run
from simval.sweep.run import CellResult
from simval.verdict import Verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Against:
    """Another run, and what is different in the one that is shown."""

    run: Run
    changes: RunComparison


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """What every section may read."""

    run: Run  # the run folder's content
    judged: GateResult  # what the gate says of it, or of all of it
    titles: Mapping[str, str]  # title of each study, by its name
    # what the page is asked to compare the run with, if anything
    baseline: Mapping[str, Any] | None = None
    against: Against | None = None
    part: Part | None = None  # which cells of a large run these are

    @property
    def folder(self) -> str:
        """The run for a command."""
        return folder_of(self.run)

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Checks against theory; of a large run those of its part, and all failures."""
        if self.part is None or not self.part.names:
            return self.judged.verdicts
        return tuple(
            v
            for v in self.judged.verdicts
            if v.answer != "pass" or v.cell.name in {"", *self.part.names}
        )

    @property
    def alpha(self) -> float:
        """False-alarm rate that they share."""
        return self.judged.alpha

    def cells(self, study: str) -> tuple[CellResult, ...]:
        """Finished cells of one study that left rows."""
        return tuple(cell for cell in self.run.of(study) if cell.rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A part of the page."""

    anchor: str  # its id on the page
    title: str
    drawings: tuple[Drawing, ...]
    tables: tuple[Table, ...]
    values: Mapping[str, object]  # what else its template reads
    # statistics of its study that it shows in no figure and no table of its own
    elsewhere: tuple[str, ...] = ()

    @property
    def body(self) -> Markup:
        """The part, drawn: its own template, else its figures and tables in order."""
        text = template(self.anchor, "plain").render(
            drawings=self.drawings,
            tables=self.tables,
            **{"about": "", **self.values},
        )
        return Markup(text)  # escaped within the template


def made(
    anchor: str,
    title: str,
    drawings: Sequence[Drawing] = (),
    tables: Sequence[Table] = (),
    **values: object,
) -> Section:
    """Make a section; nothing is drawn before its `body` is read."""
    return Section(
        anchor=anchor,
        title=title,
        drawings=tuple(drawings),
        tables=tuple(tables),
        values=values,
    )
