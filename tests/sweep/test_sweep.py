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
from simval.sweep.runner import locked


@pytest.mark.ci
def test_workers_and_order_do_not_change_the_table(tiny_suite, tiny_run, tmp_path):
    run_suite(str(tiny_suite), tmp_path / "two", workers=2)
    assert digest(tmp_path / "two") == digest(tiny_run)
    other = load_suite(str(tiny_suite), seed=2)
    run_suite(other, tmp_path / "other")
    assert digest(tmp_path / "other") != digest(tiny_run)


@pytest.mark.ci
def test_a_cell_does_not_depend_on_its_neighbours(tiny_suite, tiny_run, tmp_path):
    suite = load_suite(str(tiny_suite), ["attitude.noise_std=0.005,0.02"])
    run = run_suite(suite, tmp_path / "changed")
    name = "attitude(geometry=3,noise_std=0.02,samples=65536)@1"
    old = next(c for c in load_run(tiny_run).cells if c.name == name)
    new = next(c for c in run.cells if c.name == name)
    assert old.rows == new.rows


def test_the_manifest_says_what_the_numbers_depend_on(tiny_run):
    manifest = json.loads((tiny_run / "manifest.json").read_text())
    assert manifest["suite"] == "tiny"
    assert manifest["grid"]["seed"] == [1]
    assert set(manifest["versions"]) >= {"simval", "numpy", "scipy", "mujoco-core"}
    assert set(manifest["git"]) == {"commit", "dirty"}
    assert len(manifest["models"]["gimbal.xml"]) == 64
    timing = json.loads((tiny_run / "timing.json").read_text())
    assert timing["cells"].keys() == {c.name for c in load_run(tiny_run).cells}


def test_a_folder_that_exists_or_cannot_be_made_is_refused(tiny_suite, tiny_run):
    with pytest.raises(InputError, match="exists; choose another folder, or --resume"):
        run_suite(str(tiny_suite), tiny_run)
    with pytest.raises(InputError, match="cannot make"):
        run_suite(str(tiny_suite), tiny_run / "results.csv" / "run")


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


def test_resume_of_another_suite_is_refused_with_the_difference(tiny_suite, tiny_run):
    suite = load_suite(str(tiny_suite), ["attitude.samples=70000"])
    with pytest.raises(InputError, match=r"attitude.samples: 65536 -> 70000"):
        run_suite(suite, tiny_run, resume=True)


def test_resume_after_a_change_of_the_source_is_refused(
    tiny_suite, tiny_run, monkeypatch
):
    other = SimpleNamespace(source="another")
    monkeypatch.setattr(provenance, "loaded", lambda: other)
    with pytest.raises(InputError, match=r"source: .* -> another"):
        run_suite(str(tiny_suite), tiny_run, resume=True)


def test_one_driver_for_a_folder(tiny_suite, tiny_run):
    with (
        locked(tiny_run),
        pytest.raises(InputError, match="another sweep is at work"),
    ):
        run_suite(str(tiny_suite), tiny_run, resume=True)


@pytest.mark.parametrize("workers", [0, 1.5, "2", True])
@pytest.mark.usefixtures("unchecked")
def test_workers_must_be_a_number_of_processes(tiny_suite, tmp_path, workers):
    with pytest.raises(InputError, match="whole number"):
        run_suite(tiny_suite, tmp_path / "run", workers=workers)


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
