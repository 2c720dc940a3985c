"""Runs: same bits for any number of workers, resume after a kill, honest failures."""

import json
import math
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from stores import digest, edited

from simval.errors import InputError
from simval.results import Outcome, Row
from simval.statistics import COVERAGE, RMS, Family
from simval.sweep import (
    executors,
    load_run,
    load_suite,
    provenance,
    run_suite,
)
from simval.sweep.identity import other_machines
from simval.sweep.runner import locked
from simval.sweep.threads import linear_algebra


@pytest.mark.ci
def test_neither_workers_nor_neighbours_change_a_cell(tiny_suite, tiny_run, tmp_path):
    run_suite(str(tiny_suite), tmp_path / "two", workers=2)
    assert digest(tmp_path / "two") == digest(tiny_run)
    name = "attitude(geometry=3,noise_std=0.02,samples=65536)@"
    found = {}
    for seed in (1, 2):
        words = ["attitude.noise_std=0.005,0.02", "calibration.poses=10"]
        suite = load_suite(str(tiny_suite), words, seed)
        run = run_suite(suite, tmp_path / str(seed))
        (found[seed],) = (c.rows for c in run.cells if c.name == f"{name}{seed}")
    (old,) = (c.rows for c in load_run(tiny_run).cells if c.name == f"{name}1")
    assert old == found[1] != found[2]


def test_the_manifest_says_what_the_numbers_depend_on(tiny_run):
    manifest = json.loads((tiny_run / "manifest.json").read_text())
    assert manifest == load_run(tiny_run).manifest
    assert manifest["suite"] == "tiny"
    assert manifest["grid"]["seed"] == [1]
    assert set(manifest["versions"]) >= {"simval", "numpy", "scipy", "mujoco-core"}
    assert set(manifest["git"]) == {"commit", "dirty"}
    assert len(manifest["models"]["gimbal.xml"]) == 64
    own = manifest["machine"]
    assert (own["threads"], own["linear_algebra"]) == (1, linear_algebra())
    assert manifest["environments"] == [{"machine": own, "cells": 4}]
    assert other_machines(manifest) == []
    timing = json.loads((tiny_run / "timing.json").read_text())
    assert timing["cells"].keys() == {c.name for c in load_run(tiny_run).cells}
    assert timing["workers"] == 1


@pytest.mark.parametrize("workers", [0, 1.5, "2", True])
@pytest.mark.usefixtures("unchecked")
def test_workers_must_be_a_number_of_processes(tiny_suite, tmp_path, workers):
    with pytest.raises(InputError, match="whole number"):
        run_suite(tiny_suite, tmp_path / "run", workers=workers)


def test_a_folder_that_cannot_be_swept_into_is_refused(
    tiny_suite, tiny_run, monkeypatch
):
    """It exists, is of another suite or source, is at work, or cannot be made."""
    suite = str(tiny_suite)
    other = load_suite(suite, ["attitude.samples=70000"])
    with pytest.raises(InputError, match="exists; choose another folder, or --resume"):
        run_suite(suite, tiny_run)
    with pytest.raises(InputError, match="cannot make"):
        run_suite(suite, tiny_run / "results.csv" / "run")
    with pytest.raises(InputError, match=r"attitude.samples: 65536 -> 70000"):
        run_suite(other, tiny_run, resume=True)
    with locked(tiny_run), pytest.raises(InputError, match="another sweep is running"):
        run_suite(suite, tiny_run, resume=True)
    monkeypatch.setattr(provenance, "loaded", lambda: SimpleNamespace(source="another"))
    with pytest.raises(InputError, match=r"source: .* -> another"):
        run_suite(suite, tiny_run, resume=True)


def test_resume_computes_only_what_is_missing(tiny_suite, tiny_run, monkeypatch):
    before = digest(tiny_run)
    edited(
        tiny_run,
        "DELETE FROM rows WHERE cell = 2",
        "UPDATE cells SET status = 'pending' WHERE position = 2",
    )
    (tiny_run / "results.csv").unlink()
    computed = []
    execute = executors.execute

    def counted(cell):
        computed.append(cell.name)
        return execute(cell)

    monkeypatch.setattr(executors, "execute", counted)
    run_suite(str(tiny_suite), tiny_run, resume=True)
    assert len(computed) == 1
    assert digest(tiny_run) == before


def test_a_failed_cell_leaves_the_others_and_its_traceback(
    tiny_suite, tmp_path, monkeypatch
):
    execute = executors.execute

    def fragile(cell):
        if cell.study == "calibration" and cell.parameters.noise_std > 0.0:
            msg = "broken on purpose"
            raise ZeroDivisionError(msg)
        return execute(cell)

    monkeypatch.setattr(executors, "execute", fragile)
    run = run_suite(str(tiny_suite), tmp_path / "run")
    status = [cell.status for cell in run.cells]
    assert status.count("failed") == 1
    assert status.count("done") == 3
    failed = next(cell for cell in run.cells if cell.status == "failed")
    assert "ZeroDivisionError: broken on purpose" in failed.error
    assert failed.name not in (tmp_path / "run" / "results.csv").read_text()


ROW = Row(statistic=RMS("x"), value=0.5, standard_error=0.1, n=300, check="plain")
POSSIBLE = (
    {"value": math.inf, "standard_error": math.nan, "n": 2**53 - 1, "remainder": 0.0},
    {"value": np.float64(0.5), "n": np.int64(0), "remainder": math.inf},
)
IMPOSSIBLE = (
    {"remainder": -0.0042},
    {"standard_error": -5e-324},
    {"standard_error": -math.inf},
    {"value": -1e-9},
    {"prediction": -0.1},
    {"prediction": 1.5, "statistic": COVERAGE("x")},
    {"statistic": Family("no such family", "of no version")("x")},
    {"n": -1},
    {"n": 2**53},
)


def test_an_impossible_number_fails_its_cell_and_not_the_run(
    tmp_path, monkeypatch, simval
):
    given = (*POSSIBLE, *IMPOSSIBLE)
    suite = tmp_path / "suite.toml"
    suite.write_text(f"seed = {[*range(len(given))]}\n[attitude]\nsamples = 65536\n")

    def left(cell):
        return Outcome(rows=(ROW, replace(ROW, **given[cell.seed])))

    monkeypatch.setattr(executors, "execute", left)
    folder = tmp_path / "run"
    assert simval("sweep", suite, "--out", folder, "--workers", 1)[0] == 4
    cells = load_run(folder).cells
    ends = {cell.seed: (cell.status, len(cell.rows)) for cell in cells}
    done = len(POSSIBLE)
    assert ends == {
        seed: ("done", 2) if seed < done else ("failed", 0)
        for seed in range(len(given))
    }
    for cell in cells[done:]:  # the error names what is impossible
        named = re.search(
            r"^a result that cannot be: row 1, .*: `(\w+)` is", cell.error
        )
        assert named, cell.error
        assert {*given[cell.seed], "family"} >= {named[1]}
    for command in ("gate", "report"):
        assert "damaged" not in "".join(simval(command, folder)[1:])
