"""The chapters of the page: its sections behind folds, under what they are about.

A chapter is open where a check of its studies fails or cannot be judged, and where it
says what was not measured; else its summary line says what it found.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from simval.report.section import Section
from simval.studies import STUDIES
from simval.verdict import WORST_FIRST, Answer, Verdict

GROUPS: Mapping[str, Mapping[str, str]] = {
    "Algorithms": {
        "algorithms": "Algorithms side by side",
        "overview": "Simulation beside theory",
    },
    "Needs attention": {
        "failures": "What was not measured",
        "disagreements": "Failing checks",
    },
    "Calibration": {
        "calibration": "Calibration error against noise",
        "poses": "Number and geometry of the poses",
        "ladder": "Bias ladder",
        "magnetometer": "Magnetometer",
        "gyroscope": "Gyroscope",
    },
    "Attitude": {
        "attitude": "Attitude error against noise",
        "orders": "Order of the attitude formulas",
        "geometries": "Attitude formulas over many geometries",
        "closeness": "Closeness to singularity",
        "ranges": "Range of each attitude formula",
        "vectors": "Weighted vectors",
        "estimators": "What an estimator costs",
        "budget": "Error budget",
    },
    "Filters": {"filters": "Attitude filters"},
    "Scenes and more": {
        "scene": "Scenes",
        "statics": "Static intervals",
        "convergence": "Convergence of the solvers",
        "other": "Further studies",
    },
    "Checks and numbers": {
        "statistics": "Efficiency, coverage and consistency",
        "checks": "Checks",
        "numbers": "All numbers",
        "provenance": "Provenance",
    },
}
"""Titles of the sections under each heading, by their anchors, in the page's order."""

ALWAYS_OPEN = ("failures", "disagreements")
WITHOUT_SECTION = "other"
"""Section of the studies that have none of their own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Chapter:
    """A section behind a fold."""

    section: Section
    finding: str  # what it found, or its first figure with a finding; may be empty
    mark: str  # how many of its checks are no pass, in words; empty where all are
    answer: Answer  # the worst of them
    open: bool

    @property
    def contents(self) -> str:
        """What is behind the fold, where no figure says what was found."""
        counts = (
            (len(self.section.drawings), "figure"),
            (len(self.section.tables), "table"),
        )
        return ", ".join(f"{n} {what}{'s' if n > 1 else ''}" for n, what in counts if n)


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Chapters about one thing."""

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
    """Sort sections into groups; those whose anchors are `opened` stand open."""
    judged: dict[str, list[Answer]] = {}
    for verdict in verdicts:
        judged.setdefault(home(verdict.cell.study), []).append(verdict.answer)
    opened = {*ALWAYS_OPEN, *opened}
    found = []
    for number, (title, anchors) in enumerate(GROUPS.items()):
        chapters = tuple(
            _chapter(
                section,
                judged.get(section.anchor, ()),
                everything or section.anchor in opened,
            )
            for section in sections
            if section.anchor in anchors
        )
        if chapters:
            found.append(Group(anchor=f"part-{number}", title=title, chapters=chapters))
    return tuple(found)


def home(study: str) -> str:
    """Anchor of the section that shows a study."""
    own = STUDIES[study].section if study in STUDIES else None
    return own or WITHOUT_SECTION


def _chapter(section: Section, answers: Sequence[Answer], opened: bool) -> Chapter:
    failed, unclear = answers.count("fail"), answers.count("inconclusive")
    parts = [
        f"{failed:,} check{'s fail' if failed > 1 else ' fails'}" if failed else "",
        f"{unclear:,} inconclusive" if unclear else "",
    ]
    findings = (drawing.finding for drawing in section.drawings if drawing.finding)
    worst: Answer = next((word for word in WORST_FIRST if word in answers), "pass")
    return Chapter(
        section=section,
        finding=str(section.values.get("found") or next(findings, "")),
        mark=", ".join(filter(None, parts)),
        answer=worst,
        open=opened or worst != "pass",
    )
