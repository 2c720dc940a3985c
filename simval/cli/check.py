"""What `simval check` does."""

from contextlib import nullcontext

import click

from simval.check import check_plugin, told
from simval.check.words import to_json
from simval.cli.progress import CellBar, Quiet
from simval.cli.terminal import say


def run(plugin: str, seed: int, alpha: float, as_json: bool) -> int:
    """Do what `simval check` is asked."""
    with nullcontext(Quiet()) if as_json else CellBar() as progress:
        checked = check_plugin(plugin, seed=seed, alpha=alpha, progress=progress)
    if as_json:
        click.echo(to_json(checked), nl=False)
    else:
        say(told(checked).splitlines())
    return checked.result.exit_code
