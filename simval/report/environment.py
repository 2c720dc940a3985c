"""The templates: everything that comes from data is escaped in them."""

import hashlib
from base64 import b64encode
from functools import cache
from importlib import resources
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from simval.report.live import silent
from simval.report.paint import svg
from simval.report.panels import MANY, Drawing
from simval.report.table import sort_key, text
from simval.report.words import measured, number

SCRIPTS = ("sort.js", "points.js", "legends.js", "filter.js", "folds.js")
"""Files of the page's script, one after the other."""

NAMED = 100
"""What a figure leaves out is named one by one up to this many, the rest counted."""

PRINTED = 40
"""Rows of the longest table that is printed though it is folded."""


def template(*names: str) -> Template:
    """Load the first template of these names that this package has."""
    return _environment().select_template([f"{name}.html.j2" for name in names])


def script() -> dict[str, Any]:
    """The page's only script and its hash for the content security policy."""
    folder = resources.files("simval.report") / "templates"
    parts = [(folder / name).read_text(encoding="utf-8") for name in SCRIPTS]
    content = "\n".join(['"use strict";', *parts])
    digest = b64encode(hashlib.sha256(content.encode()).digest()).decode()
    return {"text": Markup(content), "digest": digest}


def _picture(drawing: Drawing) -> Markup:
    return Markup(svg(drawing))


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
    environment.globals.update(NAMED=NAMED, PRINTED=PRINTED, MANY=MANY, silent=silent)
    environment.globals.update(
        measured=measured, picture=_picture, text=text, sort_key=sort_key, script=script
    )
    return environment
