"""What several commands share: options, completed values, the command in words.

A shell starts the program at each key, so only names of `simval.vocabulary` and of
folders are looked at. Where no name fits, the shell completes files by itself.
"""

import shlex
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

from simval.cli.outputs import OUT, Input, require_free
from simval.errors import InputError
from simval.text import as_whole, read_whole, shown
from simval.units import OF_A_LOG
from simval.vocabulary import ALPHA, RUNS, SCENES, STUDIES, builtin_suites

Command = TypeVar("Command", bound=Callable[..., Any])
PATH = Input()

COLUMNS = (
    "The columns of LOG in their order, as t,ax,ay,az,wx,wy,wz,mx,my,mz, with - for "
    "one to ignore, and t[ms], t[us] or t[ns] for a clock that is not in seconds.  "
    "[default: what the header says]"
)

ROWS = "Rows per second of a LOG that has no clock."
EARTH = (9.76, 9.84)
"""Gravity on the Earth, m/s^2: on its highest mountain at the equator, at the poles."""

REST = "State that the first SECONDS are a rest.  [default: found in the log]"


class Whole(click.IntRange):
    """A whole number within its limits: 100000, 1e5."""

    name = "integer"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> int:
        """Convert, and refuse what would be rounded."""
        number = read_whole(value) if isinstance(value, str) else as_whole(value)
        if number is None:
            self.fail(f"{shown(value)} is not a whole number.", param, ctx)
        return int(super().convert(number, param, ctx))


class Rate(click.FloatRange):
    """A false-alarm rate: a number from 1e-12 to a half."""

    name = "rate"

    def __init__(self) -> None:
        super().__init__(1e-12, 0.5)

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Convert, and refuse NaN."""
        rate = float(super().convert(value, param, ctx))
        if not rate >= 1e-12:
            self.fail(f"{value!r} is not a rate; give a number from 1e-12 to 0.5.")
        return rate


class Positive(click.types.FloatParamType):
    """A finite number above zero."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Convert, and refuse zero, what is below it, NaN and infinity."""
        number = float(super().convert(value, param, ctx))
        if not 0.0 < number < float("inf"):
            self.fail(f"{value} is not a finite number above 0.", param, ctx)
        return number


class Gravity(click.types.FloatParamType):
    """Gravity in m/s^2; one that is nowhere on the Earth is said."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Convert, and say what is not of the Earth."""
        g = float(super().convert(value, param, ctx))
        if g > 0.0 and not EARTH[0] <= g <= EARTH[1]:
            click.echo(
                f"warning: `--g` is {g:g} m/s^2, and gravity on the Earth is "
                f"{EARTH[0]} to {EARTH[1]}: unless the sensor is elsewhere, scales are "
                f"then {g / EARTH[1]:.2g} times too large; state it in m/s^2",
                err=True,
            )
        return g


def unit_option(sensor: str) -> Callable[[Command], Command]:
    """The option that states the unit of a sensor's readings."""
    names = list(OF_A_LOG[sensor])
    text = f"Unit of the readings: {', '.join(names)}, or {names[0]} per raw "
    text += "unit as a number."
    return click.option(f"--{sensor}-unit", metavar="UNIT", help=text)


def stated(name: str) -> bool:
    """Whether an option of the running command was given, even as its default."""
    source = click.get_current_context().get_parameter_source(name)
    return source not in (None, ParameterSource.DEFAULT, ParameterSource.DEFAULT_MAP)


def write(path: Path, text: str) -> None:
    """Write a file that the user named."""
    require_free(path)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        msg = f"cannot write {path}: {error.strerror}; choose another file"
        raise InputError(msg) from None


def refuse_if(wrong: bool, message: str) -> None:
    """Refuse options that contradict each other."""
    if wrong:
        raise InputError(message)


log_argument = click.argument("path", metavar="LOG", type=PATH)
rate_option = click.option("--rate", type=float, metavar="HZ", help=ROWS)
columns_option = click.option("--columns", help=COLUMNS)
rest_option = click.option("--rest", type=Positive(), metavar="SECONDS", help=REST)
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object."
)
page_option = click.option(
    "--report", "page", type=OUT, help="Write a page with figures, a single HTML file."
)
alpha_option = click.option(
    "--alpha",
    type=Rate(),
    default=ALPHA,
    show_default=True,
    help="False-alarm rate of all checks together.",
)


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


Completer = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def suites(
    context: click.Context, parameter: click.Parameter, word: str
) -> list[CompletionItem]:
    """Suites of the package, else TOML files."""
    return _fitting(builtin_suites(), word)


def scenes(
    context: click.Context, parameter: click.Parameter, word: str
) -> list[CompletionItem]:
    """Scenes of the package, else Python files."""
    return _fitting(SCENES, word)


def studies(
    context: click.Context, parameter: click.Parameter, word: str
) -> list[CompletionItem]:
    """Studies with the dot that their key follows."""
    return _fitting([f"{study}." for study in STUDIES], word, or_files=False)


def runs(
    context: click.Context, parameter: click.Parameter, word: str
) -> list[CompletionItem]:
    """`latest` and the runs where sweeps put them, the newest first, else folders."""
    try:
        found = sorted(RUNS.glob("*/run.sqlite"), key=_age, reverse=True)
    except OSError:  # a folder that cannot be read completes nothing
        found = []
    folders = [file.parent for file in found]
    return _fitting(["latest", *map(str, folders)], word) if folders else _files(word)


def _age(path: Path) -> float:
    return path.stat().st_mtime


def _fitting(
    names: Iterable[str], word: str, *, or_files: bool = True
) -> list[CompletionItem]:
    found = [CompletionItem(name) for name in names if name.startswith(word)]
    return found if found or not or_files else _files(word)


def _files(word: str) -> list[CompletionItem]:
    return [CompletionItem(word, type="file")]
