"""The section of attitude filters on the page, and the picture that turns."""

import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simval.errors import InputError
from simval.geometry import attitude_matrix, random_quaternions
from simval.report.page import render, sections
from simval.report.pictures import LENGTH, SIZE, turning
from simval.studies.filter import artifact_of
from simval.sweep import load_run

SCENARIOS = ["gimbal slow", "gimbal slow, scale 1e-3"]


@pytest.fixture
def run(smoke_run, tmp_path):
    """The filters of the smoke run, with pictures of one's own."""
    shutil.copytree(smoke_run / "artifacts", tmp_path / "artifacts")
    whole = load_run(smoke_run)
    return replace(whole, folder=tmp_path, cells=tuple(whole.of("filter")))


@pytest.mark.ci
def test_the_section_draws_errors_squares_budget_and_a_trial(run):
    file = run.folder / "artifacts" / artifact_of(run.cells[1].parameters)
    with np.load(file) as content:  # a trial that is far off
        far = dict(content) | {"estimate": np.roll(content["truth"], 1, axis=1)}
    np.savez(file, **far)
    section = next(s for s in sections(run) if s.anchor == "filters")
    drawn = {drawing.name: drawing.panels for drawing in section.drawings}
    for panels in drawn.values():
        assert [panel.title for panel in panels] == SCENARIOS
    seen, bound = drawn["filter-errors"][0].series
    assert (np.diff(seen.x) > 0.0).all()
    theory, over = drawn["filter-ratio"][0].series
    # nothing is wrong: what theory says of the filter is the bound, and what averages
    # leave out of the turns, at most a thousandth of the error, squared
    assert ((theory.y > 1.0 - 1e-9) & (theory.y < 1.0 + 1e-6)).all()
    assert np.allclose(over.y, seen.y / bound.y, rtol=1e-9)
    parts = [series.y for series in drawn["filter-budget"][0].series]
    assert np.allclose(np.sqrt(np.sum(np.square(parts), axis=0)), bound.y, rtol=1e-9)
    (table,) = section.tables
    assert [row[1] for row in table.rows] == SCENARIOS
    told = [words for words, _ in section.values["turning"]]
    assert told[0] == f"simval:mekf, {SCENARIOS[1]}", "the worst first"
    page = render(run)
    assert page.count("<animate ") == 2 * 6 * 2, "two pictures, six axes, x and y"
    assert "One trial, turning" in page
    assert 'id="figure-filter-errors"' in page
    assert 'id="figure-nees"' not in page, "no other section draws it again"


@pytest.mark.ci
def test_a_damaged_picture_is_said(run):
    file = next((run.folder / "artifacts").glob("filter-*.npz"))
    np.savez(file, time=np.arange(3.0), truth=np.zeros((2, 4)))
    with pytest.raises(InputError, match="truth"):
        render(run)


def test_axes_end_where_the_attitude_puts_them():
    rng = np.random.default_rng(1)
    truth = random_quaternions(5, rng)
    picture = str(turning("a <b> & c", np.arange(5.0), truth, truth))
    assert "a &lt;b&gt; &amp; c" in picture
    values = re.findall(r'values="([^"]*)"', picture)
    assert len(values) == 12
    ends = np.array([[float(v) for v in each.split(";")] for each in values])
    x, y = ends[::2][:3].T, ends[1::2][:3].T  # (instants, axes)
    # seen from azimuth 35 and elevation 25 degrees, by another route: the camera's
    # axes are the world's after two turns
    camera = Rotation.from_euler("ZY", [35.0, -25.0], degrees=True)
    world = attitude_matrix(truth)  # rows: the body's axes in the world
    seen = np.stack([camera.inv().apply(axes) for axes in world])
    assert np.abs(x - (SIZE / 2.0 + LENGTH * seen[..., 1])).max() < 0.06
    assert np.abs(y - (SIZE / 2.0 - LENGTH * seen[..., 2])).max() < 0.06
    # it ends where it began to be counted, and lasts as long as the run
    assert 'keyTimes="0;0.25;0.5;0.75;1"' in picture
    assert 'dur="4s"' in picture
