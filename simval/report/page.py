"""The page of a run: the first screen, then folded chapters.

A chapter is a section under what it is about. It is open where a check of its studies
fails or cannot be judged, and where it says what was not measured; else its summary
line says what it found.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from simval.errors import InputError
from simval.judge import compare_runs, judge_run
from simval.report import algorithms, checks, pictures, record, study_sections, summary
from simval.report.algorithms import has_user_code
from simval.report.answers import comparable
from simval.report.panels import Drawing
from simval.report.section import (
    Against,
    Context,
    Section,
    home,
    located,
    part_of,
    template,
)
from simval.report.study_table import study_lines
from simval.report.table import Table
from simval.studies import STUDIES
from simval.sweep import Run
from simval.verdict import ALPHA, Answer, Verdict, worst

# ---- chapters


class Entry(NamedTuple):
    """An entry in the list of the page's sections."""

    title: str
    # makes it, or None where the run has nothing for it; without, what studies declare
    make: Callable[[Context], Section | None] | None = None


GROUPS: Mapping[str, Mapping[str, Entry]] = {
    "Algorithms": {
        "algorithms": Entry("Algorithms side by side", algorithms.algorithms_section),
        "overview": Entry("Simulation and theory", summary.overview_section),
    },
    "Needs attention": {
        "failures": Entry("What was not measured", record.failures_section),
        "disagreements": Entry("Failing checks", checks.disagreements_section),
    },
    "Calibration": {
        "calibration": Entry("Calibration error against noise"),
        "poses": Entry("Number and geometry of the poses"),
        "ladder": Entry("Bias ladder"),
        "magnetometer": Entry("Magnetometer"),
        "gyroscope": Entry("Gyroscope"),
    },
    "Attitude": {
        "attitude": Entry("Attitude error against noise"),
        "orders": Entry("Order of the attitude formulas"),
        "geometries": Entry("Attitude formulas over many geometries"),
        "closeness": Entry("Closeness to singularity"),
        "singular": Entry("Singular cases and their remedies"),
        "ranges": Entry("Range of each attitude formula"),
        "vectors": Entry("Weighted vectors"),
        "estimators": Entry("What an estimator costs"),
        "budget": Entry("Error budget"),
    },
    "Filters": {
        "filters": Entry("Attitude filters", pictures.filters_section),
        "settings": Entry("Settings of a filter"),
    },
    "Scenes and more": {
        "scene": Entry("Scenes", pictures.scene_section),
        "statics": Entry("Static intervals"),
        "diagnosis": Entry("What is wrong with a log"),
        "audit": Entry("What is wrong with a simulator"),
        "convergence": Entry("Convergence of the solvers"),
        "other": Entry("Further studies", study_sections.other_section),
    },
    "Checks and numbers": {
        "statistics": Entry(
            "Efficiency, coverage and consistency", study_sections.statistics_section
        ),
        "checks": Entry("Checks", checks.checks_section),
        "numbers": Entry("All numbers", record.numbers_section),
        "provenance": Entry("Provenance", record.provenance_section),
    },
}
"""Sections under each heading, by their anchors, in the page's order."""

ALWAYS_OPEN = ("failures", "disagreements")


@dataclass(frozen=True, slots=True, kw_only=True)
class Chapter:
    """A section with a fold of its own."""

    section: Section
    mark: str  # how many of its checks do not pass, in words; empty if all pass
    answer: Answer  # the worst of them
    open: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Chapters on one subject."""

    anchor: str  # its id on the page
    title: str
    chapters: tuple[Chapter, ...]


def groups(
    sections: Sequence[Section],
    verdicts: Iterable[Verdict],
    opened: Iterable[str] = (),
    *,
    everything: bool = False,
) -> tuple[Group, ...]:
    """Sort sections into groups; those whose anchors are `opened` are unfolded."""
    judged: dict[str, list[Answer]] = {}
    for verdict in verdicts:
        judged.setdefault(home(verdict.cell.study), []).append(verdict.answer)
    opened = {*ALWAYS_OPEN, *opened}
    found = []
    for number, (title, anchors) in enumerate(GROUPS.items()):
        chapters = tuple(
            _chapter(s, judged.get(s.anchor, ()), everything or s.anchor in opened)
            for s in sections
            if s.anchor in anchors
        )
        if chapters:
            found.append(Group(anchor=f"part-{number}", title=title, chapters=chapters))
    return tuple(found)


def _chapter(section: Section, answers: Sequence[Answer], opened: bool) -> Chapter:
    failed, unclear = answers.count("fail"), answers.count("inconclusive")
    parts = [
        f"{failed:,} check{'s fail' if failed > 1 else ' fails'}" if failed else "",
        f"{unclear:,} inconclusive" if unclear else "",
    ]
    return Chapter(
        section=section,
        mark=", ".join(filter(None, parts)),
        answer=worst(answers),
        open=opened or worst(answers) != "pass",
    )


# ---- page


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
        studies=study_lines(
            context, shown, {title: list(each) for title, each in GROUPS.items()}
        ),
        line=summary.source_line(context),
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
    """Judge a run once, with everything that it is compared with."""
    part = part_of(run)
    _require_parameters(part.run)
    stored = baseline if comparable(run, baseline) else None
    return Context(
        run=located(part.run),
        part=part,
        judged=judge_run(run, stored, alpha),
        baseline=baseline,
        against=None
        if against is None
        else Against(run=against, changes=compare_runs(against, run, alpha)),
    )


def sections(run: Run, alpha: float = ALPHA) -> tuple[Section, ...]:
    """Make the sections of the page."""
    return _sections(context_of(run, alpha))


def _sections(context: Context) -> tuple[Section, ...]:
    entries = {"summary": Entry("Verdict", summary.summary_section)}
    for group in GROUPS.values():
        entries |= group
    found = []
    for anchor, (title, make) in entries.items():
        section = (
            study_sections.section_of(context, anchor)
            if make is None
            else make(context)
        )
        if section is not None:
            also = study_sections.SHOWN if anchor == "statistics" else ()
            more = study_sections.elsewhere(context, anchor, also)
            found.append(replace(section.under(anchor, title), elsewhere=more))
    return tuple(found)


def _unfolded(page: str) -> str:
    """The page with every fold open."""

    def opened(match: re.Match[str]) -> str:
        return (
            match[0]
            if " open" in (match[1] or "")
            else f"<details{match[1] or ''} open>"
        )

    return re.sub(r"<details( [^>]*)?>", opened, page)


def _require_parameters(run: Run) -> None:
    """Refuse a run whose cells lack parameters that the page needs."""
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
    """Every figure of the page.

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
    """Every table of the page, with all rows.

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
