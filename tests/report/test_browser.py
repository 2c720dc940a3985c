"""The pages of runs in a real browser: headless Chromium, from disk."""

import random
import re
import shlex
import shutil
import time

import numpy as np
import pytest
from browser import browser, find_chromium
from stores import edited

from simval.judge import compare_runs
from simval.report import render, render_comparison, tables
from simval.report.formatting import measured
from simval.report.page import sections
from simval.report.table import text
from simval.statistics import FIRST_ORDER, RMS
from simval.sweep import load_run

pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(
        find_chromium() is None,
        reason="Chromium is not installed, so the report was not opened in a browser",
    ),
]

WIDTHS = (380, 1280)
OPEN = "document.querySelectorAll('details:not(.command)').forEach(d => d.open = true)"
FIGURE = "#figure-summary-calibration"
BOX = "document.querySelector('.note')"


@pytest.fixture(scope="module")
def run(_tiny_run, tmp_path_factory):
    """A run with checks that fail, and a signal that was left as an artifact."""
    folder = tmp_path_factory.mktemp("failing") / "run"
    shutil.copytree(_tiny_run, folder)
    edited(
        folder,
        "UPDATE rows SET value = value + 20 * standard_error "
        "WHERE family = 'bias' AND controlled = 0 "
        "AND entries = json_array('x') AND cell = 3",
    )
    (folder / "artifacts").mkdir(exist_ok=True)
    time = np.arange(5000) / 100.0
    np.savez(
        folder / "artifacts" / "static-x.npz",
        time=time,
        signal=np.sin(time)[:, None] + np.zeros(3),
        intervals=[[1.0, 2.0]],
    )
    return load_run(folder)


@pytest.fixture(scope="module")
def pages(run, _tiny_run, tmp_path_factory):
    """Reports of the run and of its sound twin, and their comparison."""
    folder, sound = tmp_path_factory.mktemp("pages"), load_run(_tiny_run)
    written = {
        "failing": render(run),
        "sound": render(sound),
        "compared": render_comparison(sound, run, compare_runs(sound, run)),
    }
    for name, content in written.items():
        (folder / f"{name}.html").write_text(content, encoding="utf-8")
    return {name: folder / f"{name}.html" for name in written}


@pytest.fixture(scope="module")
def unscripted(pages, tmp_path_factory):
    """The report as a reader without JavaScript has it."""
    page = tmp_path_factory.mktemp("plain") / "plain.html"
    whole = pages["failing"].read_text(encoding="utf-8")
    page.write_text(re.sub(r"<script>.*?</script>", "", whole, flags=re.DOTALL))
    return page


@pytest.fixture(scope="module")
def tab(tmp_path_factory):
    """One page of one browser for all tests."""
    with browser(tmp_path_factory.mktemp("profile")) as page:
        yield page


@pytest.fixture
def opened(tab, pages):
    """The report with its folds open; in the end it has not complained."""
    tab.open(pages["failing"])
    tab.run(OPEN)
    yield tab
    assert tab.complaints() == []


@pytest.mark.parametrize(("width", "scheme"), [(380, "dark"), (1280, "light")])
@pytest.mark.parametrize("which", ["failing", "compared"])
def test_it_opens_quietly_and_fits(tab, pages, which, width, scheme):
    tab.open(pages[which], width=width, scheme=scheme)
    assert tab.run("innerWidth") == width  # headless windows are wider than asked
    tab.run(OPEN)
    assert tab.run("document.documentElement.scrollWidth") <= width
    assert tab.complaints() == []
    asked = [address for address in tab.requests() if not address.startswith("data:")]
    assert asked == [pages[which].resolve().as_uri()]


def test_a_script_from_data_cannot_run(tab, pages, tmp_path):
    """The policy allows the page's own script by its hash, and no other."""
    whole = pages["failing"].read_text(encoding="utf-8")
    path = tmp_path / "injected.html"
    bad = "<script>window.bad = 1</script></main>"
    path.write_text(whole.replace("</main>", bad), encoding="utf-8")
    tab.open(path)
    assert tab.run("window.bad === undefined")
    assert tab.run("document.querySelectorAll('th button').length") > 0
    assert any("Content Security Policy" in line for line in tab.complaints())


SEEN = """(() => {
  const target = document.querySelector('%s');
  const box = target.getBoundingClientRect();
  return target.checkVisibility() && box.top < innerHeight && box.bottom > 0;
})()"""


def test_a_link_opens_the_folds_that_it_leads_into(tab, unscripted, pages):
    """By the browser alone, and by the page's script."""
    for page in (unscripted, pages["failing"]):
        tab.open(page)
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
            assert tab.run(
                f"document.getElementById('{target}').closest('details').open"
            )
            assert tab.run(SEEN % f"#{target}"), target


@pytest.mark.parametrize("width", WIDTHS)
def test_a_page_of_a_sound_run_is_at_most_five_screens(tab, pages, width):
    tab.open(pages["sound"], width=width, height=900)
    assert tab.run("document.querySelectorAll('details.chapter').length") > 5
    assert tab.run("document.documentElement.scrollHeight") <= 5 * 900
    # power: with every fold open it is more
    tab.run(OPEN)
    assert tab.run("document.documentElement.scrollHeight") > 5 * 900


def test_the_first_screen_is_one_screen(tab, pages):
    """Verdict, three answers side by side and both figures, on a laptop's window."""
    tab.open(pages["failing"], width=1280, height=800)
    first = ("verdict", "answer", "first svg")
    boxes = [
        tab.run(
            f"[...document.querySelectorAll('#summary .{name}')].map(e => "
            "e.getBoundingClientRect()).map(b => [b.left, b.top, b.bottom])"
        )
        for name in first
    ]
    assert [len(each) for each in boxes] == [1, 3, 3]
    assert max(bottom for each in boxes for _, _, bottom in each) <= 800
    assert len({top for _, top, _ in boxes[1]}) == 1
    assert len({left for left, _, _ in boxes[1]}) == 3


WIDE = """(() => [...document.querySelectorAll('.panels')].map(box => {
  const boxes = [...box.querySelectorAll(':scope > svg')]
    .map(svg => svg.getBoundingClientRect());
  return [boxes.length, new Set(boxes.map(b => Math.round(b.left))).size,
          Math.max(...boxes.map(b => b.right)), Math.min(...boxes.map(b => b.width))];
}))()"""


def test_panels_stack_on_a_phone_and_use_the_width_of_a_screen(tab, pages):
    for width, beside in ((380, False), (1280, True)):
        tab.open(pages["failing"], width=width)
        tab.run(OPEN)
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


SHEET = 718  # A4 less its margins, at 96 pixels an inch
FOLDED = """[...document.querySelectorAll('.chapter:not([open]) details > *')]
  .filter(e => e.tagName !== 'SUMMARY' && !e.parentElement.open)
  .map(e => e.checkVisibility())"""


def test_paper_has_all_that_the_text_needs_and_cuts_nothing(tab, pages, tmp_path):
    for page in pages.values():
        assert tab.printed(page, SHEET) == []
    tab.open(pages["sound"], width=SHEET)
    tab.call("Emulation.setEmulatedMedia", media="print")
    folded = tab.run(FOLDED)
    assert len(folded) > 3
    assert not any(folded)  # but a closed fold of a chapter is not on paper
    nav = "getComputedStyle(document.querySelector('nav')).display"
    assert tab.run(nav) == "none"
    tab.call("Emulation.setEmulatedMedia", media="")
    # power: a page that paper cuts would be seen
    whole = pages["sound"].read_text(encoding="utf-8")
    cut = tmp_path / "cut.html"
    cut.write_text(whole.replace("</style>", "table { min-width: 60rem; }</style>"))
    assert tab.printed(cut, SHEET)


SORTED = """(() => {
  const table = document.querySelector('#table-%s').closest('table');
  const head = [...table.tHead.rows[0].cells].findIndex(
    (cell) => cell.textContent.trim() === '%s');
  return [...table.tBodies[0].rows].map((row) => row.cells[head].%s);
})()"""


def test_a_table_sorts_by_mouse_and_by_keyboard(opened):
    tab = opened
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


def middle(tab, element):
    """Bring an element into view and give its middle, in pixels of the window."""
    return tab.run(
        f"(() => {{ const e = {element}; e.scrollIntoView({{block: 'center'}});"
        "const r = e.getBoundingClientRect();"
        "return [r.x + r.width / 2, r.y + r.height / 2]; })()"
    )


def point_at(tab, element):
    """Move the mouse to the middle of an element."""
    x, y = middle(tab, element)
    tab.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)


def click(tab, element):
    """Press and release the mouse over the middle of an element."""
    x, y = middle(tab, element)
    for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
        button = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
        tab.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **button)


def told(tab):
    """Lines of the box of text; None while it is hidden."""
    lines = tab.run(
        f"{BOX}.hidden ? null : [...{BOX}.children].map(p => p.textContent)"
    )
    return lines and tuple(lines)


def disc(place, figure=FIGURE):
    """The disc of a figure at a place."""
    return f"document.querySelectorAll('{figure} .points circle')[{place}]"


def noted(run, name="summary-calibration"):
    """Notes of a figure, from the run, in the order of its discs."""
    drawings = [d for section in sections(run) for d in section.drawings]
    (drawing,) = [d for d in drawings if d.name == name]
    return [
        tuple(words.splitlines())
        for panel in drawing.panels
        for series in panel.series
        for words in series.notes
    ]


UNITS = {"T": ("mrad", 1e3), "K": ("ppm", 1e6), "B": ("mm/s²", 1e3)}


def test_a_hover_shows_the_row_of_the_point(opened, run):
    """What the box says, against the rows of the run and not against the note."""
    tab = opened
    count = tab.run(f"document.querySelectorAll('{FIGURE} circle').length")
    assert count >= 3
    cells, seen = {cell.name: cell for cell in run.cells}, set()
    for place in range(count):
        tab.press("Escape", 27)  # the box of the last one may lie over this one
        point_at(tab, disc(place))
        value, predicted, where, command = told(tab)
        series = tab.run(f"{disc(place)}.parentNode.getAttribute('aria-label')")
        *_, name = shlex.split(command)
        (letter,) = re.findall(r"\b[TKB]\b", series)
        row = cells[name].row(RMS(letter), FIRST_ORDER)
        unit, factor = UNITS[letter]
        number = measured(factor * row.value, factor * row.standard_error)
        assert value == f"{number} {unit}, n = {row.n}"
        off = factor * row.remainder
        more = f", which leaves out {off:.2g}" if off else ""
        assert predicted == f"predicted {factor * row.prediction:.6g} {unit}{more}"
        assert where.startswith("calibration: ")
        assert f"{cells[name].parameters['poses']} poses" in where
        seen.add((letter, name))
    assert len(seen) == count


def test_the_box_stays_under_the_pointer_and_can_be_dismissed(opened):
    """WCAG 1.4.13: hoverable, persistent, dismissible."""
    tab = opened
    point_at(tab, disc(0))
    lines = told(tab)
    assert lines
    at = tab.run(
        f"(() => {{ const r = {BOX}.getBoundingClientRect();"
        "return [r.x + 9, r.y + 9]; })()"
    )
    tab.call("Input.dispatchMouseEvent", type="mouseMoved", x=at[0], y=at[1])
    time.sleep(0.5)  # longer than the box waits for the pointer to come
    assert told(tab) == lines
    tab.press("Escape", 27)
    assert told(tab) is None
    # away from point and box it goes by itself
    point_at(tab, disc(0))
    assert told(tab) == lines
    tab.call("Input.dispatchMouseEvent", type="mouseMoved", x=2, y=2)
    time.sleep(0.5)
    assert told(tab) is None


def to_points(tab):
    """Press Tab from before the figure until a point has the focus."""
    tab.run(
        "(() => { const b = document.createElement('button'); b.textContent = 'b';"
        f"document.querySelector('{FIGURE}').before(b); b.focus(); }})()"
    )
    for _ in range(2):  # the figure's own box may be a stop
        tab.press("Tab", 9)
        if tab.run("document.activeElement.tagName") == "circle":
            return


def test_the_keyboard_reaches_every_point_by_one_stop(opened, run):
    tab = opened
    notes = set(noted(run))
    to_points(tab)
    assert tab.run(f"document.activeElement === {disc(0)}")
    stops = f"document.querySelectorAll('{FIGURE} circle[tabindex=\"0\"]').length"
    assert tab.run(stops) == 1
    seen = set()
    series = tab.run(f"document.querySelectorAll('{FIGURE} .points').length")
    for _ in range(series):
        tab.press("Home", 36)
        count = tab.run("document.activeElement.parentNode.children.length")
        for _ in range(count):
            seen.add(told(tab))
            label = tab.run("document.activeElement.getAttribute('aria-label')")
            assert label == "; ".join(told(tab))
            tab.press("ArrowRight", 39)
        tab.press("ArrowDown", 40)
    assert seen == notes
    assert tab.run(stops) == 1
    tab.press("Escape", 27)
    assert told(tab) is None
    # the focus stays where it was
    assert tab.run("document.activeElement.tagName") == "circle"


SHOWN = """[...document.querySelectorAll('%s [data-keys]')].map(
  (part) => [part.dataset.keys, getComputedStyle(part).display !== 'none'])"""


@pytest.mark.parametrize("keyboard", [False, True])
def test_an_entry_of_a_legend_hides_its_series_and_nothing_else(opened, keyboard):
    tab = opened
    buttons = tab.run(
        f"[...document.querySelectorAll('{FIGURE} [role=button]')]"
        ".map(b => [b.dataset.key, b.getAttribute('aria-pressed')])"
    )
    assert len(buttons) >= 3
    assert all(pressed == "true" for _, pressed in buttons)
    before = tab.run(SHOWN % FIGURE)
    assert all(shown for _, shown in before)
    everywhere = tab.run(SHOWN % "figure")
    for place, (key, _) in enumerate(buttons):
        button = f"document.querySelectorAll('{FIGURE} [role=button]')[{place}]"
        for hidden in (True, False):
            if keyboard:
                tab.run(f"{button}.focus()")
                tab.press(*(("Enter", 13, "\r") if hidden else (" ", 32, " ")))
            else:
                click(tab, f"{button}.querySelector('text')")
            pressed = tab.run(f"{button}.getAttribute('aria-pressed')")
            assert pressed == str(not hidden).lower()
            after = tab.run(SHOWN % FIGURE)
            expected = [(k, not (hidden and key in k.split())) for k, _ in before]
            assert [tuple(each) for each in after] == expected
            assert any(shown for _, shown in after)
            assert (not all(shown for _, shown in after)) == hidden
    # other figures have legends of their own
    assert tab.run(SHOWN % "figure") == everywhere


FILTER = """(() => {
  const table = document.querySelector('#table-verdicts').closest('table');
  const bar = table.closest('.box').previousElementSibling;
  const wanted = %s;
  for (const label of bar.querySelectorAll('label')) {
    const control = label.querySelector('select, input');
    const value = wanted[label.firstChild.textContent.trim()] ?? '';
    if (control.tagName === 'INPUT') control.value = value;
    else control.selectedIndex = value === '' ? 0 :
      [...control.options].findIndex((o, i) => i && o.value === value);
    control.dispatchEvent(new Event('input'));
  }
  return [[...table.tBodies[0].rows].map(row => !row.hidden),
          bar.querySelector('[role=status]').textContent];
})()"""


def test_the_filter_leaves_exactly_the_rows_that_match(opened, run):
    """A family of random filters, against the table's own rows."""
    tab = opened
    table = next(t for t in tables(run) if t.name == "verdicts")
    rows = [
        [text(value, column) for value, column in zip(row, table.columns, strict=True)]
        for row in table.visible
    ]
    titles = [column.title for column in table.columns]
    choices = [
        i
        for i, column in enumerate(table.columns)
        if column.choice and len({row[i] for row in rows}) > 1
    ]
    assert {"verdict", "study", "against"} <= {titles[i] for i in choices}
    rng = random.Random(7)
    counts = set()
    for _ in range(24):
        example = rng.choice(rows)  # a row that the filter finds, most of the time
        wanted = {
            titles[i]: (example if rng.random() < 0.8 else rng.choice(rows))[i]
            for i in rng.sample(choices, rng.randint(0, 2))
        }
        wanted = {k: v for k, v in wanted.items() if v}
        words = rng.sample(re.findall(r"[\w.-]+", example[2]), 1)
        words = words if rng.random() < 0.5 else []
        expected = [
            all(row[titles.index(k)] == v for k, v in wanted.items())
            and all(word.lower() in " ".join(row).lower() for word in words)
            for row in rows
        ]
        script = FILTER % repr({**wanted, "words": " ".join(words).upper()})
        shown, said = tab.run(script)
        assert shown == expected
        assert said.startswith(f"{sum(expected)} of {len(rows)} rows")
        counts.add(sum(expected))
    assert len(counts) > 6  # the family is not all or nothing
    shown, said = tab.run(FILTER % "{}")
    assert all(shown)
    more = len(table.rows) > len(rows)
    assert (f"of {len(table.rows)} in all" in said) == more


def test_the_button_opens_and_closes_every_fold(opened):
    tab = opened
    button = "document.querySelector('#open-all')"
    assert tab.run(f"!{button}.hidden")
    folds = "[...document.querySelectorAll('details')].map(d => d.open)"
    tab.run(f"{button}.click()")
    assert len(tab.run(folds)) > 3
    assert all(tab.run(folds))
    tab.run(f"{button}.click()")
    assert not any(tab.run(folds))


def test_without_the_script_the_page_is_whole(tab, unscripted, pages, run):
    """What the script adds is controls; notes and commands are there without it."""
    tab.open(pages["failing"])
    tab.run("document.querySelectorAll('.filter').forEach(bar => bar.remove())")
    length = "document.querySelector('main').innerText.length"
    whole = tab.run(length)
    tab.open(unscripted)
    assert tab.run(length) == whole
    titles = tab.run(
        f"[...document.querySelectorAll('{FIGURE} circle title')]"
        ".map(t => t.textContent)"
    )
    assert [tuple(words.splitlines()) for words in titles] == noted(run)
    added = "document.querySelectorAll('.filter, .note, [aria-pressed]').length"
    assert tab.run(added) == 0
    assert tab.run("document.querySelectorAll('details.command code').length") > 10
    assert tab.run("document.querySelector('#open-all').hidden")
    assert tab.complaints() == []
