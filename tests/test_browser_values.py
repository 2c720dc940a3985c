"""Values on demand in a real browser: points, legends, the filter and the folds."""

import random
import re
import shlex
import time

import pytest
from browser import browser, find_chromium
from stores import edited

from simval.report import render, tables
from simval.report.page import sections
from simval.report.table import text
from simval.report.words import measured
from simval.statistics import FIRST_ORDER, RMS
from simval.sweep import load_run

pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(
        find_chromium() is None,
        reason="Chromium is not installed, so the report was not opened in a browser",
    ),
]

FIGURE = "#figure-summary-calibration"
BOX = "document.querySelector('.note')"


@pytest.fixture(scope="module")
def run(_tiny_run, tmp_path_factory):
    """A run with checks that fail."""
    import shutil

    folder = tmp_path_factory.mktemp("values") / "run"
    shutil.copytree(_tiny_run, folder)
    edited(
        folder,
        "UPDATE rows SET value = value + 20 * standard_error "
        "WHERE family = 'bias' AND controlled = 0 "
        "AND entries = json_array('x') AND cell = 3",
    )
    return load_run(folder)


@pytest.fixture(scope="module")
def page(run, tmp_path_factory):
    """Its page, with the button that opens everything."""
    path = tmp_path_factory.mktemp("page") / "report.html"
    whole = render(run)
    if 'id="open-all"' not in whole:
        button = '<button type="button" id="open-all" hidden>Open everything</button>'
        whole = whole.replace("<main>", f"{button}<main>")
    path.write_text(whole, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def tab(tmp_path_factory):
    """One page of one browser for all tests."""
    with browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture(autouse=True)
def quiet(tab, page):
    """Each test begins with the page as it opens, and leaves no complaint."""
    tab.open(page)
    # every fold that a figure may be behind is open, as a reader would have it
    tab.run(
        "document.querySelectorAll('details:not(.command)').forEach(d => d.open = true)"
    )
    yield
    assert tab.complaints() == []
    asked = [address for address in tab.requests() if not address.startswith("data:")]
    assert len(asked) == 1


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


def test_a_hover_shows_the_row_of_the_point(tab, run):
    """What the box says, against the rows of the run and not against the note."""
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


def test_the_box_stays_under_the_pointer_and_can_be_dismissed(tab):
    """WCAG 1.4.13: hoverable, persistent, dismissible."""
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


def test_the_text_of_the_box_can_be_copied(tab):
    point_at(tab, disc(0))
    command = told(tab)[-1]
    click_in_code = (
        f"(() => {{ const r = {BOX}.querySelector('code').getBoundingClientRect();"
        "return [r.x + 5, r.y + 5]; })()"
    )
    x, y = tab.run(click_in_code)
    for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
        button = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
        tab.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **button)
    assert tab.run("String(getSelection())") == command


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


def test_the_keyboard_reaches_every_point_by_one_stop(tab, run):
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
def test_an_entry_of_a_legend_hides_its_series_and_nothing_else(tab, keyboard):
    buttons = tab.run(
        f"[...document.querySelectorAll('{FIGURE} [role=button]')]"
        ".map(b => [b.dataset.key, b.getAttribute('aria-pressed')])"
    )
    assert len(buttons) == 3
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


def test_hidden_points_are_passed_over_by_the_keyboard(tab):
    first = tab.run(f"{disc(0)}.parentNode.dataset.keys")
    button = f"document.querySelector('{FIGURE} [data-key=\"{first}\"][role=button]')"
    click(tab, f"{button}.querySelector('text')")
    to_points(tab)
    keys = tab.run("document.activeElement.parentNode.dataset.keys")
    assert keys
    assert keys != first


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


def test_the_filter_leaves_exactly_the_rows_that_match(tab, run):
    """A family of random filters, against the table's own rows."""
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
    for _ in range(60):
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
    assert len(counts) > 10  # the family is not all or nothing
    shown, said = tab.run(FILTER % "{}")
    assert all(shown)
    more = len(table.rows) > len(rows)
    assert (f"of {len(table.rows)} in all" in said) == more


def test_a_filter_survives_sorting(tab):
    before, _ = tab.run(FILTER % "{words: 'covariance'}")
    head = (
        "[...document.querySelector('#table-verdicts').closest('table')"
        ".querySelectorAll('th')].find(th => th.textContent.trim() === 'p')"
        ".querySelector('button')"
    )
    tab.run(f"{head}.click()")
    after = tab.run(
        "[...document.querySelector('#table-verdicts').closest('table')"
        ".tBodies[0].rows].filter(row => !row.hidden)"
        ".map(row => row.cells[2].textContent)"
    )
    assert 0 < len(after) == sum(before) < len(before)
    assert all("covariance" in name for name in after)


def test_the_command_of_a_check_is_in_sight_on_request(tab, run):
    row = (
        "document.querySelector('#table-verdicts').closest('table').tBodies[0].rows[0]"
    )
    fold = f"{row}.querySelector('details.command')"
    click(tab, f"{fold}.querySelector('summary')")
    assert tab.run(f"{fold}.open")
    right = tab.run(f"{fold}.querySelector('code').getBoundingClientRect().right")
    assert right <= 1280
    command = tab.run(f"{fold}.querySelector('code').textContent")
    assert command.startswith("simval repro --run run ")


def test_the_button_opens_and_closes_every_fold(tab):
    button = "document.querySelector('#open-all')"
    assert tab.run(f"!{button}.hidden")
    folds = "[...document.querySelectorAll('details')].map(d => d.open)"
    tab.run(f"{button}.click()")
    assert len(tab.run(folds)) > 3
    assert all(tab.run(folds))
    tab.run(f"{button}.click()")
    assert not any(tab.run(folds))


def test_a_link_opens_the_fold_around_its_end(tab):
    """A figure behind a fold, and one behind a fold within a fold."""
    tab.run(
        "document.querySelectorAll('details').forEach(d => d.open = false);"
        f"for (let i = 0; i < 2; i++) {{ const f = document.querySelector('{FIGURE}');"
        "const d = document.createElement('details'); f.before(d); d.append(f); }"
    )
    for _ in range(2):  # the second time the address does not change
        tab.run(
            "(() => { const a = document.createElement('a');"
            f"a.href = '{FIGURE}'; document.body.append(a); a.click(); }})()"
        )
        time.sleep(0.1)
        assert tab.run(
            f"[...document.querySelectorAll('details')].filter(d => d.contains("
            f"document.querySelector('{FIGURE}'))).map(d => d.open)"
        ) == [True, True]
        top = tab.run(f"document.querySelector('{FIGURE}').getBoundingClientRect().top")
        assert -1 <= top < 900
        tab.run("document.querySelectorAll('details').forEach(d => d.open = false)")


def test_without_the_script_titles_and_commands_are_there(tab, page, run, tmp_path):
    path = tmp_path / "plain.html"
    whole = page.read_text(encoding="utf-8")
    path.write_text(re.sub(r"<script>.*?</script>", "", whole, flags=re.DOTALL))
    tab.open(path)
    titles = tab.run(
        f"[...document.querySelectorAll('{FIGURE} circle title')]"
        ".map(t => t.textContent)"
    )
    assert [tuple(words.splitlines()) for words in titles] == noted(run)
    # a screen reader has them as images with a name
    nodes = tab.call("Accessibility.getFullAXTree")["nodes"]
    names = {
        node["name"]["value"].replace("\n", " ")
        for node in nodes
        if node["role"]["value"] == "image" and not node.get("ignored")
    }
    assert {" ".join(lines) for lines in noted(run)} <= names
    assert (
        tab.run("document.querySelectorAll('.filter, .note, [aria-pressed]').length")
        == 0
    )
    commands = tab.run("document.querySelectorAll('details.command code').length")
    assert commands > 10
    assert tab.run("document.querySelector('#open-all').hidden")


@pytest.mark.slow  # the whole page twice: `test_report` redraws a part at each landing
def test_the_same_run_gives_the_same_bytes(run):
    assert render(run) == render(run)
