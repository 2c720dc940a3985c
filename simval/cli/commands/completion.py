"""`simval completion`."""

import click


@click.command(name="completion")
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def command(context: click.Context, shell: str) -> int:
    r"""Print what makes SHELL complete commands, options, suites, scenes and runs.

    \b
    bash  eval "$(simval completion bash)"   in ~/.bashrc
    zsh   eval "$(simval completion zsh)"    in ~/.zshrc
    fish  simval completion fish | source    in ~/.config/fish/config.fish
    """
    from simval.cli.completion import run

    return run(context.find_root().command, shell)
