"""`simval gate`."""

import json
from typing import Any

import click

from simval.cli.completing import runs
from simval.cli.options import alpha_option
from simval.cli.outputs import OUT, Command, Output
from simval.vocabulary import BASELINE

FILE = Output(dir_okay=False)


def _print_schema(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted:
        from simval.judge.formats import Document

        click.echo(json.dumps(Document.model_json_schema(), indent=1))
        context.exit(0)


@click.command(name="gate", cls=Command)
@click.argument("run", shell_complete=runs)
@click.option(
    "--baseline",
    type=OUT,
    default=BASELINE,
    show_default=True,
    help="Baseline to compare with; the default one is written if there is none yet.",
)
@click.option(
    "--update-baseline",
    metavar="REASON",
    help="Make this run the baseline, and store the reason in it.",
)
@click.option(
    "--reason",
    "reasons",
    metavar="KIND=WORDS",
    multiple=True,
    help="Why a kind of statistic, or a study, moved; one for each that did.",
)
@click.option(
    "--no-baseline",
    is_flag=True,
    help="Judge against theory only, without a baseline.",
)
@alpha_option
@click.option("--junit", type=FILE, help="Write JUnit XML to this file.")
@click.option("--summary", type=FILE, help="Write a Markdown summary to this file.")
@click.option(
    "--json", "json_file", type=FILE, help="Write every finding to this JSON file."
)
@click.option(
    "--all",
    "every",
    is_flag=True,
    help="Print every check that did not pass, not ten lines by kind.",
)
@click.option(
    "--table", is_flag=True, help="Print how many checks of each kind passed."
)
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
    crashed. In a GitHub workflow the command annotates failures and writes the step
    summary.
    """
    from simval.cli.gate import run

    return run(**options)
