"""`simval suite-schema`."""

from __future__ import annotations

import json

import click

from simval.cli.options import declared


@declared("suite-schema")
def command() -> int:
    """Print the JSON Schema of suite files, for editors and other programs."""
    from simval.sweep.suite import suite_schema

    click.echo(json.dumps(suite_schema(), indent=2))
    return 0
