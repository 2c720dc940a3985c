"""What the checks of each study say, and what changed, in the words of the page.

The closest check of a study is the one whose distance from theory is the greatest share
of what it is allowed (`simval.verdict.shares`), of those in which chance has a part and
of those that fail.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from simval.change import question
from simval.judge.causes import off
from simval.judge.findings import WORDS
from simval.judge.result_lines import changed_words, runs_account
from simval.judge.steps import Move, moved
from simval.report.formatting import angle_unit, begun
from simval.report.section import Against, Context
from simval.results import Row
from simval.spelling import counted, measured, rounded, rounded_up, whole
from simval.statistics import CRAMER_RAO
from simval.sweep import Run
from simval.units import Unit, of_row
from simval.verdict import Answer, Verdict, shares, worst

# ---- numbers and lines

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
    "diagnosis",
    "coverage",
    "noise_model",
    "attitude_vectors",
    "ladder",
)
"""Studies in the order in which a reader asks for them; the others follow."""


class Number(NamedTuple):
    """A number on the page that says how good something is."""

    label: str  # what it is, and its unit
    value: str
    error: str = ""  # its standard error; empty without chance
    unit: str = ""  # or what it is a multiple of
    beside: str = ""  # what it is relative to

    @property
    def said(self) -> str:
        """The number with its error and unit."""
        gap = "" if self.unit in ("", "°") else " "
        return f"{' ± '.join(filter(None, (self.value, self.error)))}{gap}{self.unit}"


def number_of(
    label: str, value: float, error: float, unit: str = "", beside: str = ""
) -> Number:
    """Make a number with the digits that its standard error allows."""
    words = measured(value, error) if error > 0.0 else rounded(value, 3)
    value_words, _, error_words = words.partition(" ± ")
    return Number(label, value_words, error_words, unit, beside)


def number_of_row(label: str, row: Row, unit: Unit | None = None) -> Number:
    """Make a number of a row, in the unit for people, with its ratio to theory."""
    if unit is None:
        unit = angle_unit(row.shown) if row.unit == "rad" else of_row(row.unit)
    value, error = (unit.factor * x for x in (row.shown, row.standard_error))
    return number_of(label, value, error, unit.name, relative(row, unit.factor))


def relative(row: Row, factor: float = 1.0) -> str:
    """Say the ratio of a value to its prediction; of a plain number, what was due."""
    predicted, error = row.prediction, row.standard_error
    if predicted is None or row.check == "limit":
        return ""
    bound = row.predictor == CRAMER_RAO
    plain = row.unit == "1" and factor == 1.0 and not bound
    if plain or not (predicted > 0.0 and error > 0.0):
        return f"{rounded(factor * predicted, 3)} predicted"
    of = "the bound" if bound else "theory"
    return f"{measured(row.value / predicted, error / predicted)} × {of}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """The answer of one study."""

    what: str  # the study; the link, if there is one, is on it
    said: str  # its answer in one sentence
    number: Number | None = None
    # numbers for the first screen, each with where it was measured
    keys: Sequence[tuple[Number, str]] = ()
    link: str = ""  # anchor of the section that shows it
    answer: Answer = "pass"  # of its checks
    share: float | None = None  # of its closest check; None where none is of chance
    checks: str = ""  # what it is closest of


def in_order(studies: Sequence[str]) -> list[str]:
    """Sort studies, the most important first."""
    known = {name: place for place, name in enumerate(IMPORTANCE)}
    unique = list(dict.fromkeys(studies))
    return sorted(unique, key=lambda name: known.get(name, len(known)))


# ---- checks


def closest(verdicts: Sequence[Verdict]) -> tuple[float | None, str]:
    """Largest share of what is allowed, and its check; None without chance."""
    judged = [v for v in verdicts if not v.wide and v.answer != "inconclusive"]
    if not judged:
        return None, "not judged" if verdicts else "record only"
    some = [v for v in judged if v.p_value is not None or v.answer == "fail"]
    if not some:
        return None, "exact"
    found = shares(some)
    place = int(np.nanargmax(found))
    of = f"the closest of {counted(len(judged), 'check')}" if len(judged) > 1 else ""
    words = (
        f"{rounded(found[place])} of what is allowed: {some[place].row.statistic.words}"
    )
    return float(found[place]), ", ".join(filter(None, (words, of)))


def farthest(verdicts: Sequence[Verdict]) -> Verdict | None:
    """The failing check that exceeds what is allowed most; None if none fails."""
    failing = [v for v in verdicts if v.answer == "fail"]
    return failing[int(np.nanargmax(shares(failing)))] if failing else None


def beyond(verdict: Verdict) -> str:
    """Say how far a check exceeds what it is allowed."""
    row = verdict.row
    if verdict.p_value is None:
        (share,) = shares([verdict])
        return f"{rounded(share)} times" if np.isfinite(share) else ""
    distance = abs(verdict.sigmas) - row.remainder / row.standard_error
    return f"{distance:.1f} standard errors"


def size_of(row: Row) -> str:
    """Say how large a failing row is relative to what is expected."""
    error, due = row.standard_error, row.prediction or 0.0
    if row.check == "limit" or not due > 0.0 or not 0.0 < error < np.inf:
        return off(row)
    times = measured(row.value / due, error / due)
    return f"{row.statistic.words} is {times} times what is expected"


def not_passed(verdicts: Sequence[Verdict]) -> str:
    """Say in one sentence which checks of a study do not pass; empty if all do."""
    total = sum(not v.wide for v in verdicts)
    failing = sum(v.answer == "fail" for v in verdicts)
    unclear = sum(v.answer == "inconclusive" for v in verdicts)
    said = []
    far = farthest(verdicts)
    if far is not None:
        verb = "fails" if failing == 1 else "fail, most"
        said.append(f"{whole(failing)} of {counted(total, 'check')} {verb}: "
                    f"{size_of(far.row)}")  # fmt: skip
    if unclear:
        times = [v.more for v in verdicts if v.more == v.more]
        words = f"{whole(unclear)} of {counted(total, 'check')} cannot be judged"
        if times:
            words += f": {rounded_up(max(times))} times as many trials would do"
        said.append(words)
    return f"{begun('; '.join(said))}." if said else ""


# ---- since before


class Change(NamedTuple):
    """What changed since another run or the baseline."""

    said: str
    answer: Answer
    differs: Sequence[str] = ()  # what the runs depend on
    moves: Sequence[Move] = ()  # the largest first


def comparable(run: Run, baseline: Mapping[str, Any] | None) -> bool:
    """True if a baseline can be compared with the run, in suite or in all cells.

    Cells are the same whatever their seed and effort. Of the same suite one is enough.
    """
    if baseline is None:
        return False
    stored = {_key(cell.study, cell.parameters) for cell in baseline["cells"].values()}
    common = stored & {_key(cell.study, cell.parameters) for cell in run.cells}
    same_suite = baseline["environment"].get("suite") == run.manifest["suite"]
    return bool(common) and (same_suite or common == stored)


def _key(study: str, parameters: Mapping[str, Any]) -> tuple[str, str]:
    return study, str(question(parameters))


def changes(context: Context) -> list[Change]:
    """What changed since each thing that the page is compared with."""
    found = []
    if context.baseline is not None:
        found.append(_from_baseline(context, context.baseline))
    if context.against is not None:
        found.append(_from_run(context, context.against))
    return found


def _from_baseline(context: Context, baseline: Mapping[str, Any]) -> Change:
    """Changes that the gate found against the baseline."""
    run, judged = context.run, context.judged
    if not comparable(run, baseline):
        stored, own = baseline["environment"].get("suite"), run.manifest["suite"]
        why = (
            "it has no cell with the study and parameters of a cell of this run"
            if stored == own
            else f"it is of the suite {stored}, this run of {own}"
        )
        return Change(f"Cannot be compared with the baseline: {why}.", "inconclusive")
    kinds, moves = judged.changes, moved(judged.steps)
    ways = [move.standing for move in moves for _ in move.steps]
    words = changed_words(kinds["changed"], kinds.total() - kinds["new"], ways.count)
    others = [
        f"{whole(number)} {WORDS.get(kind, kind)}"
        for kind, number in kinds.items()
        if kind not in ("changed", "same")
    ]
    said = "; ".join([f"{words} since the baseline", *others])
    answer = worst(each.answer for each in judged.comparisons)
    return Change(f"{said}.", answer, _short(judged.environment), moves)


def _from_run(context: Context, against: Against) -> Change:
    """Changes since another run, as `simval compare` finds them."""
    found = against.changes
    account = runs_account(against.run, context.run, found)
    reply, name = account.replies[0], against.run.folder.name
    words = reply.headline.removeprefix("Yes: ").rstrip(".")
    differs = _short(found.environment)
    return Change(f"{words} (against {name}).", reply.answer, differs, found.moves)


def _short(differs: Sequence[str]) -> list[str]:
    """Shorten the digests in lines of differences."""
    return [re.sub(r"\b([0-9a-f]{8})[0-9a-f]{24,}\b", r"\1", x) for x in differs]
