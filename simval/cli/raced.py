"""Races in the terminal: one of them, one beside an earlier run, and many runs."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import click
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from simval.bench.against import SLOWER, Change, code_of, measured
from simval.bench.history import lines_of, read_history, steps_of
from simval.bench.interval import rounds_for
from simval.bench.race import Race
from simval.bench.races import find_races
from simval.bench.record import Record, load, processor, read_record
from simval.bench.rounds import Result
from simval.cli.options import refuse_if, write

BUSY = 1.5
"""Processes for each core from which a ratio is doubted. Chosen: our own is one."""


def show(race: Race, results: list[Result], console: Console) -> list[Result]:
    """Print how the contenders of a race did."""
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
        words = [f"{number:.3g}" for number in (r.count, r.rate, r.ratio)]
        table.add_row(escape(_label(r)), *words, f"{r.low:.3g} to {r.high:.3g}")
    console.print(table)
    return results


def _label(r: Result) -> str:
    """A contender, and how its work differs if it does."""
    kind = "other work" if r.ours else "reference"
    return f"{r.contender} ({kind}: {r.other})" if r.other else r.contender


def judge(
    races: Sequence[Race], rounds: int, file: Path, console: Console
) -> tuple[int, list[Result]]:
    """Race, compare with an earlier run, and say what became slower."""
    refuse_if(
        rounds < rounds_for(),
        f"`--against` needs at least {rounds_for()} rounds for its intervals; "
        f"`--rounds` is {rounds}",
    )
    record = read_record(file)
    then = {kept.key: kept for kept in record.kept}
    found: list[Change] = []
    results: list[Result] = []
    for race in races:
        some, changes = measured(race, then, rounds)
        results += show(race, some, console)
        found += changes
    console.print(_changes(found, record))
    code = code_of(found)
    for words in _verdict(found, record, code):
        click.echo(words)
    return code, results


def _changes(changes: Sequence[Change], record: Record) -> Table:
    table = Table(title=f"Beside {escape(record.label)}")
    for heading in ("race", "contender"):
        table.add_column(heading)
    for heading in ("ratio then", "now", "time now, in that then"):
        table.add_column(heading, justify="right")
    table.add_column("answer")
    for c in changes:
        ratios = ["" if k is None else f"{k.ratio:.3g}" for k in (c.then, c.now)]
        time = "" if c.low is None else f"{c.low:.2f} to {c.high:.2f}"
        answer = f"{c.standing}: {c.words}" if c.words else c.standing
        table.add_row(c.race, escape(c.contender), *ratios, time, escape(answer))
    return table


def _verdict(changes: Sequence[Change], record: Record, code: int) -> list[str]:
    """The answer in words, and what else may have made the difference."""
    names = {
        standing: [
            f"{c.race}, {c.contender}" for c in changes if c.standing == standing
        ]
        for standing in ("pass", "slower", "inconclusive")
    }
    limit, passed = f"{SLOWER:.0%}", len(names["pass"])
    words = {
        0: f"PASS: none of {passed} contenders takes {limit} more time than at "
        f"{record.label}",
        1: f"FAIL: more than {limit} slower than at {record.label}: "
        f"{'; '.join(names['slower'])}",
        3: "INCONCLUSIVE: "
        + ("; ".join(names["inconclusive"]) or "no contender could be compared")
        + "; try again with more `--rounds`, or on a quieter machine",
    }
    return [words[code], *_notes(record, code)]


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
