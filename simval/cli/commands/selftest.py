"""`simval selftest`."""

from typing import Any

import click


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
def command(**options: Any) -> int:
    """Inject faults into the whole flow and check that the gate detects each.

    Exit code 0 if every fault ended in fail or inconclusive and every clean twin in
    pass, else 1. With --rates, 25 500 clean runs and 400 with each fault (an hour
    on one processor) measure how often the gate is wrong.
    """
    from simval.cli.selftest import run

    return run(**options)
