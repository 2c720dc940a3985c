"""`simval selftest`."""

from typing import Any

import click

from simval.vocabulary import STUDIES


@click.command(name="selftest")
@click.option(
    "--quick", is_flag=True, help="Inject only an eighth of the faults, for CI."
)
@click.option(
    "--rates", is_flag=True, help="Measure the false-alarm rate and the power."
)
@click.option(
    "--share",
    type=click.FloatRange(0.0, 1.0, min_open=True),
    default=1.0,
    show_default=True,
    help="Share of the runs of --rates that are computed.",
)
@click.option(
    "--study",
    "studies",
    type=click.Choice(STUDIES),
    multiple=True,
    metavar="NAME",
    help="With --rates: only count the small p-values of this study on random "
    "settings; repeatable.",
)
def command(**options: Any) -> int:
    """Inject faults into the whole flow and check that the gate detects each.

    Exit code 0 if every fault ended in fail or inconclusive and every clean twin in
    pass, else 1. With --rates, 25 500 clean runs and 400 with each fault (an hour
    and a half on one processor) measure how often the gate is wrong.
    """
    from simval.cli.selftest import run

    return run(**options)
