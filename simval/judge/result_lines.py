"""Results of the gate, comparisons and trends as accounts."""

import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from simval.account import Account, Answer, Fact, Line, Quantity, Reply, Values
from simval.judge import (
    AlgorithmComparison,
    GateResult,
    Merit,
    Move,
    RunComparison,
    Step,
    Trend,
    findings,
    headline,
)
from simval.judge.algorithms import ACCURACY, FAILING, HONESTY
from simval.judge.findings import (
    Finding,
    Group,
    details,
    groups,
)
from simval.judge.needs import replies_to, tables_of
from simval.judge.runs import Origin, origin_of, shared_words
from simval.judge.steps import Standing, short_names
from simval.judge.trend import WAYS, ordered_by
from simval.spelling import (
    counted,
    duration,
    measured,
    rounded,
    rounded_up,
    standard_errors,
    whole,
)
from simval.sweep.cells import REFUSED
from simval.sweep.run import Run
from simval.text import number, one_line

LINES = 8
"""Lines printed of what did not pass; two more say how many others, and the answer."""

NAMED = 6
"""Kinds of the others that are named."""


def gate_account(result: GateResult) -> Account:
    """State the gate's answer: whether the run passes, why, and what to do.

    What did not pass stands below it, one by one (`short_lines`).
    """
    notes = [Fact("note", one_line(each), notable=True) for each in result.notes]
    lines = [f"The false-alarm rate is {result.alpha:g} for all together."]
    if result.wide:
        lines.append(
            "A check that would pass twice its prediction is wide, and is not counted "
            "(docs/gate.md)."
        )
    return Account(
        title="Gate of",
        source=Path(result.folder).name,
        values=[
            *tables_of(result.asked),
            *([Values(title="Notes", facts=notes)] if notes else []),
        ],
        replies=(
            Reply(
                title="Does the run pass?",
                headline=headline(result),
                answer=result.answer,
                do=" ".join(_to_do(result)),
                lines=tuple(lines),
            ),
            *replies_to(result.asked),
        ),
    )


def _to_do(result: GateResult) -> Iterator[str]:
    found = groups(result)
    if result.review:
        yield f"{result.review[0].upper()}{result.review[1:]}."
    if result.never_run:
        yield "Resume the sweep with --resume."
    few = [x.more for g in found for x in g.findings if x.more is not None]
    if few:
        yield f"Take {rounded_up(max(few))} times as many trials."
    failed = [group.worst for group in found if group.worst.answer == "fail"]
    if failed and all(f.tier == "baseline" and f.step for f in failed):
        yield "If the change is intended, accept it with --update-baseline 'why'."
    elif any(each.command for each in failed):
        yield "Run a failing cell again by its command below."


def every_line(result: GateResult) -> Iterator[str]:
    """Describe each finding that did not pass."""
    for finding in _below(result):
        yield from _indented(details(finding))


def _below(result: GateResult) -> list[Finding]:
    """Findings that did not pass, except a missing baseline, which the answer names."""
    return [f for f in findings(result, passes=False) if f.check != "first"]


def short_lines(result: GateResult) -> Iterator[str]:
    """Findings that did not pass: each if they are few, else by study and kind.

    All that need more trials are one line.
    """
    found = [group for group in groups(result) if group.worst.check != "first"]
    short = [group.line for group in found if group.worst.more is not None]
    lines = [
        line
        for finding in _below(result)
        if finding.more is None
        for line in _indented(details(finding))
    ]
    if len(lines) + len(short) <= LINES:
        yield from (*lines, *short)
        return
    shown: list[str] = []
    hidden = list(found)
    while hidden and (not shown or len(shown) + len(hidden[0].lines) <= LINES):
        shown += _indented(hidden.pop(0).lines)
    yield from shown
    yield _rest(hidden)


def _rest(hidden: Sequence[Group]) -> str:
    """Say what is not shown, and how to see it."""
    if not hidden:
        return "--all prints every one"
    count = sum(len(group.findings) for group in hidden)
    names = list(dict.fromkeys(group.what for group in hidden))
    more = "; ..." if len(names) > NAMED else ""
    return (
        f"... and {count} more ({'; '.join(names[:NAMED])}{more}): --all prints every "
        "one, --json FILE writes them"
    )


def _indented(lines: Sequence[str]) -> Iterator[str]:
    first, *rest = lines
    yield first
    yield from (f"    {line}" for line in rest)


class Failures(NamedTuple):
    """Cells of a run that have no result."""

    first: Sequence[tuple[str, str]]  # the name of a cell, and why
    failed: int  # crashed or refused
    refused: int


def run_account(
    folder: Path,
    suite: str,
    cells: int,
    seconds: float,
    failures: Failures,
    judged: GateResult | None,
) -> Account:
    """State what became of a run's cells, if they agree with theory, and what next."""
    place = shlex.quote(str(folder))
    crashed = failures.failed - failures.refused
    of, took = f"of suite {suite}", duration(seconds)
    said = f"Yes: all {counted(cells, 'cell')} {of}, in {took}."
    if cells == 1:
        how = "crashed" if crashed else "was refused" if failures.failed else "is done"
        said = f"{'No' if failures.failed else 'Yes'}: the only cell {how}, in {took}."
    elif failures.failed:
        were = "was" if failures.refused == 1 else "were"
        parts = [f"{whole(crashed)} crashed"] * bool(crashed)
        parts += [f"{whole(failures.refused)} {were} refused"] * bool(failures.refused)
        said = f"No: of {whole(cells)} cells {of} {' and '.join(parts)}, in {took}."
    do = f"`simval repro --run {place} CELL` computes one again." * bool(
        failures.failed
    )
    next_one = (
        f"`simval gate {place}` compares it with the baseline, `simval report {place}` "
        "writes its page."
    )
    replies = [
        Reply(
            title="Were all cells computed?",
            headline=said,
            answer="fail" if crashed else "inconclusive" if failures.failed else "pass",
            do=do
            if judged is not None and judged.verdicts
            else f"{do} {next_one}".strip(),
        )
    ]
    if judged is not None and judged.verdicts:
        whole_of = replace(judged, unfinished=())
        replies.append(
            Reply(
                title="Do the results agree with theory?",
                headline=headline(whole_of),
                answer=whole_of.answer,
                do=next_one,
            )
        )
        replies += replies_to(judged.asked)
    facts = []
    for name, error in failures.first:
        refused = error.startswith(REFUSED)
        last = error.strip().splitlines()[-1].removeprefix(REFUSED if refused else "")
        label = "refused" if refused else "crashed"
        facts.append(Fact(label, one_line(f"{name}: {last}"), notable=True))
    hidden = failures.failed - len(failures.first)
    if hidden:
        more = f"{counted(hidden, 'more cell')}: all are in the report"
        facts.append(Fact("...", more, notable=True))
    values = [Values(title="What failed", facts=facts)] if facts else []
    values += tables_of(judged.asked if judged is not None else ())
    return Account(title="Run", source=folder.name, replies=replies, values=values)


_DIGEST = re.compile(r"\b([0-9a-f]{12})[0-9a-f]{20,}\b")
"""A digest, of which a few digits are enough for people."""
SHOWN = 8
"""Kinds of change that a short view has; the others are counted."""


def runs_account(a: Run, b: Run, found: RunComparison) -> Account:
    """State what changed between two runs, and whether for better or worse."""
    changed = found.kinds.count("changed")
    settings = short_names(b.cells)
    dependencies = [
        Fact("differs", _DIGEST.sub(r"\1", each), notable=True)
        for each in found.environment
    ]
    alone = [
        Fact(f"only in {name}", f"{whole(len(names))}, the first {names[0]}", True)
        for name, names in (("A", found.only_a), ("B", found.only_b))
        if names
    ]
    if not found.total:
        said = f"Cannot tell: they have nothing in common; {shared_words(a, b)}."
    elif changed:
        said = f"Yes: {changed_words(changed, found.total, found.count)}."
    else:
        said = f"{changed_words(0, found.total, found.count)}."
    lines = []
    if found.within:
        lines.append(
            f"{whole(found.within)} of them changed by less than chance could; the "
            "noise is the same, so the algorithm or its environment is another."
        )
    if found.predictions_changed:
        count = counted(found.predictions_changed, "prediction")
        alone.append(Fact("theory", f"{count} changed", notable=True))
    lines.append(f"The false-alarm rate is {found.alpha:g} for all together.")
    beside = [*dependencies, *alone]
    return Account(
        title="Comparison of",
        source=f"{a.folder.name} (A) and {b.folder.name} (B)",
        said=f"A is {origin_of(a).words}. B is {origin_of(b).words}.",
        replies=[
            Reply(
                title="Did the results change?",
                headline=said,
                answer=_verdict(found.total, found.count),
                do="Look at what differs between the runs."
                if changed and dependencies
                else "",
                lines=tuple(lines),
            )
        ],
        values=[
            *_changes([("", move) for move in found.moves], settings),
            *([Values(title="What else differs", facts=beside)] if beside else []),
        ],
    )


def _verdict(total: int, count: Callable[[Standing], int]) -> Answer:
    """Fail if something is worse, inconclusive if it cannot be told, else pass."""
    if count("worse"):
        return "fail"
    return "inconclusive" if not total or count("neither") else "pass"


def changed_words(changed: int, total: int, count: Callable[[Standing], int]) -> str:
    """Say how many of some values changed, and in which direction."""
    if not changed:
        return f"No change in {counted(total, 'value')}"
    values = "value changed" if total == 1 else "values changed"
    return f"{whole(changed)} of {whole(total)} {values}: {_ways(count)}"


def _ways(count: Callable[[Standing], int]) -> str:
    """Say how many changed in which direction."""
    names = {
        "worse": "worse",
        "better": "better",
        "neither": "neither better nor worse",
    }
    return ", ".join(f"{whole(count(way))} {names[way]}" for way in WAYS if count(way))


def _changes(
    moves: Sequence[tuple[str, Move]], settings: Mapping[str, str]
) -> list[Values]:
    """Each kind of change: its largest value at once, all values on request.

    Before a move stands since when it is so, where it is of a series.
    """
    facts = []
    for place, (since, move) in enumerate(moves):
        most = f"{since}{move.sentence}: {one_line(_value(move.worst, settings))}"
        facts.append(Fact(move.way, most, notable=place < SHOWN))
        facts += [
            Fact(move.way, one_line(f"{_value(each, settings)}{_size(each)}"))
            for each in move.steps[1:]
        ]
    if hidden := moves[SHOWN:]:
        values = sum(len(move.steps) for _, move in hidden)
        more = f"{counted(values, 'value')} of {counted(len(hidden), 'more kind')}"
        facts.append(Fact("...", more, notable=True))
    title = "What changed, the largest first"
    return [Values(title=title, facts=facts)] if facts else []


def _value(step: Step, settings: Mapping[str, str]) -> str:
    """One value before and after, with its cell."""
    unit = "" if step.statistic.unit == "1" else f" {step.statistic.unit}"
    place = settings.get(step.cell, step.cell)
    return (
        f"{step.statistic} {rounded(step.before, 4)} -> {rounded(step.after, 4)}{unit}"
        f"{f' at {place}' if place else ''}"
    )


def _size(step: Step) -> str:
    """Say by how much a value changed."""
    sigmas, relative = step.sigmas, step.relative
    size = "" if sigmas is None else f", {standard_errors(f'{sigmas:+.3g}')}"
    return size + ("" if relative is None else f", {100.0 * relative:+.3g} %")


def trend_account(trend: Trend) -> Account:
    """State what became better or worse over a series of runs, and since when."""
    runs = counted(len(trend.origins), "run")

    def count(way: Standing) -> int:
        lines = {each.line for each in trend.breaks if each.step.standing == way}
        return len(lines)

    values = counted(len(trend.lines), "value")
    said = f"No: none of {values} has a step."
    if not trend.lines:
        said = "Cannot tell: the runs have nothing in common."
    elif trend.changed:
        has = "has" if trend.changed == 1 else "have"
        said = f"Yes: {whole(trend.changed)} of {values} {has} a step: {_ways(count)}."
    heads = *WAYS, "within chance"
    lines = []
    for run, origin in enumerate(trend.origins):
        steps = (*(trend.count(run, way) for way in WAYS), trend.within[run])
        cells = [Quantity(head, n or None, missing=".")
                 for head, n in zip(heads, steps, strict=True)]  # fmt: skip
        lines.append(Line(label=one_line(_row(origin)), unit="", cells=cells))
    moves = [
        (f"since {one_line(_since(trend.origins[run]))}: ", move)
        for run, move in trend.moves
    ]
    return Account(
        title="Trend of",
        source=f"{runs} of suite {trend.origins[-1].suite}",
        said=f"They are ordered by {ordered_by(trend.origins)}.",
        replies=[
            Reply(
                title="Did the results change?",
                headline=said,
                answer=_verdict(len(trend.lines), count),
                lines=(f"The false-alarm rate is {trend.alpha:g} for all together.",),
            )
        ],
        values=[
            Values(title="Values with a step, by run", lines=lines, heads=heads),
            *_changes(moves, trend.settings),
        ],
    )


def _since(origin: Origin) -> str:
    """A run as its commit and its folder."""
    if origin.label == origin.name:
        return origin.name
    return f"{origin.label} ({origin.name})"


def _row(origin: Origin) -> str:
    """A run as the label of a table's row."""
    day = (origin.committed or origin.started)[:10]
    seeds = f"seed {' '.join(map(str, origin.seeds))}"
    return ", ".join(filter(None, (origin.name, origin.commit, day, seeds)))


ACCOUNTED = 40
"""Qualities of two algorithms that a short view has; the others are counted."""


def algorithms_account(
    found: AlgorithmComparison, times: float | None = None
) -> Account:
    """State where one algorithm is better or worse than another, and by how much."""
    first, second = found.names
    better, worse, same = found.of("better"), found.of("worse"), found.of("same")
    total = len(found.merits)
    if not total:
        said = "Cannot tell: they have nothing in common."
    elif not better and not worse:
        said = f"No difference in {counted(total, 'value')}."
    else:
        begin = "Yes" if not worse else "No" if not better else "In part"
        counts = ((better, "better"), (worse, "worse"), (same, "the same"))
        ways = (f"{way} in {whole(len(own))}" for own, way in counts if own)
        said = f"{begin}: {', '.join(ways)} of {counted(total, 'value')}."
    apart = sorted((*better, *worse), key=lambda merit: -merit.weight)
    facts = [
        Fact(merit.standing, _merit(merit, first, second), notable=place < ACCOUNTED)
        for place, merit in enumerate(apart)
    ]
    if apart[ACCOUNTED:]:
        more = counted(len(apart) - ACCOUNTED, "more value")
        facts.append(Fact("...", more, notable=True))
    facts += [Fact("same", words, notable=True) for words in _same(same)]
    if found.alone:
        cells = counted(len(found.alone), "cell")
        words = f"{cells}, the first {found.alone[0]}"
        facts.append(Fact("only one has", one_line(words), notable=True))
    if times is not None:
        words = f"a call of {first} takes {times:.2g} times that of {second}"
        facts.append(Fact("time", f"{words} (processor time, not judged)", True))
    return Account(
        title="Comparison of",
        source=f"{first} and {second}",
        replies=[
            Reply(
                title=f"Is {first} better than {second}?",
                headline=said,
                answer="fail" if worse else "pass" if better else "inconclusive",
                lines=(f"The false-alarm rate is {found.alpha:g} for all together.",),
            )
        ],
        values=[Values(title="Differences, the largest first", facts=facts)],
    )


def _merit(merit: Merit, first: str, second: str) -> str:
    """One quality of both algorithms, and the difference."""
    accurate = merit.what == ACCURACY
    size, error = merit.difference, merit.error
    numbers = f"{first} {merit.a:.4g}, {second} {merit.b:.4g}"
    if accurate:
        size, error = 100.0 * abs(size), 100.0 * error
        numbers += " times the bound"
    amount = measured(size, error) if error > 0.0 else rounded(size, 3)
    if accurate:
        amount += f" % {'less' if merit.standing == 'better' else 'more'}"
    where = merit.setting if error > 0.0 or accurate else ""  # else it is of all
    what = " at ".join(filter(None, (merit.what, where)))
    return f"{what}: {amount} ({numbers})"


def _same(same: Sequence[Merit]) -> Iterator[str]:
    """For qualities that are the same, say how large a difference may still be."""
    for what in (ACCURACY, HONESTY):
        own = [merit for merit in same if merit.what == what]
        if own:
            widest = max(merit.within for merit in own)
            factor, unit = (100.0, " %") if what == ACCURACY else (1.0, "")
            bound = number(factor * widest, 2, factor)
            yield (
                f"{what} in {counted(len(own), 'setting')}: no difference beyond "
                f"chance, and none above {bound}{unit} (95 % each)"
            )
    classes = sum(merit.what.startswith(FAILING) for merit in same)
    if classes:
        yield f"{FAILING} in {counted(classes, 'class', 'classes')}"
