"""`simval report`."""

from typing import Any

import click

from simval.cli.completing import runs
from simval.cli.options import PATH, alpha_option
from simval.vocabulary import BASELINE


@click.command(name="report")
@click.argument("run", shell_complete=runs)
@click.option(
    "--out", type=PATH, help="File to write.  [default: report.html in the run folder]"
)
@click.option(
    "--figures",
    "pictures",
    type=PATH,
    help="Write each figure to this folder, as SVG and PNG.",
)
@click.option(
    "--only",
    "names",
    multiple=True,
    metavar="NAME",
    help="With --figures: only this figure; may be repeated.",
)
@click.option(
    "--tables",
    "lists",
    type=PATH,
    help="Write each table, whole, to this folder as CSV.",
)
@click.option(
    "--baseline",
    type=PATH,
    is_flag=False,
    flag_value=str(BASELINE),
    metavar="[FILE]",
    help="Say what changed from the stored statistics.  [default file: "
    f"{BASELINE}; give it after RUN]",
)
@click.option(
    "--against", metavar="RUN", help="Say what changed from this other run folder."
)
@click.option(
    "--open", "opened", is_flag=True, help="Write every fold open, as for print."
)
@alpha_option
def command(**options: Any) -> int:
    """Write RUN (a folder, or `latest`) as one self-contained HTML file.

    Its first screen says how wrong the algorithms are, whether that is as theory says
    and, with --baseline or --against, whether it is worse than before.

    The last line printed is the path of the file.
    """
    from simval.cli.report import run

    return run(**options)
