"""Every statement of docs/conventions.md is executed, and its pictures drawn anew."""

import re

import pytest
from places import ROOT

from docs.site.drawing import COLOURS
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


def test_no_other_picture_is_there():
    assert {path.stem for path in FOLDER.iterdir()} == set(PICTURES)


def luminance(colour):
    """Relative luminance of a colour, by the definition of WCAG 2."""
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [
        p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize("name", COLOURS)
def test_words_are_readable_on_light_and_on_dark(name):
    """4.5 to 1, what WCAG asks of text, on the two backgrounds of the pages."""
    light, dark = map(luminance, COLOURS[name])
    white, night = luminance("#ffffff"), luminance("#131416")
    assert (white + 0.05) / (light + 0.05) > 4.5
    assert (dark + 0.05) / (night + 0.05) > 4.5
