"""`simval check`."""

from typing import Any

import click

from simval.cli.options import Whole, alpha_option


@click.command(name="check")
@click.argument("plugin")
@click.option(
    "--seed",
    type=Whole(min=0),
    default=1,
    show_default=True,
    help="Seed of the noise.",
)
@alpha_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(**options: Any) -> int:
    """Measure your algorithm PLUGIN in two cells and judge it; keeps no run folder.

    PLUGIN is FILE.py, FILE.py:NAME, the name of an installed plug-in, or
    'command: PROGRAM {poses}'.

    The verdicts are those of `simval gate --no-baseline`. `simval sweep` measures more,
    and keeps it. Exit code 0 pass, 1 fail, 2 the plug-in cannot be loaded, 3
    inconclusive or refused, 4 it crashed.
    """
    from simval.cli.check import run

    return run(**options)
