"""Values on demand: what the page says of a point, and where its disc lies."""

import shlex
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
import rows_by_name
from rounding import EPS
from rows_by_name import cell

from simval.report import tables
from simval.report.axes import MANY
from simval.report.curves import curve, statistic
from simval.report.measures import moment
from simval.report.notes import Measured, folder_of, located, note
from simval.report.page import sections
from simval.report.paint import svg
from simval.report.panels import COLOURS, DotPanel, Drawing, Panel, Series
from simval.report.section import made
from simval.report.units import MILLIRADIAN
from simval.statistics import BIAS, EXACT, RMS
from simval.sweep import load_run

SVG = "{http://www.w3.org/2000/svg}"


def drawn(*panels, **changes):
    """The root of a figure."""
    drawing = Drawing(
        name="a", caption="", alternative="in words", panels=panels, **changes
    )
    return ElementTree.fromstring(svg(drawing))


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
    panel = Panel(
        title="t", x_label="x", y_label="y", series=(series,), log_x=log, log_y=log
    )
    found = discs(drawn(panel))["t, s"]
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
    panel = Panel(title="", x_label="", y_label="", series=(a, b), dodge=True)
    root = drawn(panel)
    for key, label in (("0-0", "a"), ("1-0", "b")):
        near = np.array(sorted(marks(root, key)))
        for place in discs(root)[label].values():
            assert np.abs(near - place).max(axis=1).min() <= 0.1 + 8 * EPS * 400
    # set side by side, so different places
    first, second = discs(root).values()
    assert first["1"][0] + 1.0 < second["4"][0]
    # the limit lies at the end of its bar: 3, between 2 and 4
    assert first["3"][1] < first["1"][1] < first["2"][1]


def test_dots_of_named_things_have_discs():
    series = Series(
        label="s", x=np.array([1.0, np.inf, 3.0]), y=np.arange(3.0), notes="abc"
    )
    panel = DotPanel(
        title="t", x_label="x", names="pqr", series=(series,), reference=(1.0, "")
    )
    found = discs(drawn(panel, columns=1))["t, s"]
    assert list(found) == ["a", "c"]
    assert found["a"][1] < found["c"][1]  # from top to bottom


@pytest.mark.ci
@pytest.mark.parametrize(("count", "found"), [(MANY, MANY), (MANY + 1, 0)])
def test_points_that_are_pixels_have_no_discs(count, found):
    x = np.arange(1.0, count + 1.0)
    series = Series(label="s", x=x, y=x, notes=["n"] * count)
    drawing = Drawing(
        name="a",
        caption="",
        alternative="",
        panels=[Panel(title="", x_label="", y_label="", series=(series,))],
    )
    text = svg(drawing)
    assert text.count("<circle") == found
    # and its caption says so
    page = str(made("plain", "", [drawing]).body)
    assert ("drawn as pixels" in page) == (not found)
    assert ("data-key=" in text) == bool(found)  # nor can they be switched off


def test_a_figure_without_notes_and_legend_stays_one_image():
    root = drawn(
        Panel(
            title="",
            x_label="",
            y_label="",
            series=(Series(label="", x=np.ones(2), y=np.ones(2)),),
        )
    )
    assert root.get("role") == "img"
    assert root.get("aria-label") == "in words"


def test_what_a_note_says_is_text():
    words = "</title><script>alert(1)</script> & \"'"
    series = Series(label="<b>", x=np.ones(1), y=np.ones(1), notes=[words])
    root = drawn(Panel(title="", x_label="", y_label="", series=(series,)))
    assert discs(root) == {"<b>": {words: pytest.approx(discs(root)["<b>"][words])}}


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
    x = np.array([1.0, 2.0])
    blue, orange, green = COLOURS[:3]
    panel = Panel(
        title="",
        x_label="",
        y_label="",
        series=(
            Series(label="A", x=x, y=x, colour=blue),
            Series(label="theory", x=x, y=x, colour=blue, line="-"),
            Series(label="B", x=x, y=2 * x, colour=orange),
            Series(label="", x=x, y=2 * x, colour=orange, line="-"),
            Series(label="bound", x=x, y=x, colour=green, line=":"),
        ),
    )
    names, held = keys_of(drawn(panel))
    assert names == ["A", "B", "bound", "theory"]
    assert held == {
        frozenset({"A"}),
        frozenset({"A", "theory"}),
        frozenset({"B"}),
        frozenset({"B", "theory"}),
        frozenset({"bound"}),
    }


def test_lines_with_entries_of_their_own_are_held_by_nothing_else():
    x = np.array([1.0, 2.0])
    series = [
        Series(label="points", x=x, y=x),
        Series(label="exact", x=x, y=x, line="-"),  # the same colour
        Series(label="order 2", x=x, y=x, line="-", colour=COLOURS[1]),
    ]
    _, held = keys_of(drawn(Panel(title="", x_label="", y_label="", series=series)))
    assert held == {frozenset({s.label}) for s in series}


def test_a_note_says_number_prediction_cell_and_command():
    row = rows_by_name.row(
        "rms[T]", 6.3262e-5, standard_error=5.4e-7, n=4096, prediction=6.3e-5
    )
    here = replace(
        cell([row]),
        name="calibration(poses=12)@1",
        study="calibration",
        parameters={"scene": "gimbal", "poses": 12, "noise_std": 0.02, "trials": 9},
        run="my run",
    )
    c = curve("", [here], "noise_std", statistic(row.statistic))
    assert c.notes == (
        "(6.326 ± 0.054)e-5, n = 4096\n"
        "predicted 6.3e-05\n"
        "calibration: gimbal, 12 poses, noise 0.02 m/s²\n"
        "simval repro --run 'my run' 'calibration(poses=12)@1'",
    )
    assert c.points(1.0).notes == c.notes
    # in a unit for people the note goes with the axis
    own = c.scaled(MILLIRADIAN)
    assert own.value[0] == c.value[0] * 1e3
    assert own.error[0] == c.error[0] * 1e3
    assert own.notes[0].splitlines()[:2] == [
        "0.06326 ± 0.00054 mrad, n = 4096",
        "predicted 0.063 mrad",
    ]
    # where nothing is sampled or predicted, nothing is said of it
    bare = note(here, Measured(2.0, 0.0, np.nan))
    assert bare.splitlines()[0] == "2"
    assert "predicted" not in bare


def test_notes_stay_with_their_points_when_a_curve_is_sorted():
    rng = np.random.default_rng(3)
    noise = rng.permutation(np.geomspace(1e-3, 1.0, 12))
    cells = [
        replace(
            cell([rows_by_name.row("rms[T]", 2.0 * x, standard_error=0.1, n=k)]),
            parameters={"noise_std": float(x)},
        )
        for k, x in enumerate(noise, start=1)
    ]
    c = curve("", cells, "noise_std", statistic(RMS("T")))
    assert np.all(np.diff(c.x) > 0.0)
    order = np.argsort(noise)
    assert [n.splitlines()[0].split("n = ")[1] for n in c.notes] == [
        str(k + 1) for k in order
    ]


def test_a_moment_says_the_fewest_samples_of_its_rows():
    rows = [
        rows_by_name.row(
            f"bias[{name}]",
            1e-3,
            standard_error=1e-4,
            n=n,
            prediction=1e-3,
            predictor="exact",
        )
        for name, n in (("x", 300), ("y", 200), ("z", 400))
    ]
    assert moment(BIAS, EXACT)(cell(rows)).n == 200


@pytest.mark.ci
def test_every_note_of_a_run_names_a_cell_of_it(tiny_run, simval, monkeypatch):
    monkeypatch.chdir(tiny_run.parent)
    run = load_run(tiny_run)
    assert {c.run for c in run.cells} == {""}
    assert {c.run for c in located(run).cells} == {folder_of(run)} == {"tiny"}
    names = {c.name for c in run.cells}
    notes = [
        text
        for section in sections(run)
        for drawing in section.drawings
        for panel in drawing.panels
        for series in getattr(panel, "series", ())
        for text in series.notes
    ]
    assert len(notes) > 20
    for text in notes:
        program, verb, option, folder, name = shlex.split(text.splitlines()[-1])
        assert [program, verb, option, folder] == ["simval", "repro", "--run", "tiny"]
        assert name in names


def test_the_checks_name_noise_poses_and_what_else_varies(tiny_run):
    run = load_run(tiny_run)
    table = next(t for t in tables(run) if t.name == "verdicts")
    titles = [column.title for column in table.columns]
    cells = {c.name: c for c in run.cells}
    seen = set()
    for row in table.rows:
        said = dict(zip(titles, row, strict=True))
        if said["command"] is None:  # a study's cells together
            assert "all cells" in said["what else varies"]
            continue
        here = cells[shlex.split(said["command"])[-1]]
        seen.add(here.name)
        assert said["study"] == here.study.replace("_", " ")
        assert said["noise"] == here.parameters.get("noise_std")
        assert said["poses"] == here.parameters.get("poses")
    assert seen == set(cells)
