"""Values on demand: what the page says of a point, and where its disc lies."""

import shlex
from dataclasses import replace

import numpy as np
import pytest
import rows_by_name
from rows_by_name import cell

from simval.report import tables
from simval.report.curves import Measured, curve, note
from simval.report.page import sections
from simval.report.section import folder_of, located
from simval.statistics import RMS
from simval.sweep import load_run
from simval.units import MILLIRADIAN


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
    c = curve("", [here], "noise_std", lambda c: c.row(row.statistic))
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
    c = curve("", cells, "noise_std", lambda c: c.row(RMS("T")))
    assert np.all(np.diff(c.x) > 0.0)
    order = np.argsort(noise)
    assert [n.splitlines()[0].split("n = ")[1] for n in c.notes] == [
        str(k + 1) for k in order
    ]


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
