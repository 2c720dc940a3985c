"""The three answers of the first screen as data: lines of a number and its unit.

`answers_wrong`, `answers_theory` and `answers_before` make them from the rows.
"""

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

from simval.report.words import spelled
from simval.units import COUNT, DEGREE, MILLIRADIAN, Unit
from simval.verdict import Answer

SHOWN = 3
"""Lines of an answer that stand outside its fold."""

IMPORTANCE = (
    "calibration",
    "attitude",
    "filter",
    "estimator",
    "calibrator",
    "magnetometer",
    "gyroscope",
    "end_to_end",
    "detector",
    "coverage",
    "noise_model",
    "attitude_vectors",
    "ladder",
)
"""Studies in the order in which a reader asks for them; the others follow."""

LEAST_DEGREES = 2e-3
"""Angles below this, rad, are told in milliradians: a tenth of a degree."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """One thing that is answered."""

    what: str  # what it is about; the link, if there is one, is on it
    said: str
    where: str = ""  # in which cell
    link: str = ""  # anchor of the section that shows it
    answer: Answer = "pass"  # of its checks
    command: str = ""  # what computes the cell again


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """The answer to one question, the most important first."""

    title: str
    answer: Answer
    headline: str  # the answer in a few words; may be empty
    lines: Sequence[Line]
    note: str  # how the numbers were chosen
    fold: str = ""  # words of the fold behind which the other lines are

    @property
    def first(self) -> Sequence[Line]:
        """Lines that stand on the page at once."""
        return self.lines[:SHOWN]

    @property
    def rest(self) -> Sequence[Line]:
        """Lines behind the fold."""
        return self.lines[SHOWN:]


def linked(block: Block, anchors: Container[str]) -> Block:
    """The block, its links only to what the page has."""
    lines = [
        line if line.link in anchors else replace(line, link="") for line in block.lines
    ]
    return replace(block, lines=lines)


def in_order(studies: Sequence[str]) -> list[str]:
    """Studies, the most important first."""
    known = {name: place for place, name in enumerate(IMPORTANCE)}
    unique = list(dict.fromkeys(studies))
    return sorted(unique, key=lambda name: known.get(name, len(known)))


def called(study: str) -> str:
    """Name of a study at the beginning of a line."""
    words = spelled(study)
    return words[:1].upper() + words[1:]


def rounded(value: float, digits: int = 2) -> str:
    """A number with so many significant digits, with an exponent only if it is long."""
    short = float(f"{value:.{digits - 1}e}")
    return f"{short:,.12g}" if 1e-4 <= abs(short) < 1e7 else f"{short:.{digits}g}"


def in_unit(value: float, unit: Unit, digits: int = 2) -> str:
    """A value of a row in a unit for people."""
    gap = "" if unit in (DEGREE, COUNT) else " "
    return f"{rounded(value * unit.factor, digits)}{gap}{unit.name}"


def angle(value: float) -> str:
    """An angle in degrees, a small one in milliradians."""
    return in_unit(value, DEGREE if value >= LEAST_DEGREES else MILLIRADIAN, 3)


def percent(value: float) -> str:
    """A share with two digits."""
    return f"{rounded(100.0 * value)} %"
