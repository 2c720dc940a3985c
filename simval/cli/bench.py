"""What `simval bench` does."""

from pathlib import Path

from rich.console import Console

from simval.bench import Result, find_races, run_race
from simval.bench.record import written
from simval.cli.options import refuse_if, write
from simval.cli.raced import history, judge, show

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
    results: list[Result] = []
    if against is not None:
        code, results = judge(find_races(races), rounds, against, console)
    else:
        code = 0
        for race in find_races(races):
            results += show(race, run_race(race, rounds), console)
    if path is not None:
        write(path, written(results))
    return code
