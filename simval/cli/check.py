"""`simval check`."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Annotated

import click

from simval.cli.options import Alpha, AsJson, OutFile, Whole, declared, write
from simval.cli.outputs import step_summary
from simval.cli.terminal import show
from simval.vocabulary import ALPHA


@declared("check")
def command(
    plugin: str,
    seed: Annotated[int, Whole(min=0), "Seed of the noise."] = 1,
    alpha: Alpha = ALPHA,
    as_json: AsJson = False,
    summary: Annotated[OutFile | None, "Write a Markdown summary to this file."] = None,
    verbose: Annotated[
        bool,
        "Print everything: every statistic, what the plug-in declares, and "
        "what the answer rests on.",
    ] = False,
) -> int:
    """Measure your algorithm PLUGIN in two cells and judge it; keeps no run folder.

    PLUGIN is FILE.py, FILE.py:NAME, the name of an installed plug-in, or
    'command: PROGRAM {poses}'.

    The verdicts are those of `simval gate --no-baseline`. `simval sweep` measures more,
    and keeps it. In a GitHub workflow the command writes the step summary.

    Exit code 0 pass, 1 fail, 2 the plug-in cannot be loaded, 3 inconclusive or refused,
    4 it crashed.
    """
    from simval.account.markdown import text
    from simval.check import check_plugin
    from simval.check.explanation import to_json
    from simval.cli.progress import CellBar, Quiet

    with nullcontext(Quiet()) if as_json else CellBar() as progress:
        checked = check_plugin(plugin, seed=seed, alpha=alpha, progress=progress)
    if as_json:
        click.echo(to_json(checked), nl=False)
    else:
        show(checked.account, verbose=verbose)
    if summary is not None:
        write(summary, text(checked.account))
    step_summary(text(checked.account))
    return checked.result.exit_code
