"""`simval suite-schema`."""

import json

import click

from simval.sweep.suite import suite_schema


@click.command(name="suite-schema")
def command() -> int:
    """Print the JSON Schema of suite files, for editors and other programs."""
    click.echo(json.dumps(suite_schema(), indent=2))
    return 0
