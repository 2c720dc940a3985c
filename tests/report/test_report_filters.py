"""The section of attitude filters on the page, and the picture that turns."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simval.geometry import attitude_matrix, random_quaternions
from simval.report.page import render, sections
from simval.report.pictures import LENGTH, SIZE, turning
from simval.sweep import load_run, run_suite
from simval.sweep.suite import expand

SCENARIOS = ["gimbal slow", "magnetic disturbance"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Two cells of few trials."""
    content = {"scenario": SCENARIOS, "rate": 25.0, "seconds": 4.0, "trials": 8}
    folder = tmp_path_factory.mktemp("filters") / "run"
    run_suite(expand("filters", {"seed": 1, "filter": content}), folder)
    return load_run(folder)


@pytest.mark.ci
def test_the_section_draws_errors_squares_budget_and_a_trial(run):
    section = next(s for s in sections(run) if s.anchor == "filters")
    drawn = {drawing.name: drawing.panels for drawing in section.drawings}
    for panels in drawn.values():
        assert [panel.title for panel in panels] == SCENARIOS
    seen, bound = drawn["filter-errors"][0].series
    assert (np.diff(seen.x) > 0.0).all()
    theory, over = drawn["filter-ratio"][0].series
    # nothing is wrong: what theory says of the filter is the bound
    assert np.allclose(theory.y, 1.0, rtol=1e-9)
    assert np.allclose(over.y, seen.y / bound.y, rtol=1e-9)
    parts = [series.y for series in drawn["filter-budget"][0].series]
    assert np.allclose(np.sqrt(np.sum(np.square(parts), axis=0)), bound.y, rtol=1e-9)
    (table,) = section.tables
    assert [row[1] for row in table.rows] == SCENARIOS
    disturbed = [words for words, _ in section.values["turning"]]
    assert disturbed[0] == "simval:mekf, magnetic disturbance", "the worst first"


@pytest.mark.ci
def test_the_page_holds_it_and_no_other_section_draws_it_again(run):
    page = render(run)
    assert page.count("<animate ") == 2 * 6 * 2, "two pictures, six axes, x and y"
    assert "One trial, turning" in page
    assert 'id="figure-filter-errors"' in page
    assert 'id="figure-nees"' not in page


def test_a_damaged_picture_is_said(run, tmp_path):
    file = next((run.folder / "artifacts").glob("filter-*.npz"))
    kept = file.read_bytes()
    try:
        np.savez(file, time=np.arange(3.0), truth=np.zeros((2, 4)))
        with pytest.raises(Exception, match="truth"):
            render(run)
    finally:
        file.write_bytes(kept)


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
