"""`simval report`."""

from typing import Any

import click

from simval.cli.completing import runs
from simval.cli.options import PATH, alpha_option
from simval.cli.outputs import OUT, Command
from simval.vocabulary import BASELINE


@click.command(name="report", cls=Command)
@click.argument("run", shell_complete=runs)
@click.option(
    "--out", type=OUT, help="Page to write.  [default: report.html in the run folder]"
)
@click.option(
    "--figures",
    "pictures",
    type=OUT,
    help="Write each figure to this folder too, as SVG and PNG.",
)
@click.option(
    "--only",
    "names",
    multiple=True,
    metavar="NAME",
    help="With --figures, write only this figure; may be repeated.",
)
@click.option(
    "--tables",
    "lists",
    type=OUT,
    help="Write each table, with all its rows, to this folder as CSV.",
)
@click.option(
    "--baseline",
    type=PATH,
    is_flag=False,
    flag_value=str(BASELINE),
    metavar="[FILE]",
    help="Say on the page what changed since this baseline; put the option after RUN.  "
    f"[default file: {BASELINE}]",
)
@click.option(
    "--against",
    metavar="RUN",
    help="Say on the page what changed since this other run.",
)
@click.option(
    "--open",
    "opened",
    is_flag=True,
    help="Write the page with every fold open, to print.",
)
@alpha_option
def command(**options: Any) -> int:
    """Write RUN (a folder, or `latest`) as one self-contained HTML file.

    The first screen says how wrong the algorithms are, whether theory says so too and,
    with --baseline or --against, whether they are worse than before. The last line
    printed is the path of the page.
    """
    from simval.cli.report import run

    return run(**options)
