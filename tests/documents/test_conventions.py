"""Every statement of docs/conventions.md is executed, and its pictures drawn anew."""

import re

import pytest
from places import ROOT

from docs.site.pictures import FOLDER, PICTURES

PAGE = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


@pytest.mark.ci  # two seconds: a scene is simulated
def test_the_statements_hold():
    """In the order of the page, in one namespace.

    Its forty comparisons of samples allow five standard errors, which sound code
    exceeds with one seed in 4e4; beside each stands the other sign, which must.
    """
    names = {}
    for code in BLOCK.findall(PAGE):
        exec(compile(code, "docs/conventions.md", "exec"), names)


def test_each_section_states_something():
    """A section of words alone would be a statement that nothing holds."""
    for section in PAGE.split("\n## ")[1:]:
        codes = BLOCK.findall(section)
        assert any("assert " in code for code in codes), section[:40]


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_is_the_one_of_the_script(name):
    """And the page shows it: `python -m docs.site.pictures` draws them."""
    assert (FOLDER / f"{name}.svg").read_text(encoding="utf-8") == PICTURES[
        name
    ]().svg()
    assert f"](pictures/{name}.svg)" in PAGE
