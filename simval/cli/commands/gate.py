"""`simval gate`."""

import json
from pathlib import Path
from typing import Any

import click

from simval.cli.completing import runs
from simval.cli.options import PATH, alpha_option
from simval.vocabulary import BASELINE

FILE = click.Path(path_type=Path, dir_okay=False)


def _print_schema(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted:
        from simval.gate.formats import Document

        click.echo(json.dumps(Document.model_json_schema(), indent=1))
        context.exit(0)


@click.command(name="gate")
@click.argument("run", shell_complete=runs)
@click.option(
    "--baseline",
    type=PATH,
    default=BASELINE,
    show_default=True,
    help="Stored statistics to compare with.",
)
@click.option(
    "--update-baseline", metavar="REASON", help="Store this run, with the reason."
)
@click.option("--no-baseline", is_flag=True, help="Judge against theory only.")
@alpha_option
@click.option("--junit", type=FILE, help="Write JUnit XML.")
@click.option("--summary", type=FILE, help="Write a Markdown summary.")
@click.option("--json", "json_file", type=FILE, help="Write every finding as JSON.")
@click.option("--all", "every", is_flag=True, help="Print each failure, not by kind.")
@click.option("--table", is_flag=True, help="Print the counts of all checks.")
@click.option(
    "--samples",
    is_flag=True,
    help="Print the samples that the verdicts need, and those spent.",
)
@click.option(
    "--json-schema",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_schema,
    help="Print the JSON Schema of --json and stop.",
)
def command(**options: Any) -> int:
    """Judge RUN (a folder, or `latest`) against theory and the baseline.

    Exit code 0 pass, 1 fail, 3 inconclusive, refused or nothing measured, 4 a cell
    crashed.
    In a GitHub workflow it annotates failures and writes the step summary.
    """
    from simval.cli.gate import run

    return run(**options)
