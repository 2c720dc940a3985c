"""The options of commands, read from the parameters of a function.

`declared` makes a command of a function. A parameter's annotation has its type and what
the help says, ``Annotated[int, "Seed of the noise."]``; beside them a type of click's
may stand, and a `dict` of its other settings. A parameter without a help is an
argument. What several commands take is declared here once, by a name of its own.

A shell starts the program at each key, so only names of `simval.vocabulary` and of
folders are looked at. Where no name fits, the shell completes files by itself.
"""

import math
import os
import shlex
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import replace
from inspect import Parameter, signature
from pathlib import Path
from types import NoneType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    get_args,
    get_origin,
    get_type_hints,
)

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

from simval.cli.outputs import Command, Input, Output, require_free
from simval.errors import InputError, noting
from simval.text import as_whole, read_whole, shown
from simval.units import OF_A_LOG
from simval.vocabulary import (
    RUNS,
    SCENES,
    STUDIES,
    TARGETS,
    GyroRows,
    builtin_suites,
)

if TYPE_CHECKING:
    from simval.imu.logs import Log

PROCESSORS = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
"""Processors that this process may use."""

EARTH = (9.76, 9.84)
"""Gravity on the Earth, m/s^2: on its highest mountain at the equator, at the poles."""


def declared(
    name: str, *more: click.Parameter
) -> Callable[[Callable[..., Any]], click.Command]:
    """Make a command of a function, with its parameters and some more."""

    def made(function: Callable[..., Any]) -> click.Command:
        hints = get_type_hints(function, include_extras=True)
        own = signature(function).parameters.values()
        params = [*(_parameter(each, hints[each.name]) for each in own), *more]
        return click.command(name, cls=Command, params=params)(function)

    return made


def _parameter(own: Parameter, hint: Any) -> click.Parameter:
    kind, notes = _noted(hint)
    settings: dict[str, Any] = {"type": kind}
    if kind is bool:
        settings = {"is_flag": True}
    elif kind is Path:
        settings = {"type": Input()}
    elif get_origin(kind) is Literal:
        settings = {"type": click.Choice(get_args(kind))}
    elif get_origin(kind) is tuple:
        settings = {"multiple": ... in get_args(kind)}
    for note in notes:
        settings |= note if isinstance(note, dict) else {}
        settings |= {"type": note} if isinstance(note, click.ParamType) else {}
    words = "".join(note for note in notes if isinstance(note, str))
    required = own.default is Parameter.empty
    default = None if required else own.default
    # click takes a default of None for one that is given
    settings |= {} if required else {"default": default}
    if not words:
        return click.Argument([own.name], required=required, **settings)
    title = settings.pop("name", f"--{own.name.replace('_', '-')}")
    if default not in (None, ()) and default is not False:
        settings = {"show_default": True} | settings
    names = [title, own.name]
    return click.Option(names, required=required, help=words, **settings)


def _noted(hint: Any) -> tuple[Any, list[Any]]:
    """The plain type of an annotation, and the notes in its `Annotated`."""
    if get_origin(hint) is Annotated:
        kind, *notes = get_args(hint)
        plain, inner = _noted(kind)
        return plain, [*inner, *notes]
    if NoneType in get_args(hint):
        return _noted(next(kind for kind in get_args(hint) if kind is not NoneType))
    return hint, []


class Whole(click.IntRange):
    """A whole number within limits; 100000 may be written 1e5."""

    name = "integer"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> int:
        """Read a whole number, and refuse one that would have to be rounded."""
        number = read_whole(value) if isinstance(value, str) else as_whole(value)
        if number is None:
            self.fail(f"{shown(value)} is not a whole number.", param, ctx)
        return int(super().convert(number, param, ctx))


class Number(click.FloatRange):
    """A number within limits, which NaN never is."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Read a number, and refuse NaN, which click does not compare."""
        number = float(super().convert(value, param, ctx))
        if number != number:
            self.fail(f"{value} is not a number.", param, ctx)
        return number


class _Positive(click.types.FloatParamType):
    """A finite number above zero."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Read a number, and refuse what is not finite and above zero."""
        number = float(super().convert(value, param, ctx))
        if not 0.0 < number < float("inf"):
            self.fail(f"{value} is not a finite number above 0.", param, ctx)
        return number


class Numbers(click.ParamType[tuple[float, ...]]):
    """Finite numbers between commas, as many as the name lists: X,Y,Z."""

    def __init__(self, name: str) -> None:
        self.name = name

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """Convert, and refuse any other count."""
        found = tuple(numbers(param.opts[0] if param else "", value, self.name))
        if len(found) != self.name.count(",") + 1:
            self.fail(f"{value} is not {self.name}, with commas between.", param, ctx)
        return found


class _Gravity(click.types.FloatParamType):
    """Gravity in m/s^2, with a warning if it occurs nowhere on the Earth."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Read gravity, and warn if it occurs nowhere on the Earth."""
        g = float(super().convert(value, param, ctx))
        if g > 0.0 and not EARTH[0] <= g <= EARTH[1]:
            click.echo(
                f"warning: `--g` is {g:g} m/s^2, and gravity on the Earth is "
                f"{EARTH[0]} to {EARTH[1]}: unless the sensor is elsewhere, scales are "
                f"then {g / EARTH[1]:.2g} times what they should be; state it in m/s^2",
                err=True,
            )
        return g


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
    """Names of studies, each with the dot that comes before a parameter."""
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


LogPath = Annotated[Path, dict(metavar="LOG")]
RunName = Annotated[str, dict(shell_complete=runs)]
OutFile = Annotated[Path, Output(dir_okay=False)]
PROJECT_FILES = dict(
    type=(click.Choice(TARGETS), Output(dir_okay=False)),
    multiple=True,
    metavar="PROJECT FILE",
)
"""Files to write for projects, each by its name."""
OutFolder = Annotated[Path, Output()]
Positive = Annotated[float, _Positive()]
StatedGravity = Annotated[float, _Gravity()]
Rate = Annotated[
    float | None, "Rows per second of a LOG that has no clock.", dict(metavar="HZ")
]
Columns = Annotated[
    str | None,
    "The columns of LOG in their order, as t,ax,ay,az,wx,wy,wz,mx,my,mz,temp, with - "
    "for one to ignore, t[ms], t[us] or t[ns] for a clock that is not in seconds, and "
    "temp[K], temp[degF] or temp[raw/340+36.53] for a temperature not in degC.  "
    "[default: from the header]",
]
Instance = Annotated[
    str | None,
    "The topic, table or sensor of LOG to read, where it has more than one.",
    dict(metavar="NAME"),
]


def unit_words(sensor: str) -> str:
    """Help of the option that states the unit of a sensor's readings."""
    names = list(OF_A_LOG[sensor])
    return (
        f"Unit of the readings: {', '.join(names)}, or {names[0]} per raw unit as a "
        "number."
    )


AccelerometerUnit = Annotated[
    str | None, unit_words("accelerometer"), dict(metavar="UNIT")
]
GyroUnit = Annotated[str | None, unit_words("gyro"), dict(metavar="UNIT")]
From = Annotated[
    str | None,
    "Read LOG from this time on: seconds as the command prints them, or a time of day "
    "as the log writes it.",
    dict(name="--from", metavar="TIME"),
]
Until = Annotated[
    str | None,
    "Read LOG until this time.",
    dict(name="--until", metavar="TIME"),
]
Rest = Annotated[
    Positive | None,
    "State that the first SECONDS are a rest.  [default: found in the log]",
    dict(metavar="SECONDS"),
]
RowsOf = Annotated[
    GyroRows,
    "What a row of the gyroscope is: the mean rate over the step "
    "before its stamp or after it, or the rate at that instant. If the "
    "log can show it, the accelerometer decides; otherwise it is taken "
    "as before.",
    dict(name="--gyro-rows"),
]
GyroDelay = Annotated[
    float,
    Number(-500.0, 500.0),
    "How late these rows are, compared with the accelerometer's.",
    dict(metavar="MS"),
]
Page = Annotated[
    OutFile | None,
    "Write a page with figures, a single HTML file.",
    dict(name="--report"),
]
AsJson = Annotated[bool, "Print one JSON object.", dict(name="--json")]
Alpha = Annotated[
    float,
    Number(1e-12, 0.5),
    "False-alarm rate of all checks together.",
    dict(metavar="RATE"),
]


def refusing(log: "Log") -> AbstractContextManager[None]:
    """Add to an error raised inside which columns and units were read from the log."""
    return noting(lambda: [*log.described(), log.unit_line()])


def with_rows(log: "Log", kind: GyroRows, delay_ms: float) -> "Log":
    """The log with its gyroscope's rows as stated; `before` until they are found."""
    from simval.imu.logs import Rows

    if log.gyro is None and (kind != "found" or delay_ms):
        msg = (
            f"{log.path} has no gyroscope, so `--gyro-rows` and `--gyro-delay` "
            "have no meaning; leave them out, or name the columns of a "
            "gyroscope (--columns)"
        )
        raise InputError(msg)
    known = "before" if kind == "found" else kind
    return replace(log, gyro_rows=Rows(kind=known, delay=1e-3 * delay_ms))


def stated(name: str) -> bool:
    """True if an option of the running command was given, even as its default."""
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


GIVEN = (ParameterSource.COMMANDLINE, ParameterSource.ENVIRONMENT)


def numbers(option: str, words: str, unit: str) -> list[float]:
    """Numbers between commas; none of an empty word."""
    try:
        found = [float(each) for each in words.split(",")] if words else []
    except ValueError:
        found = [math.nan]
    if not all(map(math.isfinite, found)):
        msg = f"`{option}` is {words!r}; give numbers with commas between them, {unit}"
        raise InputError(msg)
    return found


def command_again() -> str:
    """The running command as it could be typed again.

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
    return [
        word
        for each in many
        for word in (title, *map(_shown, each if isinstance(each, tuple) else [each]))
    ]


def _shown(value: Any) -> str:
    """A value as it is typed; a path by its name alone, as pages are shared."""
    if isinstance(value, Path):
        return value.name
    text = str(value)
    return Path(text).name if "/" in text and Path(text).exists() else text
