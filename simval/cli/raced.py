"""Races in the terminal: one of them, one beside an earlier run, and many runs."""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import click
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from simval.bench.against import SLOWER, Change, code_of, measured, uncompared
from simval.bench.history import lines_of, read_history, steps_of
from simval.bench.interval import rounds_for
from simval.bench.race import Race
from simval.bench.races import find_races
from simval.bench.record import Record, load, processor, read_record
from simval.bench.rounds import Result
from simval.bench.untimed import Untimed, attempted, code_of_untimed
from simval.cli.options import refuse_if, write

BUSY = 1.5
"""Processes for each core from which a ratio is doubted. Chosen: our own is one."""


def show(race: Race, results: list[Result] | Untimed, console: Console) -> None:
    """Print how the contenders of a race did, or why they were not timed."""
    if isinstance(results, Untimed):
        return console.print(escape(f"{race.title} ({race.name}): {results}"))
    last, rounds = results[-1], len(results[-1].seconds)
    table = Table(
        title=f"{race.title} ({race.name}, {race.clock} time)",
        caption=f"{rounds} rounds; the ratio is their median, and this is in the "
        f"interval at a confidence of {last.confidence:.1%}",
    )
    table.add_column("contender")
    for heading in (race.item, f"{race.item}/s", "ratio", "interval"):
        table.add_column(heading, justify="right")
    for r in results:
        words = [figure(number) for number in (r.count, r.rate, r.ratio)]
        table.add_row(escape(_label(r)), *words, f"{figure(r.low)} to {figure(r.high)}")
    return console.print(table)


def figure(value: float) -> str:
    """A number of three digits, a large one as people write it: 13,600 and not 1e4."""
    rounded = float(f"{value:.3g}")
    return f"{rounded:,.0f}" if 1e3 <= rounded < 1e10 else f"{value:.3g}"


def _label(r: Result) -> str:
    """A contender, and how its work differs if it does."""
    kind = "other work" if r.ours else "reference"
    return f"{r.contender} ({kind}: {r.other})" if r.other else r.contender


def judge(
    races: Sequence[Race], rounds: int, file: Path, console: Console
) -> tuple[int, list[Result], list[Untimed]]:
    """Race, compare with an earlier run, and say what became slower."""
    refuse_if(
        rounds < rounds_for(),
        f"`--against` needs at least {rounds_for()} rounds for its intervals; "
        f"`--rounds` is {rounds}",
    )
    record = read_record(file)
    then = {kept.key: kept for kept in record.kept}
    before = {each.race: each for each in record.untimed}
    found: list[Change] = []
    results: list[Result] = []
    untimed: list[Untimed] = []
    for race in races:
        now = attempted(race, partial(measured, race, then, rounds, tell=_told))
        if isinstance(now, Untimed):
            show(race, now, console)
            untimed.append(now)
            found.append(uncompared(now, before=False))
            continue
        some, changes = now
        show(race, some, console)
        results += some
        none = before.get(race.name)
        found += changes if none is None else [uncompared(none, before=True)]
    code = code_of(found)
    told = [c for c in found if c.now is None or c.now.ours]  # others have no answer
    console.print(_changes(told, record))
    for words in _verdict(told, record, code):
        click.echo(words)
    if untimed:
        click.echo(without_times(untimed, len(races)))
    # a crash of the code counts before what is slower, as in every command
    return max(code, code_of_untimed(untimed), key=_WORSE.index), results, untimed


_WORSE = (0, 3, 1, 4)
"""Exit codes, the worst last."""


def without_times(untimed: Sequence[Untimed], races: int) -> str:
    """One line that names the races without times."""
    names = ", ".join(f"{each.race} ({each.ending})" for each in untimed)
    return f"NOT TIMED: {len(untimed)} of {_several(races, 'race')}: {names}"


def _told(words: str) -> None:
    click.echo(words, err=True)


def _changes(changes: Sequence[Change], record: Record) -> Table:
    table = Table(title=f"Beside {escape(record.label)}")
    table.add_column("race, contender")
    for heading in ("ratio then", "now", "time now, in that then"):
        table.add_column(heading, justify="right")
    table.add_column("answer", no_wrap=True)
    for c in changes:
        ratios = ["" if k is None else figure(k.ratio) for k in (c.then, c.now)]
        time = "" if c.low is None else f"{c.low:.2f} to {c.high:.2f}"
        table.add_row(escape(named(c)), *ratios, time, c.standing)
    return table


def named(change: Change) -> str:
    """Race and contender of a change; the race alone where it stands for all of it."""
    return ", ".join(filter(None, change.key))


def _reasons(changes: Sequence[Change]) -> Iterator[str]:
    """Why a ratio has no answer by its interval, a line for each reason."""
    found: dict[str, list[str]] = {}
    for c in changes:
        if c.words:
            found.setdefault(f"{c.standing}, {c.words}", []).append(named(c))
    for words, names in found.items():
        yield f"{'; '.join(names)}: {words}"


def _verdict(changes: Sequence[Change], record: Record, code: int) -> list[str]:
    """The answer in words, and what else may have made the difference."""
    names = {
        standing: [named(c) for c in changes if c.standing == standing]
        for standing in ("pass", "slower", "inconclusive")
    }
    limit, passed = f"{SLOWER:.0%}", len(names["pass"])
    unsure = "; ".join(names["inconclusive"])
    more = any(c.standing == "inconclusive" and c.low is not None for c in changes)
    words = {
        0: f"PASS: none of {_several(passed, 'contender')} takes {limit} more time "
        f"than at {record.label}",
        1: f"FAIL: more than {limit} slower than at {record.label}: "
        f"{'; '.join(names['slower'])}" + (f"; inconclusive: {unsure}" * bool(unsure)),
        3: f"INCONCLUSIVE: {unsure or 'no contender could be compared'}"
        + "; try again with more `--rounds`, or on a quieter machine" * more,
    }
    return [*_reasons(changes), words[code], *_notes(record, code)]


def _notes(record: Record, code: int) -> Iterator[str]:
    """What else than the code may have moved the ratios."""
    here, now = processor(), load()
    if code and here != record.processor:
        yield (
            f"note: the file is of another processor ({record.processor or 'unknown'}; "
            f"this is {here}); measure its commit here to tell code from machine"
        )
    for when, busy in (("the file was made", record.load), ("this was measured", now)):
        if busy is not None and busy > BUSY:
            yield (
                f"note: {when} while {busy:.1f} processes wanted each core; batches "
                "lose more by that than loops do: make it anew on a quiet machine"
            )


def _several(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def history(folder: Path, races: tuple[str, ...]) -> int:
    """Draw the runs in a folder, and say which ratios have a step."""
    names = [race.name for race in find_races(races)] if races else []
    records = read_history(folder)
    from simval.bench.page import render_history, told  # drawing takes a second to load

    steps = [step for line in lines_of(records, names) for step in steps_of(line)]
    counts = [_several(len(records), "run"), _several(len(steps), "step")]
    click.echo(f"{', '.join(counts)} beyond the intervals")
    for step in steps:
        click.echo(told(step, records))
    out = folder / "bench.html"
    write(out, render_history(records, folder.resolve().name, names))
    click.echo(str(out))
    return 0
