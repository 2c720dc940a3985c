"""Equations as MathML, converted when the site is built: no script and no font.

docutils brings the converter; a command that it does not know fails the build.
"""

import re
from html import escape, unescape
from typing import Any
from xml.etree import ElementTree

from docutils import nodes
from docutils.utils.math import MathError, latex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

from docs.site.equations import TAG, anchor

_LOGGER = logging.getLogger(__name__)

# what the sources write and the converter calls otherwise
_SPELLINGS = (
    (re.compile(r"\\dots\b"), r"\\ldots "),
    (re.compile(r"\\(bigg?|Bigg?)(?![a-zA-Z])"), r"\\\1l"),
    (re.compile(r"\\textstyle\b"), ""),
    (re.compile(r"\\[lr]vert\b"), "|"),
)
# an argument as TeX takes it: a group, a command or one letter, where the converter
# takes as many digits as there are
_GROUP = r"\{(?:[^{}]|\{(?:[^{}]|\{(?:[^{}]|\{[^{}]*\})*\})*\})*\}"
_ARGUMENT = rf"\s*({_GROUP}|\\[a-zA-Z]+|[^\s{{}}\\])"
_TWO = re.compile(rf"\\([td]?frac|binom)(?![a-zA-Z]){_ARGUMENT}{_ARGUMENT}")
_ONE = re.compile(rf"\\(sqrt)(?![a-zA-Z\[]){_ARGUMENT}")
_DIGITS = re.compile(r"([\^_])(\d)(?=\d)")
_SPACE = "http://www.w3.org/1998/Math/MathML"
_ACCENTS = frozenset(latex2mathml.accents.values())
_ENTITY = re.compile(r"&(?!lt;|gt;|amp;)\w+;")  # those of HTML that XML does not know
_DOCSTRING = re.compile(r"/(simval/[\w/]+)\.py:docstring of ")
_TAG = re.compile(TAG + r"\s*,?")


def mathml(latex: str, *, block: bool) -> str:
    """Presentation MathML of an equation without its tags.

    Raises
    ------
    MathError
        If a command is not known.
    """
    for pattern, replacement in _SPELLINGS:
        latex = pattern.sub(replacement, latex)
    latex = _DIGITS.sub(r"\1{\2}", _grouped(latex))
    converted = latex2mathml.tex2mathml(latex, as_block=block)
    tree = ElementTree.fromstring(_ENTITY.sub(lambda m: unescape(m[0]), converted))
    for node in tree.iter():
        _close_bars(node)
        _below_accent(node)
    ElementTree.register_namespace("", _SPACE)
    return ElementTree.tostring(tree, encoding="unicode")


def _grouped(latex: str) -> str:
    """Fractions and roots with arguments in braces, those within arguments too."""
    latex = _TWO.sub(lambda m: rf"\{m[1]}{_inside(m[2])}{_inside(m[3])}", latex)
    return _ONE.sub(lambda m: rf"\{m[1]}{_inside(m[2])}", latex)


def _inside(argument: str) -> str:
    bare = argument[1:-1] if argument.startswith("{") else argument
    return f"{{{_grouped(bare)}}}"


def _close_bars(node: ElementTree.Element) -> None:
    """Leave no space beside the bars of a size: they are no relation."""
    if node.tag == f"{{{_SPACE}}}mo" and node.text in ("|", "‖"):
        node.attrib |= {"lspace": "0", "rspace": "0"}


def _below_accent(node: ElementTree.Element) -> None:
    """Put the index of an accented letter beside it; the converter puts it below."""
    if node.tag != f"{{{_SPACE}}}munderover" or node[2].text not in _ACCENTS:
        return
    letter, index, accent = node
    over = ElementTree.Element(f"{{{_SPACE}}}mover", {"accent": "true"})
    over.extend((letter, accent))
    node.tag = f"{{{_SPACE}}}msub"
    node[:] = (over, index)


def display(latex: str, module: str = "") -> str:
    """HTML of a displayed equation, its numbers at the right with anchors.

    Where several lines have numbers of their own, each stands in its line.
    """
    numbers = [number for tag in re.findall(TAG, latex) for number in split(tag)]
    body = latex.strip().rstrip(",")
    lines = [line.strip() for line in re.split(r"\\\\(?!\[)", body)]
    if len(re.findall(TAG, latex)) > 1:
        lines = [_TAG.sub(lambda m: rf"\qquad\mathrm{{({m[1]})}} ", x) for x in lines]
        shown = ""
    else:
        lines = [_TAG.sub("", line) for line in lines]
        shown = ", ".join(f"({number})" for number in numbers)
    body = r"\\".join(lines)
    if (len(lines) > 1 or "&" in body) and r"\begin{" not in body:
        body = rf"\begin{{aligned}}{body}\end{{aligned}}"
    anchors = "".join(
        f'<span id="{escape(anchor(number, module))}"></span>' for number in numbers
    )
    side = f'<span class="number">{escape(shown)}</span>' if shown else ""
    formula = mathml(body, block=True)
    return f'<div class="equation">{anchors}<div>{formula}</div>{side}</div>\n'


def split(tag: str) -> list[str]:
    """Numbers in a tag: ``K1, (8)`` has two."""
    return [part.strip().strip("()") for part in tag.split(",")]


def _safely(make: Any, node: nodes.Element) -> str:
    try:
        return str(make())
    except MathError as error:
        _LOGGER.warning("no equation: %s in %s", error, node.astext(), location=node)
        return f"<code>{escape(node.astext())}</code>"


def _visit_inline(self: Any, node: nodes.math) -> None:
    self.body.append(_safely(lambda: mathml(node.astext(), block=False), node))
    raise nodes.SkipNode


def _visit_block(self: Any, node: nodes.math_block) -> None:
    module = _module(node)
    self.body.append(_safely(lambda: display(node.astext(), module), node))
    raise nodes.SkipNode


def _module(node: nodes.Element) -> str:
    """Module whose docstring has an equation; empty for that of a written page."""
    found = _DOCSTRING.search(node.source or "")
    return found[1].removesuffix("/__init__").replace("/", ".") if found else ""


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (_visit_inline, None), (_visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
