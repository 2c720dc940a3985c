"""What `simval completion` does."""

import click
from click.shell_completion import get_completion_class


def run(group: click.Command, shell: str) -> int:
    """Print the script of a shell that completes the program's words."""
    kind = get_completion_class(shell)
    assert kind is not None  # one of the choices
    click.echo(kind(group, {}, "simval", "_SIMVAL_COMPLETE").source())
    return 0
