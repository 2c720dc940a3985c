"""What a section is, and what it is made from."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from simval.sweep import Run
from simval.verdict import Verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """What every section may read.

    Attributes
    ----------
    run : Run
        The run folder's content.
    verdicts : tuple of Verdict
        All checks against theory.
    alpha : float
        False-alarm rate that they share.
    """

    run: Run
    verdicts: tuple[Verdict, ...]
    alpha: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A part of the page.

    Attributes
    ----------
    anchor : str
        Its id on the page.
    title : str
        Its heading.
    body : Markup
        Its HTML.
    figures : mapping
        The SVG of each of its figures, by name.
    """

    anchor: str
    title: str
    body: Markup
    figures: Mapping[str, str]


def made(
    anchor: str,
    title: str,
    figures: Mapping[str, str] = MappingProxyType({}),
    **values: object,
) -> Section:
    """Render a section from the template of the same name.

    Parameters
    ----------
    anchor : str
        Id of the section and name of its template.
    title : str
        Heading.
    figures : mapping, default empty
        The SVG of each figure, by name; given to the template too.
    **values : object
        What the template needs.

    Returns
    -------
    Section
        With its HTML.
    """
    text = template(anchor).render(figures=figures, **values)
    body = Markup(text)  # escaped within the template
    return Section(anchor=anchor, title=title, body=body, figures=figures)


def template(name: str) -> Template:
    """Load a template of this package; everything in it is escaped.

    Parameters
    ----------
    name : str
        File name without its ending.

    Returns
    -------
    Template
        Ready to render.
    """
    return _environment().get_template(f"{name}.html.j2")


def number(value: float | None, digits: int = 6) -> str:
    """Spell a number for a person.

    Parameters
    ----------
    value : float or None
        The number.
    digits : int, default 6
        Significant digits.

    Returns
    -------
    str
        A dash for None.
    """
    return "–" if value is None else f"{value:.{digits}g}"  # noqa: RUF001


def measured(value: float, error: float) -> str:
    """Spell a value and its standard error with digits that mean something.

    Parameters
    ----------
    value, error : float
        The value and its standard error.

    Returns
    -------
    str
        Two digits of the error, the value to the same place.
    """
    if not error > 0.0:
        return number(value)
    exponent = int(f"{max(abs(value), error):e}".partition("e")[2])
    places = max(0, exponent - int(f"{error:e}".partition("e")[2]) + 1)
    scale = 10.0**exponent
    power = f"e{exponent}" if not -3 <= exponent <= 4 else ""
    if not power:
        scale, places = 1.0, max(0, places - exponent)
    return f"{value / scale:.{places}f} ± {error / scale:.{places}f}{power}"


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("simval.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(number=number)
    environment.globals.update(measured=measured)
    return environment
