"""`simval check`."""

from contextlib import nullcontext

import click

from simval.check import check_plugin, told
from simval.check.document import to_json
from simval.cli.options import alpha_option
from simval.cli.progress import CellBar, Quiet


@click.command(name="check")
@click.argument("plugin")
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="Seed of the noise.",
)
@alpha_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(plugin: str, seed: int, alpha: float, as_json: bool) -> int:
    """Measure PLUGIN in two cells and judge it, without leaving a run.

    PLUGIN is FILE.py, FILE.py:NAME, the name of an installed plug-in, or
    'command: PROGRAM {poses}'.

    Exit code 0 pass, 1 fail, 2 it cannot be loaded, 3 inconclusive or refused, 4 it
    crashed. The verdicts are the gate's, against theory alone; `simval sweep` measures
    more, and keeps it.
    """
    with nullcontext(Quiet()) if as_json else CellBar() as progress:
        checked = check_plugin(plugin, seed=seed, alpha=alpha, progress=progress)
    click.echo(to_json(checked) if as_json else told(checked), nl=not as_json)
    return checked.result.exit_code
