"""What a suite asks of its run: a table for each quantity, an answer for each need.

A question of two axes that names no quantity asks for those that represent its study.

A need is met in a cell where the value is on the right side of its limit by more than
chance, at the run's false-alarm rate for all of them together (`simval.verdict`). Of
few trials, and of samples without a standard error, nothing can be told.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite, nan
from typing import Any

import numpy as np

from simval.account import GRAVITY, Answer, Line, Quantity, Reply, Values
from simval.change import EFFORT
from simval.judge.settings import setting_words, varying
from simval.results import Check, Row
from simval.spelling import (
    counted,
    in_ascii,
    measured,
    rounded_up,
    series,
    whole,
)
from simval.statistics import (
    APART,
    COVARIANCE_ORDER,
    COVERAGE,
    LEADING_ERROR_RATIO,
    LIMIT_RATIO,
    REST_FORCE,
    RMS,
    RMS_OVER_BOUND,
    RMS_RATIO,
    SCALE_BIAS,
    SQUARED_ERROR,
    VARIANCE_OVER_BOUND,
    Statistic,
)
from simval.studies import STUDIES
from simval.sweep.needs import UNITS, Need
from simval.sweep.run import CellResult, Run
from simval.text import did_you_mean, one_line
from simval.units import DEGREE, Unit, of_row
from simval.verdict import ALPHA, MIN_SAMPLES, Verdict, judge

BEGIN: Mapping[Answer, str] = {
    "pass": "Yes", "fail": "No", "inconclusive": "Cannot tell",
}  # fmt: skip
"""The first words of an answer."""
MOST_TIMES = 100.0
"""Times as many trials that are worth naming: beyond it both are the same."""


ANY = (
    RMS,
    RMS_OVER_BOUND,
    RMS_RATIO,
    COVERAGE,
    SCALE_BIAS,
    SQUARED_ERROR,
    VARIANCE_OVER_BOUND,
    LIMIT_RATIO,
    COVARIANCE_ORDER,
    LEADING_ERROR_RATIO,
    REST_FORCE,
    APART,
)
"""Statistics that represent a study without a headline: the first that it has."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """A quantity that was measured in one cell."""

    cell: CellResult
    row: Row
    verdict: Verdict | None  # that it is just the limit; None without one

    @property
    def off(self) -> float:
        """Value minus its limit."""
        limit = None if self.verdict is None else self.verdict.row.prediction
        return self.row.value - (limit or 0.0)

    @property
    def times(self) -> float:
        """Factor by which more trials would tell the value from its limit."""
        seen = inf if self.verdict is None else self.verdict.detectable
        return max((seen / (self.off or nan)) ** 2, MIN_SAMPLES / max(self.row.n, 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """A quantity that a suite asks for, in each cell that measured it."""

    need: Need
    question: str  # of the suite
    unit: Unit  # in which it is stated
    found: Sequence[Found]
    why: str = ""  # nothing is told of it

    def of(self, each: Found) -> Answer | None:
        """Whether the need is met in a cell; None if nothing is needed."""
        if each.verdict is None:
            return None
        if each.verdict.answer != "fail":
            return "inconclusive"
        return "pass" if (each.off < 0.0) == bool(self.need.below) else "fail"

    @property
    def words(self) -> str:
        """Name of the quantity."""
        return next((x.row.statistic.words for x in self.found), self.need.quantity)

    @property
    def answer(self) -> Answer:
        """The best answer of any cell: the need is met if it is met somewhere."""
        answers = [answer for x in self.found if (answer := self.of(x))]
        return min(answers, key=GRAVITY.index, default="inconclusive")

    @property
    def limit(self) -> str:
        """The limit in words: ``below 1 mm/s²``."""
        side = "below" if self.need.below else "above"
        return one_line(f"{side} {self.need.bound}".replace("^2", "²"))

    def spelled(self, each: Found) -> str:
        """The value in a cell, with its standard error and unit."""
        row, factor = each.row, self.unit.factor
        words = measured(factor * row.value, factor * row.standard_error)
        return f"{words} {self.unit.name}".rstrip()

    @property
    def reply(self) -> Reply:
        """Answer whether the need is met, where, and what would settle it."""
        counts = Counter(map(self.of, self.found))
        said, total = self.why, len(self.found)
        best = [each for each in self.found if self.of(each) == self.answer]
        if best:
            near = min(best, key=lambda each: abs(each.off))
            said = self.spelled(near)
            if total > 1:
                rest = [f", {words.lower()} in {counts[answer]}"
                        for answer, words in BEGIN.items()
                        if counts[answer] and answer != self.answer]  # fmt: skip
                of = f"in {whole(len(best))} of {counted(total, 'setting')}"
                place = _place(near.cell, [each.cell for each in self.found])
                said = f"{of}{''.join(rest)}; the nearest is {said} at {place}"
        return Reply(
            title=f"Is the {self.words} {self.limit}?",
            headline=f"{BEGIN[self.answer]}: {said}.",
            answer=self.answer,
            do=self._to_do,
        )

    @property
    def _to_do(self) -> str:
        unclear = [each for each in self.found if self.of(each) == "inconclusive"]
        times = [each.times for each in unclear if 1.0 < each.times <= MOST_TIMES]
        if not times:
            return ""
        return f"Take {rounded_up(max(times))} times as many trials."

    @property
    def values(self) -> Values:
        """A table of the cells; the parameter with the fewest values goes across."""
        cells = [each.cell for each in self.found]
        keys = [key for key in varying(cells) if key not in EFFORT]
        columns = [len({repr(c.parameters.get(key)) for c in cells}) for key in keys]
        across = keys[columns.index(min(columns))] if len(keys) > 1 else ""
        table: dict[str, dict[str, Quantity]] = {}
        for each in self.found:
            head = _setting(each.cell, across) if across else "value"
            label = _place(each.cell, cells, across) or each.cell.study
            value, error = (
                self.unit.factor * x for x in (each.row.value, each.row.standard_error)
            )
            own = Quantity(head, value, error, answer=self.of(each))
            table.setdefault(label, {}).setdefault(head, own)
        heads = list(dict.fromkeys(head for own in table.values() for head in own))
        words = f"{self.words[:1].upper()}{self.words[1:]}"
        what = f"{words}, {self.unit.name}".rstrip(", ")
        needed = f", needed {self.limit}" if self.need.bound else ""
        return Values(
            title=one_line(f"{self.question} {what}{needed}".strip()),
            heads=heads,
            lines=[
                Line(label, "", [own.get(h, Quantity(h, None)) for h in heads])
                for label, own in table.items()
            ],
        )

    def as_object(self) -> dict[str, Any]:
        """Return it as plain JSON values, in the units of results.csv."""
        return {
            **self.need.model_dump(exclude_defaults=True),
            "unit": next((each.row.unit for each in self.found), None),
            "settings": [
                {
                    "cell": each.cell.name,
                    "value": each.row.value,
                    "standard_error": each.row.standard_error,
                    "answer": self.of(each),
                }
                for each in self.found
                if isfinite(each.row.value)
            ],
        }


def asked(run: Run, alpha: float = ALPHA) -> tuple[Asked, ...]:
    """Find the quantities that a run's suite asks for, and judge their needs."""
    stated = [Need.model_validate(each) for each in run.manifest.get("need", ())]
    needs = dict.fromkeys(stated, None) or dict(_of_question(run))
    rows = [
        (need, cell, row)
        for need in needs
        for cell in run.of(need.study)
        for row in _first(cell, need)
    ]
    limited = [
        (cell.named, replace(row, check=_check(row), prediction=factor * need.limit[0],
                             remainder=0.0))
        for need, cell, row in rows
        if need.bound and (factor := need.factor(row.unit)) is not None
    ]  # fmt: skip
    verdicts = iter(judge(limited, alpha))
    found: dict[Need, list[Found]] = {need: [] for need in needs}
    for need, cell, row in rows:
        known = need.bound and need.factor(row.unit) is not None
        found[need].append(
            Found(cell=cell, row=row, verdict=next(verdicts) if known else None)
        )
    question = run.manifest.get("question", "")
    return tuple(
        _asked(run, need, question, own, needs[need]) for need, own in found.items()
    )


def _of_question(run: Run) -> Iterator[tuple[Need, Unit | None]]:
    """Quantities of a question of two axes that names none; units of a headline."""
    cells = [cell for cell in run.cells if cell.rows]
    studies = {cell.study for cell in cells}
    axes = [key for key in varying(cells) if key not in EFFORT]
    if not run.manifest.get("question") or len(studies) != 1 or len(axes) < 2:
        return
    (study,) = studies
    headline = STUDIES[study].headline if study in STUDIES else None
    found: dict[Statistic, Unit | None] = {
        q.of: replace(DEGREE, factor=q.times * DEGREE.factor) if q.angle else q.unit
        for name, q in (headline.quotes.items() if headline else ())
        if name != "over"
    }
    first = headline_rows(cells[0])[:1]
    for what, unit in (found or {row.statistic: None for row in first}).items():
        yield Need.model_validate({"quantity": f"{study}.{what}"}), unit


def headline_rows(cell: CellResult) -> list[Row]:
    """Rows, those that say most first: of each statistic the one farthest off."""
    finite = [row for row in cell.rows if np.isfinite(row.value)]
    found = []
    for family in dict.fromkeys((*ANY, *(row.statistic.family for row in finite))):
        rows = [row for row in finite if row.statistic.family == family]
        judged = [row for row in rows if row.check != "record"]
        if rows:
            found.append(max(judged or rows, key=distance))
    return [*found, *(row for row in finite if row not in found)]


def distance(row: Row) -> float:
    """How far a value is from its prediction, or from nothing."""
    if row.prediction is None or not np.isfinite(row.prediction):
        return abs(row.value)
    return abs(row.value - row.prediction) / (abs(row.prediction) or 1.0)


def _check(row: Row) -> Check:
    """The rule to judge by: sampling where there is an error or many samples."""
    return "plain" if row.standard_error > 0.0 or row.n > 1 else "exact"


def _first(cell: CellResult, need: Need) -> Sequence[Row]:
    return [row for row in cell.rows if str(row.statistic) == need.statistic][:1]


def _asked(
    run: Run, need: Need, question: str, found: Sequence[Found], shown: Unit | None
) -> Asked:
    unit, why = shown or of_row(found[0].row.unit if found else "1"), ""
    if not found:
        cells = run.of(need.study)
        known = {str(row.statistic) for cell in cells for row in cell.rows}
        near = did_you_mean(need.statistic, known)
        why = f"no finished cell of {need.study} has {need.statistic}{near}"
    elif need.bound:
        factor = need.factor(found[0].row.unit)
        if factor is None:
            own = in_ascii(found[0].row.unit)
            names = series(UNITS.get(own, [own]))
            why = f"{need.quantity} is in {unit.name}, so its limit is in {names}"
        else:
            unit = Unit(need.limit[1].replace("^2", "²"), 1.0 / factor)
    return Asked(need=need, question=question, unit=unit, found=found, why=why)


def _setting(cell: CellResult, key: str) -> str:
    return one_line(setting_words(cell.study, key, cell.parameters.get(key)))


def _place(cell: CellResult, cells: Sequence[CellResult], but: str = "") -> str:
    """Say which parameters distinguish a cell from the others."""
    keys = [key for key in varying(cells) if key not in (*EFFORT, but)]
    words = [_setting(cell, key) for key in keys]
    seeds = {each.seed for each in cells}
    return ", ".join([*words, *[f"seed {cell.seed}"] * (len(seeds) > 1)])


def replies_to(found: Sequence[Asked]) -> list[Reply]:
    """The answer for each need."""
    return [each.reply for each in found if each.need.bound]


def tables_of(found: Sequence[Asked]) -> list[Values]:
    """A table for each quantity that varies."""
    return [each.values for each in found if len(each.found) > 1]
