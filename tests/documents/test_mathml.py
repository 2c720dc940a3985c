"""Equations as MathML: fractions, roots and indices of known ones, read again."""

import re
from xml.etree import ElementTree

import pytest

from docs.site.mathml import mathml

LETTERS = re.compile("[^A-Za-z0-9]")


def shown(latex, tag):
    """Letters of the children of each such element, in the order of the document."""
    tree = ElementTree.fromstring(mathml(latex, block=True))
    return [
        [LETTERS.sub("", "".join(part.itertext())) for part in node]
        for node in tree.iter(tree.tag.partition("math")[0] + tag)
    ]


@pytest.mark.parametrize(
    ("latex", "tag", "parts"),
    [
        (r"\frac12\left(1 - x\right)", "mfrac", [["1", "2"]]),
        (r"\tfrac1{24}\,x", "mfrac", [["1", "24"]]),
        (r"\frac{a\frac1b}{2}", "mfrac", [["a1b", "2"], ["1", "b"]]),
        (r"2\sqrt 2D", "msqrt", [["2"]]),
        (r"x^23", "msup", [["x", "2"]]),
        (r"\hat q_k", "msub", [["q", "k"]]),  # beside an accented letter, not below it
    ],
)
def test_an_argument_is_one_token_or_one_group(latex, tag, parts):
    assert shown(latex, tag) == parts
