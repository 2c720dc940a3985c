"""Drawings as SVG: words have room, ticks are labelled, points say their values."""

import io
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.font_manager import FontProperties
from matplotlib.image import imread
from matplotlib.textpath import TextToPath
from read_back import REACH, not_numbers, off_datum

from simval.report.marks import (
    MARGIN,
    MARK,
    decimals,
    even_ticks,
    framed,
    log_ticks,
    minor_ticks,
    percent,
    spelled,
)
from simval.report.paint import UP, broken, png, shown, svg, svg_file
from simval.report.panels import (
    COLOURS,
    GREY,
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


@pytest.mark.parametrize(
    ("low", "high", "names"),
    [
        (-0.3, 4.2, "0 2 4"),
        (0.94, 1.06, "0.95 1.00 1.05"),
        (-2.6e7, 3e7, "−2×10⁷ 0 2×10⁷"),
        (1e-8, 9e-8, "2×10⁻⁸ 4×10⁻⁸ 6×10⁻⁸ 8×10⁻⁸"),
    ],
)
def test_a_linear_axis_has_round_numbers(low, high, names):
    ticks = even_ticks(low, high, 4)
    assert " ".join(decimals(ticks)) == names
    assert even_ticks(0.1, 2.9, 5, whole=True) == [1.0, 2.0]


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
    assert broken("filterpy_quaternion.py:UKF", 115.0).split("\n")[0][-1] in "_:"
    assert "".join(broken("a" * 60, 115.0).split("\n")) == "a" * 60


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


METRICS = TextToPath()


def box_of(text):
    """Corners of a word as the font draws it, which the program only estimates."""
    size = 10.0 * float(text.get("font-size", "1em").removesuffix("em"))
    weight = "bold" if text.get("font-weight") else "normal"
    font = FontProperties(family="DejaVu Sans", size=size, weight=weight)
    width, height, drop = METRICS.get_text_width_height_descent(text.text, font, False)
    left = width * {"middle": -0.5, "end": -1.0}.get(text.get("text-anchor"), 0.0)
    corners = np.array([[left, drop], [left + width, drop - height]])
    numbers = re.findall(r"-?[\d.]+", text.get("transform", "0 0 0"))
    turn = np.radians(float(numbers[2]))
    every = np.array([[x, y] for x in corners[:, 0] for y in corners[:, 1]])
    every = every @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
    every += [float(n) for n in numbers[:2]] if turn else 0.0
    every += [float(text.get("x", 0.0)), float(text.get("y", 0.0))]
    return np.array([every.min(axis=0), every.max(axis=0)])


def misplaced(drawing):
    """Words of a figure that reach out of it, or of a legend over words above it."""
    found = []
    for panel in drawing.panels:
        root = ElementTree.fromstring(svg_file(replace(drawing, panels=[panel])))
        size = np.array([float(n) for n in root.get("viewBox").split()[2:]])
        words = [*root.iter(f"{SVG}text")]
        boxes = [box_of(text) for text in words]
        for text, (low, high) in zip(words, boxes, strict=True):
            if np.any(low < 0.0) or np.any(high > size):
                found.append((text.text, low, high))
        (clip,) = root.iter(f"{SVG}rect")
        foot = float(clip.get("y")) + float(clip.get("height")) - REACH
        small = [
            w.get("font-size") == "0.85em" and not w.get("text-anchor") for w in words
        ]
        under = [k for k, (legend, box) in enumerate(zip(small, boxes, strict=True))
                 if legend and box[0, 1] > foot]  # fmt: skip
        others = [box[1, 1] for k, box in enumerate(boxes) if k not in under]
        assert bool(under) == bool(getattr(panel, "series", ()))
        if under and min(boxes[k][0, 1] for k in under) < max(*others, foot) - 1.0:
            found.append("legend")
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


def test_a_marker_stands_at_its_datum_and_what_has_no_width_has_no_bar():
    """Also where several stand at one place; half a percent of the axis is seen."""
    rng, counts = np.random.default_rng(21), []
    for _ in range(24):
        drawing = drawing_of(some_panel(rng))
        off, count = off_datum(drawing)
        assert off == []
        assert not_numbers(svg(drawing)) == []
        counts.append(count)
    assert sum(counts) > 200
    x, none = np.array([1.0, 1.5]), np.full(2, np.nan)
    dots = Series(label="", x=x, y=np.arange(2.0), band=none)
    panel = DotPanel(
        title="t", x_label="", names="ab", series=[dots], reference=(1, "")
    )
    assert not_numbers(svg(drawing_of(panel))) == []
    assert off_datum(drawing_of(panel)) == ([], 2)


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


def test_a_png_is_drawn_as_the_svg():
    """Of a panel with one mark, the only blue in it is where the disc lies."""
    series = Series(label="", x=X[:1], y=X[:1], notes="1", colour="#0000ff")
    drawing = drawing_of(panel_of(series))
    picture = imread(io.BytesIO(png(drawing)))
    height, width = picture.shape[:2]
    root = ElementTree.fromstring(svg_file(drawing))
    size = root.get("viewBox").split()
    blue = np.argwhere((picture[..., 2] > 0.9) & (picture[..., 0] < 0.1))
    scale = height / float(size[3])
    assert scale == pytest.approx(width / float(size[2]), abs=0.01)
    ((place,),) = (found.values() for found in discs(root).values())
    np.testing.assert_allclose(blue.mean(axis=0)[::-1] / scale, place, atol=0.5)
    assert np.ptp(blue, axis=0) / scale == pytest.approx(MARK, abs=1.5)  # across


def paths(text):
    """Corners of the paths of an SVG that are drawn in blue, one after the other."""
    found = re.findall(rf'd="([^"]*)"[^>]*{COLOURS[0]}', text)
    return [np.array(re.findall(r"[ML]([\d.-]+) ([\d.-]+)", d), float) for d in found]


def test_many_points_are_fewer_and_none_is_left_out():
    rng = np.random.default_rng(7)
    n = 20_000
    x, y = np.sort(rng.uniform(1, 10, n)), rng.uniform(1, 10, n)
    band = rng.uniform(0.0, 0.1, n)
    band[1234] = 50.0
    points = Series(label="many", x=x, y=y, band=band)
    line = replace(points, line="-", band=None)
    plain = {"log_x": False, "log_y": False}
    text = svg(drawing_of(panel_of(points, **plain)))
    assert len(text) < 300_000  # all of them: five times that
    bars, marks = paths(text)[:2]
    # by the law of the axes, from the ends of their data
    across = np.polyval(np.polyfit(x[[0, -1]], marks[:, 0][[0, -1]], 1), x)
    low, high = marks[:, 1].max(), marks[:, 1].min()
    up = low + (y - y.min()) / np.ptp(y) * (high - low)
    places = {tuple(p) for p in np.rint(marks / 2.0)}
    near = [
        any((a + i, b + j) in places for i in (-1, 0, 1) for j in (-1, 0, 1))
        for a, b in np.rint(np.column_stack([across, up]) / 2.0)
    ]
    assert all(near)
    # the widest bar reaches beyond all the others, and nothing else does
    beyond = bars[bars[:, 1] < np.sort(bars[:, 1])[2] - 10.0]
    assert len(beyond) in (1, 2, 3)
    # a line keeps its spikes: fifty of them, farther apart than a part of the axis
    spikes = np.arange(200, n, 400)
    y[spikes] = 20.0 + np.arange(len(spikes))
    (found,) = paths(svg(drawing_of(panel_of(replace(line, y=y), **plain))))
    assert len(found) < 2100
    up = (UP / 1.1) * (y - y.max()) / np.ptp(y)  # axes less their margins
    for height in up[spikes]:
        assert np.abs(found[:, 1].min() - height - found[:, 1]).min() < 0.11


@pytest.mark.parametrize("bent", [np.sin, np.exp, lambda x: np.abs(x - 2.0)])
def test_a_smooth_line_of_few_points_is_that_of_many(bent):
    """Off by no more than 0.6 % of the axes, and a few hundred of 20 000 points."""
    x = np.linspace(0.0, 10.0, 20_000)
    line = Series(label="", x=x, y=bent(x), line="-")
    ((_, rows),) = framed(panel_of(line, log_x=False, log_y=False), []).data
    few, places = np.array(rows)[:, :2].astype(float).T, len(rows)
    assert places < 200
    off = np.abs(np.interp(x, *few) - line.y).max() / (1.1 * np.ptp(line.y))
    assert off < 0.006


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
    """Places of the dots and corners that are drawn for a series."""
    return [
        (float(x), float(y))
        for group in root[0].iter(f"{SVG}g")
        if group.get("data-keys") == key
        for path in group
        for x, y in re.findall(r"M([\d.-]+) ([\d.-]+)", path.get("d"))
    ]


def test_discs_lie_on_the_marks_of_points_and_of_upper_limits():
    x = np.array([1.0, 2.0, 4.0])
    a = Series(label="a", x=x, y=x, band=np.array([2.0, 0.1, 0.1]), notes="123")
    b = replace(a, label="b", colour=COLOURS[1], notes="456")
    root = drawn(panel_of(a, b))
    for key, label in (("0", "t, a"), ("1", "t, b")):
        near = np.array(sorted(marks(root, key)))
        for place in discs(root)[label].values():
            assert np.abs(near - place).max(axis=1).min() <= 2.6  # half a mark
    first, second = discs(root).values()
    assert first["1"] == second["4"]  # of the same data
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
def test_very_many_points_have_no_discs(count, found):
    x = np.arange(1.0, count + 1.0)
    drawing = drawing_of(panel_of(Series(label="s", x=x, y=x, notes=["n"] * count)))
    text = svg(drawing)
    assert text.count("<circle") == found
    # and its caption says so
    page = str(made([drawing]).body)
    assert ("do not show their values" in page) == (not found)


def over_time(*labels, scale=1.0):
    """Panels of one quantity over the same time, each with a line."""
    return [
        Panel(
            title=f"panel {k}", x_label="time, s", y_label="angle, degrees",
            series=[Series(label=label, x=X + k, y=scale**k * X, line="-")],
            spans=[(1.0, 1.5)], log_x=False, log_y=False,
        )
        for k, label in enumerate(labels)
    ]  # fmt: skip


def test_panels_that_are_alike_share_an_axis_a_scale_and_a_legend():
    alike = drawing_of(*over_time("a", "a"), columns=1)
    plan, pictures = shown(alike)
    assert len(pictures) == len(plan.parts) == 1
    assert pictures[0].count(">time, s<") == 1
    assert [entry.label for entry in plan.legend] == ["a", "at rest"]
    first, second = plan.parts[0].sheets
    assert first.x == second.x
    assert first.x.axis.low < 1.0 < 3.0 < first.x.axis.high
    # a label that looks like another one elsewhere stands with its panel
    plan, pictures = shown(drawing_of(*over_time("a", "b"), columns=1))
    assert len(pictures) == 2
    assert plan.legend == []
    assert [part.legend[0].label for part in plan.parts] == ["a", "b"]


@pytest.mark.parametrize(("scale", "shared"), [(2.0, True), (100.0, False)])
def test_panels_of_a_quantity_have_one_scale_or_it_is_said(scale, shared):
    drawing = drawing_of(*over_time("a", "a", scale=scale))
    plan = shown(drawing)[0]
    first, second = (part.sheets[0].frame.y for part in plan.parts)
    assert (first.high == second.high) == shared
    page = str(made([drawing]).body)
    assert ("Their scales differ by up to 100 times" in page) == (not shared)


def test_a_legend_says_what_is_shaded_hollow_or_a_limit():
    limit = Series(label="a", x=X, y=X, band=np.array([2.0, 0.1]))
    panel = panel_of(limit, references=[(0.1, "allowed"), (9.0, "")], spans=[(1, 1.5)])
    entries = shown(drawing_of(panel))[0].legend
    words = ["a", "allowed", "at rest", "upper limit: the bar reaches 0"]
    assert [entry.label for entry in entries] == words
    hollow = [
        ink for entry in entries for ink in entry.ink if getattr(ink, "hollow", 0)
    ]
    assert len(hollow) == 1


def names_at_ends(*panels, columns=1):
    """Names of lines at their ends, each with its height over that of the axes."""
    found = {}
    for part in shown(drawing_of(*panels, columns=columns))[0].parts:
        for sheet in part.sheets:
            for group in sheet.groups:
                for word in group.ink if "ends" in group.attributes else ():
                    share = (sheet.y.start - word.y) / (sheet.y.start - sheet.y.stop)
                    assert sheet.x.stop < word.x  # beside the axes
                    found.setdefault(word.text, []).append(share)
    return found


def test_lines_are_named_at_their_ends_where_these_are_apart():
    x = np.arange(5.0)
    a, b, c = (
        Series(label=name, x=x, y=np.full(5, y), colour=colour, line="-")
        for name, y, colour in zip("abc", (0.0, 1.0, 2.0), COLOURS, strict=False)
    )
    bound = Series(label="bound", x=x, y=x, colour=GREY, line=":")
    panel = replace(panel_of(a, b, c, bound), log_x=False, log_y=False)
    found = names_at_ends(panel)
    # its data have the axis less a margin at both ends, and the bound reaches to 4
    share = 1.0 / (1.0 + 2.0 * MARGIN)
    expected = {n: [share * (y / 4.0 + MARGIN)] for y, n in enumerate("abc")}
    assert found == {n: pytest.approx(h, abs=1e-9) for n, h in expected.items()}
    # a strip of one line has its name as well; a panel of one line has none
    strip = replace(panel, series=[b], limits=(0.5, 1.5), height=0.3)
    assert names_at_ends(replace(panel, strips=[strip]))["b"] == pytest.approx(
        [share * (0.25 + MARGIN), 0.5]
    )
    near = replace(b, y=np.full(5, 0.1))  # its name would be on that of `a`
    early = replace(b, x=x / 2.0)  # ends in the middle of the axes
    twin = replace(a, label="", y=a.y + 1.5)  # of a cell of the same name
    for series in ([b], [a, near, c], [a, early], [a, twin, c]):
        assert names_at_ends(replace(panel, series=[*series, bound])) == {}, series


def test_a_logarithmic_axis_has_ticks_between_its_names():
    axis = framed(panel_of(Series(label="", x=X, y=np.array([1.0, 1e3]))), []).y
    ticks = minor_ticks(axis)
    assert {20.0, 90.0, 200.0} < {*ticks}
    assert all(axis.low <= tick <= axis.high for tick in ticks)
    assert minor_ticks(replace(axis, log=False)) == []


def keys_of(drawing):
    """Legend entries, by words; and of each group of marks or lines its entries."""
    plan, (picture,) = shown(drawing)
    words = {entry.key: entry.label for entry in plan.legend}
    held = [
        frozenset(words[key] for key in group.get("data-keys").split())
        for group in ElementTree.fromstring(picture)[0].iter(f"{SVG}g")
        if group.get("data-keys") is not None
    ]
    return sorted(words.values()), set(held)


def test_a_legend_holds_its_series_and_the_lines_that_belong_to_them():
    blue, orange, green = COLOURS[:3]
    panel = panel_of(
        Series(label="A", x=X, y=X, colour=blue),
        Series(label="theory", x=X, y=X, colour=blue, line="-"),
        Series(label="B", x=X, y=2 * X, colour=orange),
        Series(label="", x=X, y=2 * X, colour=orange, line="-"),
        Series(label="bound", x=X, y=X, colour=green, line=":"),
    )
    names, held = keys_of(drawing_of(panel))
    assert names == ["A", "B", "bound", "theory"]
    expected = ("A", "A theory", "B", "B theory", "bound")
    assert held == {frozenset(keys.split()) for keys in expected}
    # a line with an entry of its own, among others that have one, is held by it alone
    own = [
        Series(label="points", x=X, y=X),
        Series(label="exact", x=X, y=X, line="-"),  # the same colour
        Series(label="order", x=X, y=X, line="-", colour=orange),
    ]
    _, held = keys_of(drawing_of(panel_of(*own)))
    assert held == {frozenset({s.label}) for s in own}
