"""The pages of runs in a real browser: headless Chromium, from disk."""

import csv
import io
import random
import re
import shlex
import shutil
import time
from xml.etree import ElementTree

import numpy as np
import pytest
from browser import browser, find_chromium
from read_back import SVG, law, number
from stores import edited

from simval.judge import compare_runs
from simval.report import drawings, render, render_comparison, tables
from simval.report.log_page import linear, signal
from simval.report.page import sections
from simval.report.panels import COLOURS, Drawing
from simval.report.section import made, template
from simval.report.table import text
from simval.spelling import measured
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
SHEET = 718  # A4 less its margins, at 96 pixels an inch
FIGURE = "#figure-summary-calibration"
POINTS = f"{FIGURE} .points circle"
ACTIVE = "document.activeElement"


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
    signal = np.sin(time)[:, None] + np.zeros(3)
    file = folder / "artifacts" / "static-x.npz"
    np.savez(file, time=time, signal=signal, intervals=[[1.0, 2.0]])
    return load_run(folder)


@pytest.fixture(scope="module")
def pages(run, _tiny_run, tmp_path_factory):
    """Reports of the run and of its sound twin, their comparison, and no script."""
    folder, sound = tmp_path_factory.mktemp("pages"), load_run(_tiny_run)
    written = {
        "failing": render(run),
        "sound": render(sound),
        "compared": render_comparison(sound, run, compare_runs(sound, run)),
    }
    whole = written["failing"]
    written["plain"] = re.sub(r"<script>.*?</script>", "", whole, flags=re.DOTALL)
    for name, content in written.items():
        (folder / f"{name}.html").write_text(content, encoding="utf-8")
    return {name: folder / f"{name}.html" for name in written}


@pytest.fixture(scope="module")
def tab(tmp_path_factory):
    """One page of one browser for all tests."""
    with browser(tmp_path_factory.mktemp("profile")) as page:
        yield page


@pytest.fixture
def opened(tab, pages):
    """The report with its folds open; in the end it has not complained."""
    tab.open(pages["failing"])
    unfold(tab)
    yield tab
    assert tab.complaints() == []


def every(tab, selector, expression):
    """An expression of each element `e` that a selector finds."""
    found = f"[...document.querySelectorAll('{selector}')]"
    return tab.run(f"{found}.map(e => {expression})")


def unfold(tab):
    every(tab, "details:not(.command)", "e.open = true")


@pytest.mark.parametrize(("width", "scheme"), [(380, "dark"), (1280, "light")])
@pytest.mark.parametrize("which", ["failing", "compared"])
def test_it_opens_quietly_and_fits(tab, pages, which, width, scheme):
    tab.open(pages[which], width=width, scheme=scheme)
    assert tab.run("innerWidth") == width  # headless windows are wider than asked
    unfold(tab)
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
    assert every(tab, "th button", "1")
    assert any("Content Security Policy" in line for line in tab.complaints())


SEEN = """(() => {
  const target = document.querySelector('%s');
  const box = target.getBoundingClientRect();
  return target.checkVisibility() && box.top < innerHeight && box.bottom > 0;
})()"""


@pytest.mark.parametrize("which", ["plain", "failing"])
def test_a_link_opens_the_folds_that_it_leads_into(tab, pages, which):
    """By the browser alone, and by the page's script."""
    tab.open(pages[which])
    folded = "details.chapter:not([open]) > section"
    targets = every(tab, folded, "e.id")
    targets += every(tab, f"{folded} figure[id]", "e.id")[:6]
    assert "numbers" in targets
    assert any(target.startswith("figure-") for target in targets)
    for target in targets:
        every(tab, "details", "e.open = false")
        tab.run("scrollTo(0, 0)")
        assert not tab.run(SEEN % f"#{target}")
        tab.run(f"location.hash = '{target}'")
        assert tab.run(f"document.getElementById('{target}').closest('details').open")
        assert tab.run(SEEN % f"#{target}"), target


@pytest.mark.parametrize("width", WIDTHS)
def test_a_page_of_a_sound_run_is_at_most_five_screens(tab, pages, width):
    tab.open(pages["sound"], width=width, height=900)
    assert len(every(tab, "details.chapter", "1")) > 5
    assert tab.run("document.documentElement.scrollHeight") <= 5 * 900
    # power: with every fold open it is more
    unfold(tab)
    assert tab.run("document.documentElement.scrollHeight") > 5 * 900


def test_the_first_screen_is_one_screen(tab, pages):
    """Verdict, key numbers and both figures, on a laptop's window."""
    tab.open(pages["sound"], width=1280, height=900)
    box = "(b => [b.left, b.top, b.bottom])(e.getBoundingClientRect())"
    first = ("verdict", "keys dt", "first .panels svg")
    boxes = [every(tab, f"#summary .{name}", box) for name in first]
    assert len(boxes[0]) == 1
    assert 3 <= len(boxes[1]) <= 5
    assert len(boxes[2]) == 2
    assert max(bottom for each in boxes for _, _, bottom in each) <= 900
    assert len({top for _, top, _ in boxes[1]}) == 1
    assert len({left for left, _, _ in boxes[2]}) == 2


PANELS = """(boxes => [boxes.length, new Set(boxes.map(b => Math.round(b.left))).size,
  Math.max(...boxes.map(b => b.right)), Math.min(...boxes.map(b => b.width))])(
  [...e.querySelectorAll(':scope > div > svg')].map(s => s.getBoundingClientRect()))"""


@pytest.mark.parametrize("width", WIDTHS)
def test_panels_stack_on_a_phone_and_use_the_width_of_a_screen(tab, pages, width):
    tab.open(pages["failing"], width=width)
    unfold(tab)
    found = every(tab, ".panels", PANELS)
    assert len(found) > 5
    for count, columns, right, least in found:
        assert right <= width
        # in the first screen two figures share the width with each other
        assert least >= min(width, 380) * 0.8
        assert columns == 1 or width > 380
        assert columns >= 2 or width == 380 or count < 3
    assert any(columns >= 3 for _, columns, _, _ in found) == (width > 380)


def test_paper_has_all_that_the_text_needs_and_cuts_nothing(tab, pages, tmp_path):
    for page in pages.values():
        assert tab.printed(page, SHEET) == []
    tab.open(pages["sound"], width=SHEET)
    tab.call("Emulation.setEmulatedMedia", media="print")
    folded = ".chapter:not([open]) details:not([open]) > :not(summary)"
    shown = every(tab, folded, "e.checkVisibility()")
    assert len(shown) > 3
    assert not any(shown)  # but a closed fold of a chapter is not on paper
    tab.call("Emulation.setEmulatedMedia", media="")
    # power: a page that paper cuts would be seen
    whole = pages["sound"].read_text(encoding="utf-8")
    cut = tmp_path / "cut.html"
    cut.write_text(whole.replace("</style>", "table { min-width: 60rem; }</style>"))
    assert tab.printed(cut, SHEET)


TABLE = "document.querySelector('#table-verdicts').closest('table')"
HEAD = f"[...{TABLE}.tHead.rows[0].cells].find(th => th.textContent.trim() === 'p')"
KEYS = f"[...{TABLE}.tBodies[0].rows].map(r => r.cells[{HEAD}.cellIndex].dataset.sort)"


def test_a_table_sorts_by_mouse_and_by_keyboard(opened):
    tab, button = opened, f"{HEAD}.querySelector('button')"
    before = tab.run(KEYS)
    tab.run(f"{button}.click()")
    up = tab.run(KEYS)
    numbers = [float(k) for k in up if k]
    assert numbers == sorted(numbers)
    assert len(set(numbers)) > 10
    assert sorted(up) == sorted(before)  # nothing lost
    assert all(k == "" for k in up[len(numbers) :])  # what has no value stays last
    assert tab.run(f"{HEAD}.getAttribute('aria-sort')") == "ascending"
    # by the keyboard: the other way round
    tab.run(f"{button}.focus()")
    assert tab.run(f"{ACTIVE} === {button}")
    tab.press("Enter", 13, "\r")
    assert [float(k) for k in tab.run(KEYS) if k] == sorted(numbers, reverse=True)
    assert tab.run(f"{HEAD}.getAttribute('aria-sort')") == "descending"


def mouse(tab, x, y, *kinds):
    """Move the mouse, and press and release it where that is asked."""
    tab.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    for kind in kinds:
        button = {"type": kind, "button": "left", "clickCount": 1}
        tab.call("Input.dispatchMouseEvent", x=x, y=y, **button)


def point_at(tab, selector, place, *kinds):
    """Bring an element into view and the mouse to its middle."""
    element = f"document.querySelectorAll('{selector}')[{place}]"
    x, y = tab.run(
        f"(() => {{ const e = {element}; e.scrollIntoView({{block: 'center'}});"
        "const r = e.getBoundingClientRect();"
        "return [r.x + r.width / 2, r.y + r.height / 2]; })()"
    )
    mouse(tab, x, y, *kinds)


def told(tab):
    """Lines of the box of text; None while it is hidden."""
    (lines,) = every(
        tab, ".note", "e.hidden ? null : [...e.children].map(p => p.textContent)"
    )
    return lines and tuple(lines)


def noted(run, name="summary-calibration"):
    """Notes of a figure, from the run, in the order of its discs."""
    drawings = [d for section in sections(run) for d in section.drawings]
    (drawing,) = [d for d in drawings if d.name == name]
    return [
        tuple(words.splitlines())
        for panel in drawing.panels
        for each in (panel, *panel.strips)
        for series in each.series
        for words in series.notes
    ]


UNITS = {"T": ("mrad", 1e3), "K": ("ppm", 1e6), "B": ("mm/s²", 1e3)}


def test_a_hover_shows_the_row_of_the_point(opened, run):
    """What the box says, against the rows of the run and not against the note."""
    tab = opened
    labels = every(tab, POINTS, "e.parentNode.getAttribute('aria-label')")
    assert len(labels) >= 3
    cells, seen = {cell.name: cell for cell in run.cells}, set()
    for place, series in enumerate(labels):
        tab.press("Escape", 27)  # the box of the last one may lie over this one
        point_at(tab, POINTS, place)
        value, predicted, where, command = told(tab)
        *_, name = shlex.split(command)
        letter, *_ = re.findall(r"\b[TKB]\b", series)
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
    assert 2 * len(seen) == len(labels)  # over theory the same stands once more


def test_the_box_stays_under_the_pointer_and_can_be_dismissed(opened):
    """WCAG 1.4.13: hoverable, persistent, dismissible."""
    tab = opened
    point_at(tab, POINTS, 0)
    lines = told(tab)
    assert lines
    (at,) = every(tab, ".note", "(r => [r.x + 9, r.y + 9])(e.getBoundingClientRect())")
    mouse(tab, *at)
    time.sleep(0.5)  # longer than the box waits for the pointer to come
    assert told(tab) == lines
    tab.press("Escape", 27)
    assert told(tab) is None
    # away from point and box it goes by itself
    point_at(tab, POINTS, 0)
    assert told(tab) == lines
    mouse(tab, 2, 2)
    time.sleep(0.5)
    assert told(tab) is None


def test_the_keyboard_reaches_every_point_by_one_stop(opened, run):
    tab, stops = opened, f'{FIGURE} circle[tabindex="0"]'
    tab.run(  # from before the points
        "(() => { const b = document.createElement('button'); b.textContent = 'b';"
        f"document.querySelector('{FIGURE} .panels').before(b); b.focus(); }})()"
    )
    tab.press("Tab", 9)
    if tab.run(f"{ACTIVE}.tagName") != "circle":  # the figure's own box may be a stop
        tab.press("Tab", 9)
    assert tab.run(f"{ACTIVE} === document.querySelector('{POINTS}')")
    assert len(every(tab, stops, "1")) == 1
    seen = set()
    for _ in every(tab, f"{FIGURE} .points", "1"):
        tab.press("Home", 36)
        for _ in range(tab.run(f"{ACTIVE}.parentNode.children.length")):
            seen.add(told(tab))
            label = tab.run(f"{ACTIVE}.getAttribute('aria-label')")
            assert label == "; ".join(told(tab))
            tab.press("ArrowRight", 39)
        tab.press("ArrowDown", 40)
    assert seen == set(noted(run))
    assert len(every(tab, stops, "1")) == 1
    tab.press("Escape", 27)
    assert told(tab) is None
    # the focus stays where it was
    assert tab.run(f"{ACTIVE}.tagName") == "circle"


@pytest.mark.parametrize("keyboard", [False, True])
def test_an_entry_of_a_legend_hides_its_series_and_nothing_else(opened, keyboard):
    tab, button = opened, f"{FIGURE} .legend button"

    def parts(where):
        shown = "[e.dataset.keys, getComputedStyle(e).display !== 'none']"
        return every(tab, f"{where} [data-keys]", shown)

    pressed = "e.getAttribute('aria-pressed')"
    keys, before, everywhere = (
        every(tab, button, "e.parentNode.dataset.key"),
        *(parts(FIGURE), parts("figure")),
    )
    assert len(keys) >= 3
    assert set(every(tab, button, pressed)) == {"true"}
    assert all(shown for _, shown in before)
    for place, key in enumerate(keys):
        for hidden in (True, False):
            if keyboard:
                tab.run(f"document.querySelectorAll('{button}')[{place}].focus()")
                tab.press(*(("Enter", 13, "\r") if hidden else (" ", 32, " ")))
            else:
                point_at(tab, button, place, "mousePressed", "mouseReleased")
            assert every(tab, button, pressed)[place] == str(not hidden).lower()
            after = parts(FIGURE)
            assert after == [[k, not (hidden and key in k.split())] for k, _ in before]
            assert any(shown for _, shown in after)
            assert (not all(shown for _, shown in after)) == hidden
    # other figures have legends of their own
    assert parts("figure") == everywhere


FILTER = f"""(() => {{
  const table = {TABLE}, wanted = %s;
  const bar = table.closest('.box').previousElementSibling;
  for (const label of bar.querySelectorAll('label')) {{
    const control = label.querySelector('select, input');
    const value = wanted[label.firstChild.textContent.trim()] ?? '';
    if (control.tagName === 'INPUT') control.value = value;
    else control.selectedIndex = value === '' ? 0 :
      [...control.options].findIndex((o, i) => i && o.value === value);
    control.dispatchEvent(new Event('input'));
  }}
  return [[...table.tBodies[0].rows].map(row => !row.hidden),
          bar.querySelector('[role=status]').textContent];
}})()"""


def test_the_filter_leaves_exactly_the_rows_that_match(opened, run):
    """A family of random filters, against the table's own rows."""
    tab = opened
    table = next(t for t in tables(run) if t.name == "verdicts")
    titles = [column.title for column in table.columns]
    rows = [
        dict(zip(titles, map(text, row, table.columns), strict=True))
        for row in table.visible
    ]
    choices = [
        column.title
        for column in table.columns
        if column.choice and len({row[column.title] for row in rows}) > 1
    ]
    assert {"verdict", "study", "against"} <= {*choices}
    rng, counts = random.Random(7), set()
    for _ in range(24):
        example = rng.choice(rows)  # a row that the filter finds, most of the time
        wanted = {
            title: (example if rng.random() < 0.8 else rng.choice(rows))[title]
            for title in rng.sample(choices, rng.randint(0, 2))
        }
        words = rng.sample(re.findall(r"[\w.-]+", example[titles[2]]), 1)
        word = words[0] if rng.random() < 0.5 else ""
        expected = [
            all(row[title] == value for title, value in wanted.items() if value)
            and word.lower() in " ".join(row.values()).lower()
            for row in rows
        ]
        shown, said = tab.run(FILTER % repr({**wanted, "words": word.upper()}))
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
    assert every(tab, "#open-all", "e.hidden") == [False]
    for is_open in (True, False):
        every(tab, "#open-all", "e.click()")
        folds = every(tab, "details", "e.open")
        assert len(folds) > 3
        assert set(folds) == {is_open}


def test_without_the_script_the_page_is_whole(tab, pages, run):
    """What the script adds is controls; notes and commands are there without it."""
    tab.open(pages["failing"])
    every(tab, ".filter, .tools", "e.remove()")
    whole = every(tab, "main", "e.innerText.length")
    tab.open(pages["plain"])
    assert every(tab, "main", "e.innerText.length") == whole
    titles = every(tab, f"{FIGURE} circle title", "e.textContent")
    assert [tuple(words.splitlines()) for words in titles] == noted(run)
    assert every(tab, ".filter, .note, .tools, [aria-pressed]", "1") == []
    assert len(every(tab, "details.command code", "1")) > 10
    assert every(tab, "#open-all", "e.hidden") == [True]
    assert tab.complaints() == []


SAVED = """(() => {
  window.saved = [];
  URL.createObjectURL = (blob) => { saved.push(blob); return 'data:,'; };
  HTMLAnchorElement.prototype.click = function () { saved.push(this.download); };
})()"""


def saved(tab, figure, kind):
    """Name and text of the file that a figure's button makes, pressed by a key."""
    tab.run(SAVED)
    button = f'{figure} .tools [aria-label$=".{kind}"]'
    tab.run(f"document.querySelector('{button}').focus()")
    tab.press("Enter", 13, "\r")
    return tab.run("saved[0].text().then(text => [saved[1], text])")


def test_a_figure_offers_the_numbers_that_it_draws(opened, run):
    name, text = saved(opened, FIGURE, "csv")
    assert name == "summary-calibration.csv"
    head, *lines = csv.reader(io.StringIO(text))
    assert head[:4] == ["panel", "series", "x", "y"]
    (drawing,) = (d for d in drawings(run) if d.name == "summary-calibration")
    (panel,) = drawing.panels
    wanted = [
        (each.title, s.label, *map(float, (x, y)), half)
        for each in (panel, *panel.strips)
        for s in each.series
        for x, y, half in zip(
            s.x, s.y, [None] * len(s.x) if s.band is None else s.band, strict=True
        )
    ]
    assert len(wanted) == len(lines) > 9
    for line, (title, label, x, y, half) in zip(lines, wanted, strict=True):
        assert line[:2] == [title, label]
        assert line[5] == panel.x_label
        # nine digits are written
        assert [float(line[2]), float(line[3])] == pytest.approx([x, y], rel=1e-8)
        assert (line[4] == "") == (half is None)
        assert half is None or float(line[4]) == pytest.approx(half, rel=1e-8)


def words_of(picture):
    return {e.text for e in ElementTree.fromstring(picture).iter(f"{SVG}text")}


def test_a_figure_offers_itself_as_it_is_seen_in_light_colours(tab, pages):
    tab.open(pages["failing"], scheme="dark")
    unfold(tab)
    name, text = saved(tab, FIGURE, "svg")
    assert name == "summary-calibration.svg"
    assert {"RMS error", "misalignment T, mrad"} <= words_of(text)
    assert COLOURS[0] in text
    assert "var(" not in text
    # what is hidden on the page is not in the file
    every(tab, f"{FIGURE} .legend button", "e.click()")
    _, without = saved(tab, FIGURE, "svg")
    assert "RMS error" in words_of(without)
    assert "misalignment T, mrad" not in words_of(without)


TIME = np.arange(5000) / 100.0
WAVES = {"sine": np.sin(TIME), "slow": 5.0 * np.sin(0.1 * TIME) ** 2}


@pytest.fixture
def waves(tab, tmp_path):
    """A page with two signals over the same time."""
    panels = [
        linear(name, "time, s", name, [signal(TIME, y, "signal")], spans=[(20.0, 25.0)])
        for name, y in WAVES.items()
    ]
    drawing = Drawing(name="waves", caption="", panels=panels, columns=1)
    page = tmp_path / "waves.html"
    page.write_text(
        template("page").render(
            title="", version="", source="", sections=[made([drawing]).under("a", "a")]
        ),
        encoding="utf-8",
    )
    tab.open(page)
    yield tab
    assert tab.complaints() == []


LINES = "e.querySelector('g[data-keys] path').getAttribute('d')"


def seen(tab):
    """What is seen of each panel: ends of the time, and its line, by its own labels."""
    found = []
    for i, box in enumerate(every(tab, "[data-axes]", "e.dataset.axes")):
        left, top, right, foot = map(float, box.split()[:4])
        sheet = f"(e => e)(document.querySelectorAll('[data-axes]')[{i}])"
        words = "[e.textContent, +e.getAttribute('x'), +e.getAttribute('y')]"
        beside = tab.run(f"[...{sheet}.querySelectorAll('g.y text')].map(e => {words})")
        up = law([(number(word), y - 3.6) for word, _, y in beside], log=False)
        below = every(
            tab, "[data-axes]:last-of-type g.x text[text-anchor=middle]", words
        )
        across = law([(number(word), x) for word, x, _ in below], log=False)
        d = tab.run(f"(e => {LINES})({sheet})")
        line = np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", d), float)
        x, y = (
            (places - f(0.0)) / (f(1.0) - f(0.0))
            for places, f in zip(line.T, (across, up), strict=True)
        )
        inside = (line[:, 0] >= left) & (line[:, 0] <= right)
        ends = [
            (end - across(0.0)) / (across(1.0) - across(0.0)) for end in (left, right)
        ]
        share = np.ptp(line[inside, 1]) / (foot - top)
        found.append((*ends, x[inside], y[inside], share))
    return found


def check(found, low, high):
    """All panels show this part of the time, and the signals are where they were."""
    for (name, y), (first, last, times, values, share) in zip(
        WAVES.items(), found, strict=True
    ):
        # labels and places are rounded to 0.1 of 290 points
        assert (first, last) == pytest.approx((low, high), abs=2e-3 * (high - low)), (
            name
        )
        assert 0.9 < share < 0.92, name  # it has the whole height less its margins
        assert np.abs(values - np.interp(times, TIME, y)).max() < 0.01 * np.ptp(y), name
        assert len(times) > 8


def test_a_part_of_the_time_is_seen_by_keyboard_and_all_again(waves):
    tab, svg = waves, "document.querySelector('svg.long')"
    before = tab.run(f"{svg}.innerHTML")
    whole = seen(tab)
    low, high = whole[0][:2]
    check(whole, low, high)
    tab.run(f"{svg}.focus()")
    tab.press("+", 187, "+")
    tab.press("+", 187, "+")
    middle, part = (low + high) / 2.0, (high - low) / 8.0
    check(seen(tab), middle - part, middle + part)
    tab.press("ArrowRight", 39)
    check(seen(tab), middle - part / 2.0, middle + 1.5 * part)
    tab.press("-", 189, "-")
    check(seen(tab), middle - 1.5 * part, middle + 2.5 * part)
    tab.press("0", 48, "0")
    assert tab.run(f"{svg}.innerHTML") == before
    assert every(tab, ".tools button", "e.hidden") == [True, False, False]


def test_a_part_of_the_time_is_seen_by_a_drag(waves):
    tab, svg = waves, "document.querySelector('svg.long')"
    before = tab.run(f"{svg}.innerHTML")
    low, high = seen(tab)[0][:2]
    x, y, wide, view = tab.run(
        f"(r => [r.x, r.y, r.width, {svg}.viewBox.baseVal.width])"
        f"({svg}.getBoundingClientRect())"
    )
    box = every(tab, "[data-axes]", "e.dataset.axes")[0].split()
    left, right = float(box[0]), float(box[2])
    at = [
        x + wide / view * (left + share * (right - left)) for share in (0.3, 0.5, 0.6)
    ]
    mouse(tab, at[0], y + 60.0, "mousePressed")
    mouse(tab, at[1], y + 60.0)
    assert every(tab, ".chosen", "1") == [1]
    mouse(tab, at[2], y + 60.0, "mouseReleased")
    assert every(tab, ".chosen", "1") == []
    # the mouse is at whole pixels or near them
    check(seen(tab), low + 0.3 * (high - low), low + 0.6 * (high - low))
    every(tab, ".tools button", "e.textContent === 'Show all' && e.click()")
    assert tab.run(f"{svg}.innerHTML") == before
