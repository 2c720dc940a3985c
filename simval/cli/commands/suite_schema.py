"""`simval suite-schema`."""

from typing import Any

import click


@click.command(name="suite-schema")
def command(**options: Any) -> int:
    """Print the JSON Schema of suite files, for editors and other programs."""
    from simval.cli.suite_schema import run

    return run(**options)
