"""`simval completion`."""

from typing import Literal

import click

from simval.cli.options import declared


@declared("completion")
def command(shell: Literal["bash", "zsh", "fish"]) -> int:
    """Print the script that lets SHELL complete commands, options, suites and runs.

    Add one line to the start-up file of the shell:

    \b
    bash  eval "$(simval completion bash)"   in ~/.bashrc
    zsh   eval "$(simval completion zsh)"    in ~/.zshrc
    fish  simval completion fish | source    in ~/.config/fish/config.fish
    """  # noqa: D301 (click looks for the character, so the text is not raw)
    from click.shell_completion import get_completion_class

    kind = get_completion_class(shell)
    assert kind is not None  # one of the choices
    group = click.get_current_context().find_root().command
    click.echo(kind(group, {}, "simval", "_SIMVAL_COMPLETE").source())
    return 0
