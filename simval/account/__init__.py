"""What a result says, stated once; each face shows it and adds no words of its own.

An `Account` has no drawing and no layout: answers with what to do, values with their
errors and limits, and facts. A result makes it. `terminal.lines`, `markdown.text`,
`html.fragment` and the pages of `simval.report` show it; `Account.as_object` is in
JSON. A fact that a reader must know before the numbers are used is `notable`: it
stands in the shortest face, too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import floor, isfinite, log10, nan
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

from simval.spelling import bounded, measured

Answer = Literal["pass", "inconclusive", "fail"]
"""Good news, none, and bad news; a graver one stands later."""
GRAVITY: tuple[Answer, ...] = ("pass", "inconclusive", "fail")
SHORT = range(-2, 6)
"""Exponents of ten of numbers that need none in their unit."""

COARSE = 1e-4
"""A standard deviation from which its digits are few, however small the numbers."""


class Fact(NamedTuple):
    """Something read, done or seen, under a label."""

    label: str
    words: str
    notable: bool = False


class Remark(NamedTuple):
    """A judgement of the data: its kind, what was seen, in numbers, and what to do."""

    kind: str
    words: str
    do: str = ""  # a sentence; empty where nothing is to be done
    numbers: Mapping[str, Any] = MappingProxyType({})

    def __str__(self) -> str:
        return f"{self.words}. {self.do}" if self.do else self.words

    def as_object(self) -> dict[str, Any]:
        """Return the remark as plain JSON values."""
        return self._asdict() | {"numbers": dict(self.numbers)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """A question that a person asks of a result, and its answer."""

    title: str  # the question
    headline: str  # the answer and its reason
    answer: Answer = "pass"  # whether it is good news
    do: str = ""  # what to do; empty where nothing is to be done
    lines: tuple[str, ...] = ()  # what the answer rests on

    def as_object(self) -> dict[str, Any]:
        """Return question and answer as plain JSON values."""
        return {
            "question": self.title, "answer": self.answer, "reason": self.headline,
            "do": self.do, "rests_on": list(self.lines),
        }  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Note:
    """A remark below the answers, printed as it stands or hidden in a fold."""

    words: str
    matrix: str = ""  # shown as it stands
    lines: Sequence[str] = ()  # shown on request, below the words


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number with its standard deviation, or a limit where there is no estimate."""

    name: str
    value: float | None
    sd: float | None = None
    low: float = nan  # of the 95 % interval, or limit
    high: float = nan
    least: float | None = None  # the least standard deviation that is possible
    missing: str = "-"  # where there is neither value nor limit
    answer: Answer | None = None  # of what judges it, which a face shows as a mark

    def spelled(self, *, fixed: bool = True) -> str:
        """Spell the number for a person; `fixed` forbids a power of ten of its own."""
        if self.value is not None:
            return measured(self.value, self.sd or 0.0, fixed=fixed)
        if isfinite(self.high) or self.low > 0.0:
            return bounded(self.low, self.high)
        return self.missing

    @property
    def bounded(self) -> bool:
        """True if it has an interval, a limit or a least standard deviation."""
        return isfinite(self.low) or isfinite(self.high) or self.least is not None

    def times(self, factor: float) -> "Quantity":
        """Return the quantity in a unit that is smaller by a factor."""
        value, sd, least = (
            None if x is None else factor * x for x in (self.value, self.sd, self.least)
        )
        ends = factor * self.low, factor * self.high
        rest = self.missing, self.answer
        return Quantity(self.name, value, sd, *ends, least, *rest)


@dataclass(frozen=True, slots=True)
class Line:
    """Quantities of one kind in one unit, such as one for each axis."""

    label: str
    unit: str
    cells: Sequence[Quantity]
    named: bool = False  # whether each cell shows its name, where no heading does
    factor: float = 1.0  # times a cell in the unit
    fixed: bool = True  # whether all have the unit's power of ten, and none its own
    notable: bool = True  # whether short views have it, too

    @property
    def head(self) -> str:
        """Label and unit of the line."""
        return f"{self.label}, {self.unit}" if self.unit else self.label

    def shown(self, marks: Mapping[Answer, str]) -> list[str]:
        """Spell the cells, each with its name if it is `named`, and with its mark."""
        return [
            f"{each.name} {words}" if self.named else words
            for each, words in zip(self.cells, self.marked(marks), strict=True)
        ]

    def marked(self, marks: Mapping[Answer, str]) -> list[str]:
        """Spell the cells, each with the mark of its answer if it was judged."""
        return [
            words if each.answer is None else f"{words} {marks[each.answer]}"
            for each, words in zip(self.cells, self.spelled, strict=True)
        ]

    @property
    def spelled(self) -> list[str]:
        """Spell the cells in the line's unit."""
        return [
            each.times(self.factor).spelled(fixed=self.fixed) for each in self.cells
        ]


def in_thousands(lines: Sequence[Line]) -> list[Line]:
    """Move one power of ten into the unit of some lines if their numbers are long.

    The power is a multiple of three, by the largest of them.
    """
    cells = [each for line in lines for each in line.cells]
    sizes = [abs(each.value) for each in cells if each.value]
    top = floor(log10(max(sizes))) if sizes else 0
    least = min((x.sd for x in cells if x.sd and x.sd > 0.0), default=0.0)
    if top in SHORT or (top < 0 and least >= COARSE):
        return list(lines)
    exponent = top // 3 * 3
    return [
        replace(line, unit=f"1e{exponent} {line.unit}", factor=10.0**-exponent)
        for line in lines
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Values:
    """The numbers of one sensor, a row for each kind."""

    title: str
    how: str = ""  # how to use them: a formula
    lines: Sequence[Line] = ()
    heads: Sequence[str] = ("x", "y", "z")
    facts: Sequence[Fact] = ()  # how they were found, and what is wrong with them

    @property
    def folded(self) -> bool:
        """True if the table is shown on request only."""
        return bool(self.lines) and not any(each.notable for each in self.lines)


@dataclass(frozen=True, slots=True, kw_only=True)
class Account:
    """Everything that there is to say of one result."""

    title: str  # what was done, before the name of its source
    source: str = ""  # name of the file or folder, never its place
    said: str = ""  # what was read, in a sentence
    replies: Sequence[Reply] = ()
    values: Sequence[Values] = ()
    notes: Sequence[Note] = ()  # shown on request
    facts: Sequence[Fact] = ()  # what was read, and how
    record: Sequence[Fact] = ()  # of whom, when, of what and by what method it is

    @property
    def all_facts(self) -> tuple[Fact, ...]:
        """The facts, and then the record."""
        return (*self.facts, *self.record)

    @property
    def name(self) -> str:
        """Title and source: what was done, and with what."""
        return f"{self.title} {self.source}".strip()

    @property
    def answer(self) -> Answer:
        """The gravest of the answers."""
        return max((r.answer for r in self.replies), key=GRAVITY.index, default="pass")

    @property
    def warnings(self) -> tuple[Fact, ...]:
        """The notable facts, which each face shows beside the answers."""
        every = [self.all_facts, *(each.facts for each in self.values)]
        return tuple(fact for facts in every for fact in facts if fact.notable)

    def as_object(self) -> dict[str, Any]:
        """Return answers and warnings as plain JSON values."""
        return {
            "answers": [each.as_object() for each in self.replies],
            "warnings": [{"about": x.label, "said": x.words} for x in self.warnings],
        }


class Told:
    """Base of a result that prints its account and shows it in a notebook."""

    __slots__ = ()

    @property
    def account(self) -> Account:
        """Everything that there is to say of the result."""
        raise NotImplementedError

    def __str__(self) -> str:
        from simval.account.terminal import lines

        return "\n".join(lines(self.account))

    def _repr_html_(self) -> str:
        from simval.account.html import fragment

        return fragment(self.account)
