"""`simval check`."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Annotated

import click

from simval.cli.options import Alpha, AsJson, Whole, declared
from simval.cli.terminal import say
from simval.vocabulary import ALPHA


@declared("check")
def command(
    plugin: str,
    seed: Annotated[int, Whole(min=0), "Seed of the noise."] = 1,
    alpha: Alpha = ALPHA,
    as_json: AsJson = False,
) -> int:
    """Measure your algorithm PLUGIN in two cells and judge it; keeps no run folder.

    PLUGIN is FILE.py, FILE.py:NAME, the name of an installed plug-in, or
    'command: PROGRAM {poses}'.

    The verdicts are those of `simval gate --no-baseline`. `simval sweep` measures more,
    and keeps it. Exit code 0 pass, 1 fail, 2 the plug-in cannot be loaded, 3
    inconclusive or refused, 4 it crashed.
    """
    from simval.check import check_plugin, told
    from simval.check.explanation import to_json
    from simval.cli.progress import CellBar, Quiet

    with nullcontext(Quiet()) if as_json else CellBar() as progress:
        checked = check_plugin(plugin, seed=seed, alpha=alpha, progress=progress)
    if as_json:
        click.echo(to_json(checked), nl=False)
    else:
        say(told(checked).splitlines())
    return checked.result.exit_code
