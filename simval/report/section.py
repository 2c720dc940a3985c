"""A section of the page: what it reads, what it contains, how it is written.

Everything that comes from data is escaped in the templates.

A page has figures and tables of some thousand points, and its reader no more eyes than
that. Of a run of up to `LARGE` rows all cells are shown. Of a larger one, of each
study: the axis with the most values, seeds among them, keeps every second one, again
and again, until the rows fit. So a curve that is drawn has all of its points, on fewer
noise levels, geometries or seeds. The verdict stays that of all cells.
"""

import hashlib
import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from math import prod
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup, escape

from simval.judge import GateResult, RunComparison
from simval.report.interactivity import silent
from simval.report.paint import sample, shown
from simval.report.panels import DARK, MANY, Drawing
from simval.report.table import Table, sort_key, text
from simval.spelling import measured
from simval.studies import STUDIES
from simval.studies.study import canonical
from simval.sweep import Run
from simval.sweep.run import CellResult
from simval.verdict import Verdict

# ---- templates

SCRIPTS = (
    *("sort.js", "points.js", "legends.js", "filter.js", "folds.js"),
    *("files.js", "zoom.js"),
)
"""Files of the page's script, one after the other."""

NAMED = 100
"""What a figure leaves out is named one by one up to this many, the rest counted."""

PRINTED = 40
"""Rows of the longest table that is printed though it is folded."""


def template(*names: str) -> Template:
    """Load the first of these templates that exists."""
    return _environment().select_template([f"{name}.html.j2" for name in names])


def whole(words: str) -> Markup:
    """Keep ``a ± b`` and names of options from being broken across lines."""
    kept = r'<span class="whole">\g<0></span>'
    return Markup(re.sub(r"--[a-z][a-z-]*|\S+ ± \S+", kept, str(escape(words))))


def script() -> dict[str, Any]:
    """The page's script, and its hash for the content security policy."""
    folder = resources.files("simval.report") / "templates"
    parts = [(folder / name).read_text(encoding="utf-8") for name in SCRIPTS]
    content = "\n".join(['"use strict";', *parts])
    digest = b64encode(hashlib.sha256(content.encode()).digest()).decode()
    return {"text": Markup(content), "digest": digest}


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("simval.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals.update(NAMED=NAMED, PRINTED=PRINTED, MANY=MANY, silent=silent)
    environment.globals.update(
        measured=measured, text=text, sort_key=sort_key, script=script, DARK=DARK
    )
    environment.globals.update(laid_out=shown, sample=sample)
    environment.filters["whole"] = whole
    return environment


# ---- how a command names a run


def folder_of(run: Run) -> str:
    """The run as a command names it: a path below the working folder, or its name.

    Pages are shared, so they never show where on a machine a run is.
    """
    path, here = run.folder.absolute(), Path.cwd()
    inside = path != here and path.is_relative_to(here)
    return str(path.relative_to(here)) if inside else path.resolve().name


def located(run: Run) -> Run:
    """Tell a run's cells how a command names the run."""
    folder = folder_of(run)
    return replace(run, cells=tuple(replace(cell, run=folder) for cell in run.cells))


# ---- the part of a large run

LARGE = 100_000
"""Rows above which a run is large. Chosen: the accuracy suite has 6 000."""
ROWS = LARGE // 2
"""Rows of a large run that a page is made of."""

Axes = Mapping[str, Sequence[str]]
"""Values of each parameter of a study, spelled, in the order in which they come."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """The cells of a large run that a page shows."""

    run: Run  # with these cells alone
    names: frozenset[str] = frozenset()  # of the cells, where they are not all
    said: str = ""  # which they are; empty where they are all


def part_of(run: Run) -> Part:
    """Choose the cells of a run that a page shows."""
    cells = run.cells
    rows = sum(len(cell.rows) for cell in cells)
    if rows <= LARGE:
        return Part(run=run)
    grids, counts = _grids(cells)
    room = ROWS * len(cells) // rows // max(len(grids), 1)
    kept = {study: thinned(axes, counts[study], room) for study, axes in grids.items()}
    places = [
        place
        for place, cell in enumerate(cells)
        if all(value in kept[cell.study][key] for key, value in _values(cell))
    ]
    chosen = tuple(cells[place] for place in places)
    names = frozenset(cell.name for cell in chosen)
    said = (
        f"The verdict is of all {len(cells):,} cells. Figures and tables are of "
        f"{len(chosen):,} of them, a coarser grid ({_words(grids, kept)}), and of "
        "checks that did not pass."
    )
    shown = replace(run, cells=chosen)
    return Part(run=shown, names=names, said=said)


def thinned(axes: Axes, count: int, room: int) -> dict[str, frozenset[str]]:
    """Choose values of each axis so that about `room` of `count` cells remain."""
    kept = {key: list(values) for key, values in axes.items()}
    whole = prod(map(len, axes.values()))
    while count * prod(map(len, kept.values())) > room * whole:
        longest = max(kept, key=lambda key: len(kept[key]))
        if len(kept[longest]) == 1:
            break
        kept[longest] = kept[longest][::2]
    return {key: frozenset(values) for key, values in kept.items()}


def _grids(cells: Sequence[CellResult]) -> tuple[dict[str, Axes], dict[str, int]]:
    """The axes of each study, and the number of its cells."""
    found: dict[str, dict[str, dict[str, None]]] = {}
    counts: dict[str, int] = {}
    for cell in cells:
        counts[cell.study] = counts.get(cell.study, 0) + 1
        own = found.setdefault(cell.study, {})
        for key, value in _values(cell):
            own.setdefault(key, {})[value] = None
    axes = {
        study: {key: list(values) for key, values in own.items()}
        for study, own in found.items()
    }
    return dict(axes), counts


def _values(cell: CellResult) -> list[tuple[str, str]]:
    named: dict[str, Any] = {**cell.parameters, "seed": cell.seed}
    return [(key, canonical(value)) for key, value in named.items()]


def _words(
    grids: Mapping[str, Axes], kept: Mapping[str, Mapping[str, frozenset[str]]]
) -> str:
    """Say how many values of each parameter are shown, study by study."""
    parts = []
    for study, axes in grids.items():
        fewer = [
            f"{len(kept[study][key])} of {len(values)} values of {key}"
            for key, values in axes.items()
            if len(kept[study][key]) < len(values)
        ]
        parts.append(f"{study}: {', '.join(fewer) or 'all'}")
    return "; ".join(parts)


# ---- sections

WITHOUT_SECTION = "other"
"""Section of the studies that have none of their own."""


def home(study: str) -> str:
    """Anchor of the section that shows a study."""
    own = STUDIES[study].section if study in STUDIES else None
    return own or WITHOUT_SECTION


@dataclass(frozen=True, slots=True, kw_only=True)
class Against:
    """Another run to compare with, and how the run shown differs from it."""

    run: Run
    changes: RunComparison


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """What every section reads: the run, its judgement and its comparisons."""

    run: Run  # the run folder's content
    judged: GateResult  # what the gate says of it, or of all of it
    # what the page is asked to compare the run with, if anything
    baseline: Mapping[str, Any] | None = None
    against: Against | None = None
    part: Part | None = None  # which cells of a large run these are

    @property
    def folder(self) -> str:
        """The run as a command names it."""
        return folder_of(self.run)

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """The verdicts shown; for a large run those of its part, and all failures."""
        if self.part is None or not self.part.names:
            return self.judged.verdicts
        return tuple(
            v
            for v in self.judged.verdicts
            if v.answer != "pass" or v.cell.name in {"", *self.part.names}
        )

    @property
    def alpha(self) -> float:
        """False-alarm rate of all verdicts together."""
        return self.judged.alpha

    def cells(self, study: str) -> tuple[CellResult, ...]:
        """Finished cells of one study that have rows."""
        return tuple(cell for cell in self.run.of(study) if cell.rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A section of the page."""

    drawings: tuple[Drawing, ...]
    tables: tuple[Table, ...]
    values: Mapping[str, object]  # what else its template reads
    anchor: str = ""  # its id on the page
    title: str = ""
    # statistics of its study that it shows in no figure and no table of its own
    elsewhere: tuple[str, ...] = ()

    def under(self, anchor: str, title: str) -> "Section":
        """The section with its anchor and title."""
        return replace(self, anchor=anchor, title=title)

    @property
    def body(self) -> Markup:
        """The section in HTML, by its own template or as figures and tables."""
        text = template(self.anchor, "plain").render(
            drawings=self.drawings,
            tables=self.tables,
            **{"about": "", **self.values},
        )
        return Markup(text)  # escaped within the template


def made(
    drawings: Sequence[Drawing] = (), tables: Sequence[Table] = (), **values: object
) -> Section:
    """Make a section, whose figures are drawn only when its `body` is read."""
    return Section(drawings=tuple(drawings), tables=tuple(tables), values=values)
