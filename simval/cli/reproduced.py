"""The command that is running, as a page may show it."""

import shlex
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

GIVEN = (ParameterSource.COMMANDLINE, ParameterSource.ENVIRONMENT)


def command_again() -> str:
    """Words of the running command: what was given, in the order of its help.

    Pages are shared, so a path is shown by its name alone.
    """
    context = click.get_current_context()
    words = context.command_path.split()
    for parameter in context.command.params:
        name = parameter.name or ""
        if context.get_parameter_source(name) not in GIVEN:
            continue
        words += _words(parameter, context.params.get(name))
    return shlex.join(words)


def _words(parameter: click.Parameter, value: Any) -> list[str]:
    many = value if isinstance(value, tuple | list) else [value]
    if isinstance(parameter, click.Argument):
        return [_shown(each) for each in many]
    title = max(parameter.opts, key=len)
    if getattr(parameter, "is_flag", False):
        return [title] if value else []
    return [word for each in many for word in (title, _shown(each))]


def _shown(value: Any) -> str:
    """A value as it is typed; of a path its name, wherever it is."""
    if isinstance(value, Path):
        return value.name
    text = str(value)
    return Path(text).name if "/" in text and Path(text).exists() else text
