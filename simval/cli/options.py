"""Options that several commands share."""

from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from simval.errors import InputError
from simval.text import shown
from simval.vocabulary import ALPHA
from simval.whole import exact, read

PATH = click.Path(path_type=Path)

COLUMNS = (
    "What each column is, in their order: t,ax,ay,az,wx,wy,wz,mx,my,mz, - to ignore "
    "one; t[ms], t[us], t[ns] for a clock not in seconds.  [default: what the header "
    "says]"
)


class Whole(click.IntRange):
    """A whole number within its limits: 100000, 1e5."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> int:
        """Convert, and refuse what would be rounded."""
        number = read(value) if isinstance(value, str) else exact(value)
        if number is None:
            self.fail(f"{shown(value)} is not a whole number.", param, ctx)
        return int(super().convert(number, param, ctx))


class Rate(click.FloatRange):
    """A false-alarm rate: a number from 1e-12 to a half."""

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


def stated(name: str) -> bool:
    """Whether an option of the running command was given, even as its default."""
    source = click.get_current_context().get_parameter_source(name)
    return source not in (None, ParameterSource.DEFAULT, ParameterSource.DEFAULT_MAP)


def write(path: Path, text: str) -> None:
    """Write a file that the user named."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        msg = f"cannot write {path}: {error.strerror}; choose another file"
        raise InputError(msg) from None


def refuse_if(wrong: bool, message: str) -> None:
    """Refuse options that contradict each other."""
    if wrong:
        raise InputError(message)


alpha_option = click.option(
    "--alpha",
    type=Rate(),
    default=ALPHA,
    show_default=True,
    help="False-alarm rate of all checks together.",
)
