"""What `simval bench` does."""

from pathlib import Path

from rich.console import Console

from simval.bench import Result, find_races, run_race
from simval.bench.record import written
from simval.cli.options import refuse_if, write
from simval.cli.raced import history, judge, show


def run(
    races: tuple[str, ...],
    rounds: int,
    against: Path | None,
    page: Path | None,
    path: Path | None,
) -> int:
    """Do what `simval bench` is asked."""
    refuse_if(
        page is not None and (against is not None or path is not None),
        "`--page` draws what was measured and races nobody; give `--against` or "
        "`--json` to a call of its own",
    )
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
