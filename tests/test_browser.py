"""The report and the comparison in a real browser: headless Chromium, from disk."""

import json
import re
from itertools import pairwise

import pytest
from browser import browser, find_chromium
from stores import edited

from simval.judge import compare_runs
from simval.report import render, render_comparison
from simval.sweep import load_run

pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(
        find_chromium() is None,
        reason="Chromium is not installed, so the report was not opened in a browser",
    ),
]

WIDTHS = (380, 1280)


@pytest.fixture(scope="module")
def pages(_tiny_run, tmp_path_factory):
    """A report with failing checks and artifacts, and the comparison with its twin."""
    import shutil

    import numpy as np

    folder = tmp_path_factory.mktemp("pages")
    run = folder / "run"
    shutil.copytree(_tiny_run, run)
    edited(
        run,
        "UPDATE rows SET value = value + 20 * standard_error "
        "WHERE family = 'bias' AND controlled = 0 "
        "AND entries = json_array('x') AND cell = 3",
    )
    (run / "artifacts").mkdir(exist_ok=True)
    time = np.arange(5000) / 100.0
    np.savez(
        run / "artifacts" / "static-x.npz",
        time=time,
        signal=np.sin(time)[:, None] + np.zeros(3),
        intervals=[[1.0, 2.0]],
    )
    before, after = load_run(_tiny_run), load_run(run)
    report, comparison = folder / "report.html", folder / "comparison.html"
    report.write_text(render(after), encoding="utf-8")
    comparison.write_text(
        render_comparison(before, after, compare_runs(before, after)), encoding="utf-8"
    )
    return report, comparison


@pytest.fixture(scope="module")
def clean(_tiny_run, tmp_path_factory):
    """The report of a run in which all is well."""
    page = tmp_path_factory.mktemp("clean") / "report.html"
    page.write_text(render(load_run(_tiny_run)), encoding="utf-8")
    return page


@pytest.fixture(scope="module")
def tab(tmp_path_factory):
    """One page of one browser for all tests."""
    with browser(tmp_path_factory.mktemp("profile")) as page:
        yield page


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("which", [0, 1])
def test_it_opens_quietly_and_fits(tab, pages, which, width, scheme):
    tab.open(pages[which], width=width, scheme=scheme)
    assert tab.run("innerWidth") == width  # headless windows are wider than asked
    assert tab.run("matchMedia('(prefers-color-scheme: dark)').matches") == (
        scheme == "dark"
    )
    # every part open, as a reader would have it
    tab.run("document.querySelectorAll('details').forEach(d => d.open = true)")
    assert tab.run("document.documentElement.scrollWidth") <= width
    assert tab.complaints() == []
    asked = [address for address in tab.requests() if not address.startswith("data:")]
    assert asked == [pages[which].resolve().as_uri()]


def test_a_page_that_is_too_wide_or_calls_out_would_be_seen(tab, tmp_path):
    """Power of the test above: the same probes on a page with each fault."""
    path = tmp_path / "bad.html"
    path.write_text(
        "<p style='width: 900px'>wide</p><img src='http://127.0.0.1:9/x.png'>"
        "<script>console.error('loud')</script>"
    )
    tab.open(path, width=380)
    assert tab.run("document.documentElement.scrollWidth") > 380
    assert any("loud" in line for line in tab.complaints())
    assert "http://127.0.0.1:9/x.png" in tab.requests()


def test_a_script_from_data_cannot_run(tab, pages, tmp_path):
    """The policy allows the page's own script by its hash, and no other."""
    text = pages[0].read_text(encoding="utf-8")
    path = tmp_path / "injected.html"
    path.write_text(
        text.replace("</main>", "<script>window.bad = 1</script></main>"),
        encoding="utf-8",
    )
    tab.open(path)
    assert tab.run("window.bad === undefined")
    assert tab.run("document.querySelectorAll('th button').length") > 0
    assert any("Content Security Policy" in line for line in tab.complaints())


LED_TO = ("section#summary, .group", "section")


@pytest.mark.parametrize("which", [0, 1])
def test_the_contents_lead_to_every_part(tab, pages, which):
    tab.open(pages[which])
    links = tab.run(
        "[...document.querySelectorAll('nav a')].map(a => a.getAttribute('href'))"
    )
    parts = f"[...document.querySelectorAll('{LED_TO[which]}')].map(s => '#' + s.id)"
    assert links == tab.run(parts)
    for link in links:
        tab.run(f"document.querySelector('nav a[href=\"{link}\"]').click()")
        assert tab.run("location.hash") == link
        top = tab.run(f"document.querySelector('{link}').getBoundingClientRect().top")
        bottom = tab.run("scrollY + innerHeight >= document.body.scrollHeight - 1")
        assert abs(top) < 2 or bottom  # at the top, or the page ends before it is


SEEN = """(() => {
  const target = document.querySelector('%s');
  const box = target.getBoundingClientRect();
  return target.checkVisibility() && box.top < innerHeight && box.bottom > 0;
})()"""


def test_a_link_opens_the_fold_that_it_leads_into(tab, pages, tmp_path):
    """By the browser alone: the page's script is left out."""
    text = pages[0].read_text(encoding="utf-8")
    path = tmp_path / "plain.html"
    path.write_text(re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL))
    tab.open(path)
    closed = "details.chapter:not([open])"
    targets = tab.run(
        f"[...document.querySelectorAll('{closed} > section')].flatMap(s => "
        "[s, ...[...s.querySelectorAll('figure[id]')].slice(0, 1)]).map(e => e.id)"
    )
    assert "numbers" in targets
    assert any(target.startswith("figure-") for target in targets)
    for target in targets:
        tab.run(
            "document.querySelectorAll('details').forEach(d => d.open = false);"
            "scrollTo(0, 0)"
        )
        assert not tab.run(SEEN % f"#{target}")
        tab.run(f"location.hash = '{target}'")
        assert tab.run(f"document.getElementById('{target}').closest('details').open")
        assert tab.run(SEEN % f"#{target}"), target


def test_a_fold_opens_by_the_keyboard(tab, pages):
    tab.open(pages[0])
    fold = "document.querySelector('details.chapter:not([open]) > summary')"
    tab.run(f"window.fold = {fold}; fold.focus()")
    assert tab.run("document.activeElement === fold")
    tab.press("Enter", 13, "\r")
    assert tab.run("fold.parentElement.open")


@pytest.mark.parametrize("width", WIDTHS)
def test_a_page_of_a_clean_run_is_at_most_five_screens(tab, clean, width):
    tab.open(clean, width=width, height=900)
    assert tab.run("document.querySelectorAll('details.chapter').length") > 5
    assert tab.run("document.documentElement.scrollHeight") <= 5 * 900
    # power: with every fold open it is more
    tab.run("document.querySelectorAll('details').forEach(d => d.open = true)")
    assert tab.run("document.documentElement.scrollHeight") > 5 * 900


def test_the_three_answers_stand_side_by_side_and_stack_on_a_phone(tab, clean):
    probe = (
        "[...document.querySelectorAll('.answer')].map(e => e.getBoundingClientRect())"
        ".map(b => [b.left, b.top])"
    )
    tab.open(clean, width=1280)
    wide = tab.run(probe)
    assert len({top for _, top in wide}) == 1
    assert len({left for left, _ in wide}) == 3
    tab.open(clean, width=380)
    assert len({left for left, _ in tab.run(probe)}) == 1


def test_headings_are_in_order_and_folds_have_names(tab, clean):
    tab.open(clean)
    levels = tab.run(
        "[...document.querySelectorAll('h1,h2,h3,h4')].map(h => h.tagName)"
    )
    numbers = [int(name[1]) for name in levels]
    assert numbers[0] == 1
    assert all(b <= a + 1 for a, b in pairwise(numbers))
    names = tab.run(
        "[...document.querySelectorAll('details.chapter > summary h3')]"
        ".map(h => h.textContent.trim())"
    )
    assert all(names)
    assert len(set(names)) == len(names)


SORTED = """(() => {
  const table = document.querySelector('#table-%s').closest('table');
  const head = [...table.tHead.rows[0].cells].findIndex(
    (cell) => cell.textContent.trim() === '%s');
  return [...table.tBodies[0].rows].map((row) => row.cells[head].%s);
})()"""


def test_a_table_sorts_by_mouse_and_by_keyboard(tab, pages):
    tab.open(pages[0])
    tab.run("document.querySelectorAll('details').forEach(d => d.open = true)")
    keys = SORTED % ("verdicts", "p", "dataset.sort")
    button = (
        "[...document.querySelector('#table-verdicts').closest('table')"
        ".querySelectorAll('th')].find(th => th.textContent.trim() === 'p')"
        ".querySelector('button')"
    )
    before = tab.run(keys)
    tab.run(f"{button}.click()")
    up = tab.run(keys)
    numbers = [float(k) for k in up if k]
    assert numbers == sorted(numbers)
    assert len(set(numbers)) > 10
    assert sorted(up) == sorted(before)  # nothing lost
    assert all(k == "" for k in up[len(numbers) :])  # what has no value stays last
    sort = tab.run(f"{button}.closest('th').getAttribute('aria-sort')")
    assert sort == "ascending"
    # by the keyboard: the other way round
    tab.run(f"{button}.focus()")
    assert tab.run(f"document.activeElement === {button}")
    tab.press("Enter", 13, "\r")
    down = [float(k) for k in tab.run(keys) if k]
    assert down == sorted(numbers, reverse=True)
    sort = tab.run(f"{button}.closest('th').getAttribute('aria-sort')")
    assert sort == "descending"


def test_a_table_sorts_words(tab, pages):
    tab.open(pages[0])
    tab.run(
        "[...document.querySelector('#table-families').closest('table')"
        ".querySelectorAll('th button')][1].click()"
    )
    words = tab.run(SORTED % ("families", "predictor", "textContent"))
    assert words == sorted(words)
    assert len(set(words)) > 2


def test_every_figure_has_a_text_and_every_control_a_name(tab, pages):
    for page in pages:
        tab.open(page)
        tab.run("document.querySelectorAll('details').forEach(d => d.open = true)")
        nodes = tab.call("Accessibility.getFullAXTree")["nodes"]
        shown = [n for n in nodes if not n.get("ignored")]
        by_role = {}
        for node in shown:
            name = node.get("name", {}).get("value", "")
            by_role.setdefault(node["role"]["value"], []).append(name)
        figures = tab.run("document.querySelectorAll('svg, img').length")
        images = by_role.get("image", []) + by_role.get("img", [])
        points = tab.run("document.querySelectorAll('.points circle').length")
        assert points > 0
        assert len(images) == figures + points > points
        for role in ("image", "img", "link", "button", "region", "table"):
            for name in by_role.get(role, []):
                assert name.strip(), role


def test_ink_and_paper_keep_their_contrast(tab, pages):
    """At least 4.5 to 1 (WCAG AA) for text, verdicts and links, light and dark."""
    probe = """(() => {
      const of = (selector) => {
        const element = document.querySelector(selector);
        return getComputedStyle(element).color;
      };
      return [getComputedStyle(document.body).backgroundColor, of('p'), of('td.fail'),
              of('td.pass'), of('nav a'), of('figure svg text'), of('.found'),
              of('.answer small'), of('.mark')];
    })()"""
    for scheme in ("light", "dark"):
        tab.open(pages[0], scheme=scheme)
        paper, *inks = (_luminance(colour) for colour in tab.run(probe))
        for ink in inks:
            low, high = sorted((ink, paper))
            # WCAG 2.1, criterion 1.4.3, level AA: 4.5 for text of normal size
            assert (high + 0.05) / (low + 0.05) >= 4.5


def _luminance(colour):
    """Relative luminance of an sRGB colour, WCAG 2."""
    parts = [int(word) / 255.0 for word in re.findall(r"\d+", colour)[:3]]
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_the_first_screen_is_one_screen(tab, pages):
    """Verdict, answers and both figures, without scrolling, on a laptop's window."""
    tab.open(pages[0], width=1280, height=800)
    bottoms = tab.run(
        "[...document.querySelectorAll("
        "'#summary .verdict, #summary .answers, #summary svg')]"
        ".map(e => e.getBoundingClientRect().bottom)"
    )
    assert len(bottoms) >= 4
    assert max(bottoms) <= 800


WIDE = """(() => [...document.querySelectorAll('.panels')].map(box => {
  const boxes = [...box.querySelectorAll(':scope > svg')]
    .map(svg => svg.getBoundingClientRect());
  return [boxes.length, new Set(boxes.map(b => Math.round(b.left))).size,
          Math.max(...boxes.map(b => b.right)), Math.min(...boxes.map(b => b.width))];
}))()"""


def test_panels_stack_on_a_phone_and_use_the_width_of_a_screen(tab, pages):
    for width, beside in ((380, False), (1280, True)):
        tab.open(pages[0], width=width)
        tab.run("document.querySelectorAll('details').forEach(d => d.open = true)")
        found = tab.run(WIDE)
        assert len(found) > 5
        for count, columns, right, least in found:
            assert right <= width
            # in the first screen two figures share the width with each other
            assert least >= min(width, 380) * 0.8
            assert columns == 1 or beside
            if beside and count >= 3:
                assert columns >= 2
        assert any(columns >= 3 for _, columns, _, _ in found) == beside


SHEETS = (718, 740)  # A4 and Letter less their margins, at 96 pixels an inch
FOLDED = """[...document.querySelectorAll('.chapter:not([open]) details > *')]
  .filter(e => e.tagName !== 'SUMMARY' && !e.parentElement.open)
  .map(e => e.checkVisibility())"""


@pytest.mark.parametrize("width", SHEETS)
def test_paper_has_all_that_the_text_needs_and_cuts_nothing(
    tab, pages, clean, tmp_path, width
):
    opened = tmp_path / "opened.html"
    text = clean.read_text(encoding="utf-8")
    opened.write_text(text.replace("<details", "<details open"), encoding="utf-8")
    for page in (*pages, clean, opened):
        assert tab.printed(page, width) == []
    tab.open(clean, width=width)
    tab.call("Emulation.setEmulatedMedia", media="print")
    folded = tab.run(FOLDED)
    assert len(folded) > 3
    assert not any(folded)  # but a closed fold of a chapter is not on paper
    nav = "getComputedStyle(document.querySelector('nav')).display"
    assert tab.run(nav) == "none"
    paper = "getComputedStyle(document.body).backgroundColor"
    assert tab.run(paper) == "rgb(255, 255, 255)"
    tab.call("Emulation.setEmulatedMedia", media="")


@pytest.mark.parametrize(
    "fault",
    [
        "pre, pre * { white-space: pre !important; overflow: auto; }",
        "table { min-width: 60rem; }",
        "details::details-content { content-visibility: hidden !important; }",
    ],
)
def test_a_page_that_paper_cuts_would_be_seen(tab, clean, tmp_path, fault):
    """Power of the test above."""
    page = tmp_path / "cut.html"
    line = "<pre>" + "one line " * 40 + "</pre>"
    text = clean.read_text(encoding="utf-8").replace("</main>", f"{line}</main>")
    page.write_text(text, encoding="utf-8")
    assert tab.printed(page, SHEETS[0]) == []
    page.write_text(text.replace("</style>", f"{fault}</style>"), encoding="utf-8")
    assert tab.printed(page, SHEETS[0])


def test_without_its_script_the_page_is_whole(tab, pages, tmp_path):
    text = pages[0].read_text(encoding="utf-8")
    path = tmp_path / "plain.html"
    path.write_text(re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL))
    tab.open(pages[0])
    # what the script adds is controls: boxes to filter by, headings that are buttons
    tab.run("document.querySelectorAll('.filter').forEach(bar => bar.remove())")
    whole = tab.run("document.querySelector('main').innerText.length")
    tab.open(path)
    assert tab.run("document.querySelector('main').innerText.length") == whole
    assert json.dumps(tab.complaints()) == "[]"
