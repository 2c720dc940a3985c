"""Equations as MathML: every fraction, root and index of the documents, read again.

The reader below takes LaTeX apart by TeX's own rule, one token or one group for an
argument, and shares nothing with the converter.
"""

import ast
import re
from functools import cache
from xml.etree import ElementTree

import pytest
from places import ROOT

from docs.site.mathml import mathml

TOKEN = re.compile(r"\\[a-zA-Z]+|\\.|[{}]|[^\s{}\\]")
GREEK = re.compile("[^A-Za-z0-9]")
FUNCTION = re.compile("arctan|exp|ln|log|max|min|sin|cos|tan")  # a command each
ACCENT = re.compile(r"\\(hat|bar|tilde|dot|ddot|vec)\b")
TAKES = {"frac": 2, "tfrac": 2, "dfrac": 2, "sqrt": 1}


@cache
def written():
    """Every equation of the documents and the docstrings."""
    found = set()
    for path in (ROOT / "docs").rglob("*.md"):
        text = re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.S)
        found |= set(re.findall(r"\$\$(.+?)\$\$", text, re.DOTALL))
        text = re.sub(r"\$\$.+?\$\$|`[^`]*`", "", text, flags=re.DOTALL)
        found |= set(re.findall(r"\$([^$]+?)\$", text))
    for path in (ROOT / "simval").rglob("*.py"):
        source = path.read_text(encoding="utf-8")
        if ":math:" not in source and "math::" not in source:
            continue
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                text = ast.get_docstring(node) or ""
                found |= set(re.findall(r":math:`([^`]+)`", text))
                found |= set(re.findall(r"math:: ?((?:.+\n?)(?:\n?   .*\n?)*)", text))
    return sorted(re.sub(r"\\tag\{[^}]*\},?|\\\\|&", " ", text) for text in found)


def argument(tokens):
    """The next argument, as tokens."""
    first = tokens.pop(0)
    if first != "{":
        return [first]
    inside, depth = [], 1
    while depth:
        token = tokens.pop(0)
        depth += {"{": 1, "}": -1}.get(token, 0)
        inside.append(token)
    return inside[:-1]


def letters(tokens):
    """What is written of tokens: letters and digits, no commands."""
    return GREEK.sub("", "".join(t for t in tokens if not t.startswith("\\")))


def parts(tokens, names):
    """Arguments of these commands, in their order, those inside of others too."""
    tokens, found = list(tokens), []
    while tokens:
        token = tokens.pop(0).removeprefix("\\")
        if token in names:
            given = [argument(tokens) for _ in range(TAKES[token])]
            found.append([letters(each) for each in given])
            for each in given:
                found += parts(each, names)
    return found


def shown(latex, tag):
    """Letters of the children of each such element, in the order of the document."""
    tree = ElementTree.fromstring(mathml(latex, block=True))
    space = tree.tag.partition("math")[0]
    found = []
    for node in tree.iter(space + tag):
        texts = ("".join(c for c in part.itertext()) for part in node)
        found.append([GREEK.sub("", FUNCTION.sub("", text)) for text in texts])
    return found


@pytest.mark.ci  # a second: every docstring is parsed
@pytest.mark.parametrize("name", ["frac", "sqrt"])
def test_each_fraction_and_root_has_its_own_arguments(name):
    r"""``\frac12`` is a half and no twelve over what follows."""
    names = {n for n in TAKES if n.endswith(name)}
    wrong, count = [], 0
    for latex in written():
        if f"{name}" not in latex or "begin" in latex:
            continue
        expected = parts(TOKEN.findall(re.sub(r"\\(left|right)\.", "", latex)), names)
        found = shown(latex, f"m{name}")
        found = [["".join(each)] for each in found] if name == "sqrt" else found
        count += len(expected)
        if found != expected:
            wrong.append((latex, expected, found))
    assert wrong == []
    assert count > {"frac": 50, "sqrt": 15}[name]


@pytest.mark.ci
def test_an_index_stands_beside_an_accented_letter():
    """And not below it: only sums, limits and the like have something below."""
    below = []
    for latex in written():
        if "begin" in latex or not ACCENT.search(latex):
            continue
        for node in ElementTree.fromstring(mathml(latex, block=True)).iter():
            if node.tag.endswith(("munder", "munderover")) and not node[0].tag.endswith(
                "mo"
            ):
                below.append(latex)
    assert below == []


def test_known_ones():
    assert shown(r"\frac12\left(1 - x\right)", "mfrac") == [["1", "2"]]
    assert shown(r"\tfrac1{24}\,x", "mfrac") == [["1", "24"]]
    assert shown(r"\frac{a\frac1b}{2}", "mfrac") == [["a1b", "2"], ["1", "b"]]
    assert shown(r"2\sqrt 2D", "msqrt") == [["2"]]
    assert shown(r"x^23", "msup") == [["x", "2"]]
    assert shown(r"\hat q_k", "msub") == [["q", "k"]]
