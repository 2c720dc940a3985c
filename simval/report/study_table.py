"""Table of studies: the answer of each, its number, and its closest check."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

from simval.report.algorithms import lines_of_algorithms
from simval.report.answers import Line, closest, in_order, not_passed
from simval.report.findings import Claim
from simval.report.formatting import begun, spelled
from simval.report.section import WITHOUT_SECTION, Context, Section, home
from simval.report.summary import Reading, readings
from simval.studies import STUDIES
from simval.sweep.run import CellResult
from simval.verdict import Verdict, worst


def study_lines(
    context: Context, sections: Sequence[Section], groups: Mapping[str, Sequence[str]]
) -> list[tuple[str, list[Line]]]:
    """A line for each study or section, under the headings of the page."""
    told, of = readings(context), dict[str, list[Verdict]]()
    for verdict in context.verdicts:
        of.setdefault(verdict.cell.study, []).append(verdict)
    homes: dict[str, list[str]] = {}
    for study in in_order([cell.study for cell in context.run.cells]):
        homes.setdefault(home(study), []).append(study)
    by_anchor = {section.anchor: section for section in sections}
    found = []
    for title, anchors in groups.items():
        lines = [
            line
            for section in (by_anchor[a] for a in anchors if a in by_anchor)
            for line in _lines(
                section, homes.pop(section.anchor, []), context, told, of
            )
        ]
        if lines:
            found.append((title, lines))
    lost = [study for studies in homes.values() for study in studies]
    if lost:
        found.append(("Not measured", [_lost(context, study) for study in lost]))
    return found


def _lines(
    section: Section,
    studies: Sequence[str],
    context: Context,
    told: Mapping[str, tuple[CellResult, Reading]],
    of: Mapping[str, Sequence[Verdict]],
) -> list[Line]:
    """Lines of a section: its studies, its algorithms, or whatever it shows."""
    if studies and section.anchor == "algorithms":
        return lines_of_algorithms(context)
    shown = studies or [""] * _is_shown(section, context)
    return [_line(_only(section, study, studies), study, told, of) for study in shown]


def _only(section: Section, study: str, studies: Sequence[str]) -> Section:
    """A section for one of its studies; all but the first get it without figures."""
    if study in ("", *studies[:1]) and section.anchor != WITHOUT_SECTION:
        return section
    return replace(section, title=_title(study), drawings=())


def _title(study: str) -> str:
    return begun(spelled(study))


def _is_shown(section: Section, context: Context) -> bool:
    """True for a section of figures whose studies have sections of their own."""
    return any(
        each.section == section.anchor and context.cells(name)
        for name, study in STUDIES.items()
        for each in study.shown
    )


def _line(
    section: Section,
    study: str,
    told: Mapping[str, tuple[CellResult, Reading]],
    of: Mapping[str, Sequence[Verdict]],
) -> Line:
    """Line of a study, with the words of its section's first figure."""
    verdicts = of.get(study, ())
    drawings = [each for each in section.drawings if each.finding]
    differ = [
        d
        for d in drawings
        if any(isinstance(c, Claim) and c.found.off for c in d.claims)
    ]
    said = [brief(each.finding) for each in (*differ, *drawings)]
    if study in told:
        said.append(f"{begun(told[study][1].said)}.")
    share, checks = closest(verdicts) if study else (None, "")
    return Line(
        what=section.title,
        said=next(filter(None, (not_passed(verdicts), *said)), ""),
        number=told[study][1].ratio if study in told else None,
        link=section.anchor,
        answer=worst(v.answer for v in verdicts),
        share=share,
        checks=checks,
    )


def brief(finding: str) -> str:
    """First sentence of a finding, without the value that is farthest off."""
    first = re.split(r"(?<=[a-z0-9%)]\.) (?=[A-Z])", finding)[0]
    return re.sub(r" \(most: [^()]*\)", "", first)


def _lost(context: Context, study: str) -> Line:
    """Line of a study without a result."""
    endings = dict.fromkeys(c.ending for c in context.run.cells if c.study == study)
    words = {"pending": "never run", "done": "without numbers", "pass": "not shown"}
    why_not = ", ".join(words.get(each, each) for each in endings)
    return Line(what=_title(study), said=f"{begun(why_not)}.", answer="inconclusive")
