"""Every statement of docs/conventions.md is executed, and its pictures drawn anew."""

import re

import numpy as np
import pytest
from places import ROOT

from docs.site.pictures import FOLDER, PICTURES
from docs.site.singular import ALPHA, SCENES, half_difference, half_sum

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
    others = (ROOT / "docs" / name for name in ("attitude.md", "house.md"))
    shown = PAGE + "".join(page.read_text(encoding="utf-8") for page in others)
    assert f"](pictures/{name}.svg)" in shown


def test_the_source_s_figures_are_what_they_say():
    """Cases B and D by their differences, in unit vectors and one scale."""
    for scene in SCENES:
        np.testing.assert_allclose(scene.paper @ scene.paper.T, np.eye(2), atol=1e-15)
        r = scene.references
        b = np.stack([scene.turned(each) for each in r])
        assert np.linalg.norm([r, b], axis=2) == pytest.approx(np.ones((2, 2)))
        d, s = half_difference(r, b), half_sum(r, b)
        assert np.vecdot(d, s) == pytest.approx(np.zeros(2), abs=1e-15)
        parallel = np.linalg.norm(np.cross(*d)) < 1e-15
        assert parallel == (scene.title[:6] != "Fig. 4")
        if scene.title[:6] in ("Fig. 1", "Fig. 2"):
            assert [*d[0], d[1] @ r[0]] == pytest.approx([0.0] * 4, abs=1e-15)
        if scene.title[:6] == "Fig. 2":  # (18), (19)
            sides = np.linalg.norm([d[1], s[1]], axis=1)
            assert sides == pytest.approx([np.sin(ALPHA / 2), np.cos(ALPHA / 2)])
