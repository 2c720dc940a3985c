"""The tutorials and how-to pages: every command prints what the page shows."""

import re

import pytest
import walkthrough
from places import EXAMPLES, ROOT
from walkthrough import FENCE, PICTURE, Walk, blocks, lend

PAGES = sorted((ROOT / "docs").glob("tutorials/*.md")) + sorted(
    (ROOT / "docs").glob("howto/*.md")
)
SLOW = {"filter", "estimator", "question", "settings"}
"""Pages that take most of a minute: a sweep of a grid, or `simval check` many times."""
WALKS = {}


def sections():
    for page in PAGES:
        names = [block.section for block in blocks(page.read_text(encoding="utf-8"))]
        for name in dict.fromkeys(names):
            mark = pytest.mark.slow if page.stem in SLOW else pytest.mark.ci
            yield pytest.param(page, name, marks=mark, id=f"{page.stem}: {name}")


@pytest.fixture
def outside(monkeypatch):
    """Not in a workflow, whose variables would change what is printed."""
    for name in ("GITHUB_ACTIONS", "GITHUB_STEP_SUMMARY", "COLUMNS"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize(("page", "section"), list(sections()))
def test_a_section_prints_what_it_shows(page, section, tmp_path_factory, outside):
    if page not in WALKS:
        WALKS[page] = Walk(page, tmp_path_factory.mktemp(page.stem))
        lend(WALKS[page].folder)
    walk = WALKS[page]
    for name in needed(page, section):
        if not (walk.folder / name).exists():
            pytest.skip(f"the real recording is not there: {name}")
    walk.to(section)
    wrong, walk.wrong = walk.wrong, []
    assert not wrong, "\n\n".join(wrong)
    if section == blocks(page.read_text(encoding="utf-8"))[-1].section:
        for picture, file in PICTURE.findall(page.read_text(encoding="utf-8")):
            assert (page.parent / picture).is_file()
            assert (walk.folder / file).is_file()


def needed(page, section):
    """The real recordings that a section reads."""
    found = [
        b for b in blocks(page.read_text(encoding="utf-8")) if b.section == section
    ]
    text = "".join(block.text for block in found)
    return [name for name in walkthrough.RECORDINGS if name in text]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_words_quote_what_was_printed(page):
    """A number with a decimal point in the text stands in a block of the page, too."""
    text = page.read_text(encoding="utf-8")
    shown = "".join(match.group(3) for match in FENCE.finditer(text))
    words = re.sub(r"\]\([^)]*\)", "]", FENCE.sub("", text))
    quoted = set(re.findall(r"(?<![\w.])\d+\.\d+(?![\w.])", words))
    assert {number for number in quoted if number not in shown} == set()


def test_the_tutorials_filter_is_the_example():
    """The README's third figure is of the same filter."""
    text = (ROOT / "docs" / "tutorials" / "filter.md").read_text(encoding="utf-8")
    (code,) = [m.group(3) for m in FENCE.finditer(text) if m.group(2) == "mine.py"]
    assert code == (EXAMPLES / "kalman.py").read_text(encoding="utf-8")


def test_examples_in_the_documentation_are_the_files():
    pages = {"align": "estimator", "ellipsoid": "calibrator", "six": "calibrator"}
    for name, page in pages.items():
        text = (ROOT / "docs" / "plugins" / f"{page}.md").read_text()
        blocks = re.findall(r"```python\n(.*?)```", text, re.S)
        code = (EXAMPLES / f"{name}.py").read_text()
        assert code.partition('"""\n\n')[2].strip() in map(str.strip, blocks)
