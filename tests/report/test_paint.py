"""Drawings as SVG: words have room, ticks are labelled, points say their values."""

import io
import re
from base64 import b64decode
from dataclasses import replace
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_svg import RendererSVG
from matplotlib.image import imread
from matplotlib.text import Text

from simval.report.marks import log_ticks, percent, spelled
from simval.report.paint import (
    ALONE,
    STYLE,
    broken,
    figure_of,
    images,
    png,
    svg,
    svg_file,
)
from simval.report.panels import (
    COLOURS,
    MANY,
    BarPanel,
    DotPanel,
    Drawing,
    HeatPanel,
    Panel,
    Series,
    SpherePanel,
)
from simval.report.section import made

SVG = "{http://www.w3.org/2000/svg}"
X = np.array([1.0, 2.0])


def panel_of(*series, **more):
    return Panel(title="t", x_label="x", y_label="y", series=series, **more)


def drawing_of(*panels, **more):
    more = {"name": "a", "caption": "", "alternative": "in words", **more}
    return Drawing(panels=panels, **more)


def drawn(*panels):
    """The root of a figure."""
    return ElementTree.fromstring(svg(drawing_of(*panels)))


@pytest.mark.parametrize(
    ("low", "high"),
    [(11.0, 44.0), (18.0, 21.0), (0.97, 1.03), (1e-7, 2e3), (9.1, 9.9), (1e-15, 1.0),
     (0.0021, 0.0029), (4e5, 9e5)],
)  # fmt: skip
def test_a_logarithmic_axis_has_two_labels_at_least(low, high):
    ticks = log_ticks(low, high, np.empty(0))
    assert 2 <= len(ticks) <= 10
    assert all(low <= tick <= high for tick in ticks)
    assert len({spelled(tick) for tick in ticks}) == len(ticks)


def test_words_of_an_axis():
    places = [12.0, 20.0, 40.0]
    assert log_ticks(10.0, 48.0, np.array(places)) == places  # those of the data
    # too near to each other: round numbers
    assert 39.0 not in log_ticks(10.0, 48.0, np.array([12.0, 39.0, 40.0]))
    assert log_ticks(0.0, 1.0, np.empty(0)) == []
    assert [spelled(x) for x in (0.1, 1e-5, 3e7)] == ["0.1", "10⁻⁵", "3×10⁷"]
    # a class that fails a little is never called whole or none
    shares = (1e-3, 0.01, 0.3, 0.99, 0.9999, 1.0)
    assert [percent(share) for share in shares] == [
        *("<1", "1", "30", "99", ">99", "100")
    ]
    assert broken("filterpy_quaternion.py:UKF", 1.6).split("\n")[0][-1] in "_:"
    assert "".join(broken("a" * 60, 1.6).split("\n")) == "a" * 60


WORDS = ("scale", "spread", "0.9", "misalignment", "accelerometer", "noise", "of", "a",
         "m/s²", "σ²/g²", "residual", "equal_weights_" * 4, "poses", "12")  # fmt: skip


def some_words(rng, most):
    return " ".join(rng.choice(WORDS, size=int(rng.integers(1, most + 1))))


def some_panel(rng):
    size, log = 10.0 ** rng.integers(-4, 6), bool(rng.integers(2))
    x = size * (1.0 + np.arange(4.0))
    words = {"title": some_words(rng, 12), "x_label": some_words(rng, 12)}
    count = int(rng.integers(1, 17))
    values, names = (
        np.linspace(-1, 1, count),
        [some_words(rng, 6) for _ in range(count)],
    )
    kind = rng.choice(["bars", "dots", "heat", "curves", "curves"])
    if kind == "bars":
        return BarPanel(
            names=names, measured=values, band=values * 0, predicted=values, **words
        )
    if kind == "dots":
        dots = [Series(label=some_words(rng, 4), x=values, y=np.arange(count + 0.0))]
        return DotPanel(names=names, series=dots, reference=(0.0, ""), **words)
    if kind == "heat":
        shares = rng.uniform(0.0, 1.0, (count, 3))
        columns = [some_words(rng, 2) for _ in range(3)]
        return HeatPanel(
            title="t", names=names, columns=columns, shares=shares, expected=0 * shares
        )
    series = [
        Series(label=some_words(rng, 5), x=x, y=x * k)
        for k in range(1, int(rng.integers(2, 8)))
    ]
    return Panel(
        y_label=some_words(rng, 5), series=series, log_x=log, log_y=log, **words
    )


def misplaced(drawing):
    """Words of a figure that reach out of it, and legends over their axes."""
    with mpl.rc_context(STYLE):
        figure = figure_of(drawing)
        renderer = RendererSVG(*figure.bbox.size, io.StringIO())
        figure.draw_without_rendering()  # everything has its place, and no colour
        beyond = {
            label
            for axes in figure.axes
            for axis in (axes.xaxis, axes.yaxis)
            for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks())
            for label in (tick.label1, tick.label2)
            if not min(axis.get_view_interval()) <= tick.get_loc()
            <= max(axis.get_view_interval())
        }  # fmt: skip
        found = []
        for text in figure.findobj(Text):
            if text in beyond or not text.get_visible() or not text.get_text().strip():
                continue
            box = text.get_window_extent(renderer)
            inside = box.x0 >= 0 and box.y0 >= 0
            inside &= box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1
            if not inside:
                found.append((text.get_text(), box.extents.round()))
        for axes in figure.axes:
            if axes.get_legend() is not None:
                legend = axes.get_legend().get_window_extent(renderer)
                label = axes.xaxis.label.get_window_extent(renderer)
                if not legend.y1 <= label.y0 + 1.0:
                    found.append(("legend", legend.extents.round()))
    return found


@pytest.mark.parametrize("count", [2, pytest.param(150, marks=pytest.mark.slow)])
def test_no_word_is_cut_and_no_legend_is_over_its_curves(count):
    rng = np.random.default_rng(12)
    for _ in range(count):
        panels = [some_panel(rng) for _ in range(int(rng.integers(1, 5)))]
        drawing = drawing_of(*panels, columns=int(rng.integers(1, 4)))
        assert misplaced(drawing) == []
    # power: words that cannot be broken, and nobody makes room
    assert misplaced(drawing_of(panel_of(), columns=1)) == []
    wide = replace(panel_of(), x_label="W" * 100)
    assert misplaced(drawing_of(wide, columns=1))


def test_the_same_data_are_the_same_bytes_in_every_form():
    series = Series(label="a", x=X, y=X, band=0.1 * X, notes="12")
    globe = SpherePanel(title="z up", directions=np.eye(3), sign=1.0)
    drawing = drawing_of(panel_of(series), panel_of(series), globe)
    page, again = svg(drawing), svg(drawing)
    assert page == again
    ids = re.findall(r'\bid="([^"]*)"', page)
    assert len(ids) == len(set(ids))
    assert page.count("<svg") == 3
    assert (alone := svg_file(drawing)).count("<svg") == 1
    assert alone == svg_file(drawing)
    assert png(drawing) == png(drawing)


@pytest.mark.ci
def test_two_processes_draw_what_one_draws():
    many = [
        drawing_of(panel_of(Series(label="a", x=X, y=k * X)), panel_of(), name=f"d{k}")
        for k in range(ALONE // 2)
    ]
    assert images(many, 2) == {drawing.name: svg(drawing) for drawing in many}
    assert images(many, 1) == images(many[1:], 2) == {}


def pixels(text):
    """The pictures within an SVG: where they are painted, as rows of booleans."""
    found = re.findall(r"base64,([^\"]*)", text)
    return [imread(io.BytesIO(b64decode(each)))[:, :, 3] > 0.0 for each in found]


def test_many_points_are_pixels_and_none_is_left_out():
    rng = np.random.default_rng(7)
    n = 20_000
    x, y = rng.uniform(1, 10, n), rng.uniform(1, 10, n)
    band = rng.uniform(0.0, 0.1, n)
    band[1234] = 50.0
    text = svg(drawing_of(panel_of(Series(label="many", x=x, y=y, band=band))))
    # as vectors it takes some hundred bytes a point
    assert len(text) < 200_000
    assert "many</text>" in text  # words stay words
    # the widest bar reaches above all the others, and nothing else does
    painted = max(pixels(text), key=np.size)
    above = painted[-(len(painted) // 8) :]  # the rows of the file go upwards
    assert 0 < above.any(axis=0).sum() <= 20  # a cap, some points wide


def discs(root):
    """Note and place of every disc, by its group."""
    return {
        group.get("aria-label"): {
            disc[0].text: (float(disc.get("cx")), float(disc.get("cy")))
            for disc in group
        }
        for group in root.iter(f"{SVG}g")
        if group.get("class") == "points"
    }


def off_line(values, places):
    """Greatest distance of places from a straight line in the values, points."""
    design = np.column_stack([values, np.ones(len(values))])
    fitted, *_ = np.linalg.lstsq(design, np.asarray(places), rcond=None)
    return float(np.abs(design @ fitted - places).max())


ROUNDED = 0.11
"""Places are written to 0.1 point, so to 0.05 of it, and a fit moves by as much."""


@pytest.mark.parametrize("log", [False, True])
def test_each_disc_lies_where_its_value_does(log):
    """By the axes' own law: places are linear in the values, or in their logarithms."""
    rng = np.random.default_rng(5)
    x, y = rng.permutation(np.geomspace(1.0, 50.0, 9)), rng.uniform(1.0, 30.0, 9)
    y[3] = np.nan  # is not drawn, and its note is not another point's
    notes = [f"{a!r} {b!r}" for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    series = Series(label="s", x=x, y=y, band=np.full(9, 0.1), notes=notes)
    found = discs(drawn(panel_of(series, log_x=log, log_y=log)))["t, s"]
    assert sorted(found) == sorted(n for n in notes if "nan" not in n)
    values = np.array([[float(word) for word in text.split()] for text in found])
    places = np.array(list(found.values()))
    values = np.log(values) if log else values
    assert off_line(values[:, 0], places[:, 0]) < ROUNDED
    assert off_line(values[:, 1], places[:, 1]) < ROUNDED
    # right is more, up is more; and another pairing would be seen
    assert np.all(np.diff(places[np.argsort(values[:, 0]), 0]) > 0.0)
    assert np.all(np.diff(places[np.argsort(values[:, 1]), 1]) < 0.0)
    assert off_line(values[::-1, 0], places[:, 0]) > 10.0


def marks(root, key):
    """Places of the marks and caps that Matplotlib drew for a series."""
    image = root[0]
    return {
        (round(float(use.get("x")), 1), round(float(use.get("y")), 1))
        for group in image.iter(f"{SVG}g")
        if group.get("data-keys") == key
        for use in group.iter(f"{SVG}use")
    }


def test_discs_lie_on_the_marks_of_dodged_points_and_of_upper_limits():
    x = np.array([1.0, 2.0, 4.0])
    a = Series(label="a", x=x, y=x, band=np.array([2.0, 0.1, 0.1]), notes="123")
    b = replace(a, label="b", colour=COLOURS[1], notes="456")
    root = drawn(panel_of(a, b, dodge=True))
    for key, label in (("0-0", "t, a"), ("1-0", "t, b")):
        near = np.array(sorted(marks(root, key)))
        for place in discs(root)[label].values():
            assert np.abs(near - place).max(axis=1).min() <= 0.1001  # as written
    # set side by side, so different places
    first, second = discs(root).values()
    assert first["1"][0] + 1.0 < second["4"][0]
    # the limit lies at the end of its bar: 3, between 2 and 4
    assert first["3"][1] < first["1"][1] < first["2"][1]
    # and only an axis of logarithms has limits
    (first,) = discs(drawn(replace(panel_of(a), log_y=False))).values()
    assert first["3"][1] < first["2"][1] < first["1"][1]


def test_dots_and_bars_have_discs_and_what_a_note_says_is_text():
    words = "</title><script>alert(1)</script> & \"'"
    three, far = np.array([1.0, np.inf, 3.0]), np.arange(3.0)
    notes = ["a", "b", words]
    dots = DotPanel(
        title="t", x_label="x", names="pqr", reference=(1.0, ""),
        series=[Series(label="<b>", x=three, y=far, notes=notes)],
    )  # fmt: skip
    bars = BarPanel(
        title="t", x_label="x", names="pqr",
        measured=three, band=far, predicted=far, notes=notes,
    )  # fmt: skip
    for panel in (dots, bars):
        (found,) = discs(drawn(panel)).values()
        assert list(found) == ["a", words]
        assert found["a"][1] < found[words][1]  # from top to bottom


@pytest.mark.parametrize(("count", "found"), [(MANY, MANY), (MANY + 1, 0)])
def test_points_that_are_pixels_have_no_discs(count, found):
    x = np.arange(1.0, count + 1.0)
    drawing = drawing_of(panel_of(Series(label="s", x=x, y=x, notes=["n"] * count)))
    text = svg(drawing)
    root = ElementTree.fromstring(text)
    assert (root.get("role") == "img") == (not found)  # one image, in its words
    assert found or root.get("aria-label") == "in words"
    assert text.count("<circle") == found
    # and its caption says so
    page = str(made([drawing]).body)
    assert ("drawn as pixels" in page) == (not found)
    assert ("data-key=" in text) == bool(found)  # nor can they be switched off


def keys_of(root):
    """Legend entries, by words; and of each group of marks or lines its entries."""
    names = {
        "".join(group.itertext()).strip(): group.get("data-key")
        for group in root.iter(f"{SVG}g")
        if group.get("data-key") and list(group.iter(f"{SVG}text"))
    }
    words = {key: name for name, key in names.items()}
    held = [
        frozenset(words[key] for key in group.get("data-keys").split())
        for group in root[0].iter(f"{SVG}g")
        if group.get("data-keys") is not None
    ]
    return sorted(names), set(held)


def test_a_legend_holds_its_series_and_the_lines_that_belong_to_them():
    blue, orange, green = COLOURS[:3]
    panel = panel_of(
        Series(label="A", x=X, y=X, colour=blue),
        Series(label="theory", x=X, y=X, colour=blue, line="-"),
        Series(label="B", x=X, y=2 * X, colour=orange),
        Series(label="", x=X, y=2 * X, colour=orange, line="-"),
        Series(label="bound", x=X, y=X, colour=green, line=":"),
    )
    names, held = keys_of(drawn(panel))
    assert names == ["A", "B", "bound", "theory"]
    expected = ("A", "A theory", "B", "B theory", "bound")
    assert held == {frozenset(keys.split()) for keys in expected}
    # a line with an entry of its own, among others that have one, is held by it alone
    own = [
        Series(label="points", x=X, y=X),
        Series(label="exact", x=X, y=X, line="-"),  # the same colour
        Series(label="order", x=X, y=X, line="-", colour=orange),
    ]
    _, held = keys_of(drawn(panel_of(*own)))
    assert held == {frozenset({s.label}) for s in own}
