"""What `simval suite-schema` does."""

import json

import click

from simval.sweep.suite import suite_schema


def run() -> int:
    """Do what `simval suite-schema` is asked."""
    click.echo(json.dumps(suite_schema(), indent=2))
    return 0
