"""The page: the first screen, then the sections in order, each behind a fold."""

import re
from collections.abc import Container, Mapping
from dataclasses import replace
from types import ModuleType
from typing import Any

from simval.errors import InputError
from simval.judge import compare_runs, judge_run
from simval.report.answers import linked
from simval.report.answers_before import comparable
from simval.report.chapters import GROUPS, groups
from simval.report.declared import elsewhere, section_of
from simval.report.environment import template
from simval.report.notes import located
from simval.report.panels import Drawing
from simval.report.part import part_of
from simval.report.section import Against, Context, Section
from simval.report.sections import (
    algorithms,
    checks,
    disagreements,
    failures,
    filters,
    numbers,
    other,
    overview,
    provenance,
    scene,
    statistics,
    summary,
)
from simval.report.sections.algorithms import has_user_code
from simval.report.table import Table
from simval.studies import STUDIES
from simval.sweep import Run
from simval.verdict import ALPHA

OWN: Mapping[str, ModuleType] = {
    module.__name__.rpartition(".")[2]: module
    for module in (
        summary, algorithms, overview, failures, disagreements, filters, scene,
        other, statistics, checks, numbers, provenance,
    )
}  # fmt: skip
"""Sections that are more than what studies declare, by their anchors."""


def render(
    run: Run,
    alpha: float = ALPHA,
    *,
    baseline: Mapping[str, Any] | None = None,
    against: Run | None = None,
    opened: bool = False,
) -> str:
    """Render a run as one HTML page.

    Parameters
    ----------
    run : Run
        The run; cells that are missing or failed are shown as such.
    alpha : float, default ALPHA
        False-alarm rate that the sampling checks share.
    baseline : mapping, optional
        As from `simval.judge.read_baseline`: the page says what changed from it.
    against : Run, optional
        Another run: the page says what changed from it.
    opened : bool, default False
        Whether every fold stands open, as for print.

    Returns
    -------
    str
        The page; the same run gives the same bytes.

    Raises
    ------
    InputError
        If an artifact of the run is damaged.
    """
    context = context_of(run, alpha, baseline, against)
    shown = _sections(context)
    own = ("algorithms",) if has_user_code(context.run) else ()
    page = template("report").render(
        title=run.manifest["title"] or run.manifest["suite"],
        sections=shown,
        groups=groups(shown, context.verdicts, own, everything=opened),
        version=run.manifest["versions"]["simval"],
        source=f"the run folder {run.folder.name}",
    )
    return _unfolded(page) if opened else page


def context_of(
    run: Run,
    alpha: float = ALPHA,
    baseline: Mapping[str, Any] | None = None,
    against: Run | None = None,
) -> Context:
    """Judge a run once, beside all that it is to be compared with."""
    part = part_of(run)
    _require_parameters(part.run)
    names = dict.fromkeys((*STUDIES, *(cell.study for cell in part.run.cells)))
    stored = baseline if comparable(run, baseline) else None
    return Context(
        run=located(part.run),
        part=part,
        judged=judge_run(run, stored, alpha),
        titles={n: STUDIES[n].title if n in STUDIES else n for n in names},
        baseline=baseline,
        against=None
        if against is None
        else Against(run=against, changes=compare_runs(against, run, alpha)),
    )


def sections(run: Run, alpha: float = ALPHA) -> tuple[Section, ...]:
    """Make the sections of the page."""
    return _sections(context_of(run, alpha))


def _sections(context: Context) -> tuple[Section, ...]:
    titles = {"summary": "Verdict"}
    for group in GROUPS.values():
        titles |= group
    found = []
    for anchor, title in titles.items():
        own = OWN.get(anchor)
        section = (
            section_of(context, anchor, title) if own is None else own.section(context)
        )
        if section is not None:
            more = elsewhere(context, anchor, getattr(own, "SHOWN", ()))
            found.append(replace(section, elsewhere=more))
    anchors = {section.anchor for section in found}
    return tuple(_linked(section, anchors) for section in found)


def _linked(section: Section, anchors: Container[str]) -> Section:
    """The section, its answers linked only to what the page has."""
    blocks = section.values.get("answers")
    if not isinstance(blocks, tuple):
        return section
    answers = tuple(linked(block, anchors) for block in blocks)
    return replace(section, values={**section.values, "answers": answers})


def _unfolded(page: str) -> str:
    """The page with every fold open: what comes from data is escaped, so none is it."""

    def opened(match: re.Match[str]) -> str:
        return (
            match[0]
            if " open" in (match[1] or "")
            else f"<details{match[1] or ''} open>"
        )

    return re.sub(r"<details( [^>]*)?>", opened, page)


def _require_parameters(run: Run) -> None:
    """Refuse a run whose cells lack parameters that the sections read."""
    for cell in run.cells:
        if cell.study in STUDIES:
            known = STUDIES[cell.study].parameters.model_fields
            lost = [name for name in known if name not in cell.parameters]
            if lost:
                msg = (
                    f"cell {cell.name} has no parameter `{lost[0]}`, which its study "
                    "has now; make the report with the version of simval that ran it"
                )
                raise InputError(msg)


def drawings(run: Run) -> tuple[Drawing, ...]:
    """Every figure of the report.

    Parameters
    ----------
    run : Run
        The run.

    Returns
    -------
    tuple of Drawing
        Their names are unique.
    """
    return tuple(d for section in sections(run) for d in section.drawings)


def tables(run: Run) -> tuple[Table, ...]:
    """Every table of the report, whole.

    Parameters
    ----------
    run : Run
        The run.

    Returns
    -------
    tuple of Table
        Their names are unique.
    """
    return tuple(t for section in sections(run) for t in section.tables)
