"""What `simval bench` does."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import click
from rich.console import Console

from simval.bench import Race, Result, find_races, run_race
from simval.bench.record import written
from simval.bench.untimed import Untimed, attempted, code_of_untimed
from simval.cli.options import refuse_if, write
from simval.cli.raced import history, judge, show, without_times

GROWTH = "growth"


def run(
    races: tuple[str, ...],
    rounds: int,
    against: Path | None,
    page: Path | None,
    path: Path | None,
    sizes: tuple[int, ...],
    workers: int | None,
    scheduler: str | None,
) -> int:
    """Do what `simval bench` is asked."""
    refuse_if(
        page is not None and (against is not None or path is not None),
        "`--page` draws what was measured and races nobody; give `--against` or "
        "`--json` to a call of its own",
    )
    alone = races == (GROWTH,) and against is None and page is None
    refuse_if(
        GROWTH in races and not alone,
        f"`{GROWTH}` is no race; name it alone",
    )
    refuse_if(
        bool(sizes or workers or scheduler) and not alone,
        f"`--cells`, `--workers` and `--scheduler` are of `{GROWTH}`; name it alone",
    )
    if alone:
        from simval.cli.growth import growth

        return growth(sizes, workers or 2, scheduler or "", path)
    if page is not None:
        return history(page, races)
    console = Console(highlight=False)
    chosen = find_races(races)
    if against is not None:
        code, results, untimed = judge(chosen, rounds, against, console)
    else:
        results, untimed = _raced(chosen, rounds, console)
        code = code_of_untimed(untimed)
    if path is not None:
        write(path, written(results, untimed))
    if untimed and against is None:
        click.echo(without_times(untimed, len(chosen)))
    return code


def _raced(
    races: Sequence[Race], rounds: int, console: Console
) -> tuple[list[Result], list[Untimed]]:
    results: list[Result] = []
    untimed: list[Untimed] = []
    for race in races:
        found = attempted(race, partial(run_race, race, rounds))
        show(race, found, console)
        if isinstance(found, Untimed):
            untimed.append(found)
        else:
            results += found
    return results, untimed
