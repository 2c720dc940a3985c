"""Every command: usage, options and defaults, as its ``--help`` says them."""

import inspect
from collections.abc import Iterator

import click

import simval.cli
from docs.site.markdown import definitions, page, plain
from simval.cli import group

_LEAD = "Each command says the same with `--help`."
_WIDTH = 10_000  # columns: nothing is broken or shortened


def commands() -> Iterator[tuple[str, click.Command, click.Context]]:
    """Every command by its words, in the order of the table, groups' members too."""
    top = click.Context(
        group, info_name="simval", terminal_width=_WIDTH, **group.context_settings
    )
    yield from _below(group, top)


def _below(
    parent: click.Group, context: click.Context
) -> Iterator[tuple[str, click.Command, click.Context]]:
    for name in parent.list_commands(context):
        command = parent.get_command(context, name)
        if command is None or command.hidden:
            continue
        inside = click.Context(
            command, parent=context, info_name=name, terminal_width=_WIDTH
        )
        yield inside.command_path, command, inside
        if isinstance(command, click.Group):
            yield from _below(command, inside)


def commands_page() -> str:
    """Page of all commands."""
    sections = [_section(*found) for found in commands()]
    return page("Commands", _LEAD, plain(_exit_codes()), *sections)


def _exit_codes() -> str:
    paragraphs = (simval.cli.__doc__ or "").split("\n\n")
    return next(part for part in paragraphs if part.startswith("Exit codes"))


def _section(words: str, command: click.Command, context: click.Context) -> str:
    usage = f"{words} {' '.join(command.collect_usage_pieces(context))}"
    options = [
        (f"`{record[0]}`", plain(record[1]))
        for parameter in command.get_params(context)
        if isinstance(parameter, click.Option)
        and (record := parameter.get_help_record(context))
    ]
    texts = (f"## {words}", f"```text\n{usage}\n```", _help(command.help or ""))
    return "\n\n".join((*texts, definitions(options)))


def _help(text: str) -> str:
    # click keeps the lines of a paragraph that begins with a backspace character
    paragraphs = inspect.cleandoc(text).split("\n\n")
    return "\n\n".join(
        f"```text\n{part.lstrip(chr(8)).strip(chr(10))}\n```"
        if part.startswith("\b")
        else plain(part)
        for part in paragraphs
    )
