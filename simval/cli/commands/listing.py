"""`simval list`."""

from typing import Any

import click


@click.command(name="list")
def command(**options: Any) -> int:
    """List suites, studies with their parameters, scenes and installed plug-ins."""
    from simval.cli.listing import run

    return run(**options)
