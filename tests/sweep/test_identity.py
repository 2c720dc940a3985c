"""Who computes a cell says what it is, and what differs is refused in words."""

import json
import pickle
import sys
from dataclasses import replace
from types import ModuleType, SimpleNamespace

import pytest
from test_executors import Fragile

from simval.errors import InputError
from simval.judge.baseline import environment, environment_changes
from simval.sweep import executors, identity, load_run, provenance, run_suite
from simval.sweep.identity import Stated, StrangerError, differing, here
from simval.sweep.provenance import PACKAGE, Loaded, loaded, source_hash
from simval.sweep.suite import expand

OTHERS = {
    "source code": {"code": {**here().code, "source code": "0" * 64}},
    "set of model files": {"code": {**here().code, "set of model files": "0" * 64}},
    "numpy is": {"code": {**here().code, "numpy": "0.1"}},
    "mine is 1, the driver's absent": {"code": {**here().code, "mine": "1"}},
    "processor kernels": {"machine": {**here().machine, "kernels": ["none"]}},
    "linear_algebra": {"machine": {**here().machine, "linear_algebra": "other"}},
    "filter": {"machine": {**here().machine, "filter": "other"}},
    "libc": {"machine": {**here().machine, "libc": "glibc 1.0"}},
}


@pytest.mark.parametrize("words", OTHERS)
def test_each_difference_is_refused_in_words(words):
    other = replace(here(), **OTHERS[words])
    lines = differing(here(), other)
    assert len(lines) == 1
    assert words in lines[0]
    kernels = "machine" in OTHERS[words]
    assert bool(differing(here(), other, mixed=True)) != kernels
    with pytest.raises(StrangerError, match="would give other numbers"):
        Stated(driver=other).require()


def test_the_same_process_is_no_stranger_and_a_refusal_travels():
    stated = pickle.loads(pickle.dumps(Stated(driver=here())))
    assert json.loads(stated.require()) == here().machine == provenance.machine()
    assert here().code["source code"] == source_hash() == loaded().source
    error = pickle.loads(pickle.dumps(StrangerError(("it differs",), "tcp://there")))
    assert (error.lines, error.worker) == (("it differs",), "tcp://there")
    assert "worker tcp://there would give other numbers" in str(error)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_local_process_that_differs_stops_the_sweep(tmp_path, monkeypatch, workers):
    suite = expand("one", {"attitude": {"samples": 65_536}})
    # as if the source had changed between the start of the driver and of its workers
    stated = Stated(driver=replace(here(), **OTHERS["source code"]))
    made = {True: None, False: stated}  # mixed kernels are not the default
    monkeypatch.setattr("simval.sweep.runner.Stated", lambda driver, mixed: made[mixed])
    if workers == 2:  # a pool in this process
        monkeypatch.setattr(executors, "_pool", lambda workers: Fragile())
    with pytest.raises(InputError, match=r"source code is \w{12}, the driver's 0{12}"):
        run_suite(suite, tmp_path / "run", workers=workers)
    monkeypatch.undo()
    run = run_suite(suite, tmp_path / "run", resume=True)
    assert {cell.status for cell in run.cells} == {"done"}


def test_a_file_that_changes_before_it_is_loaded_is_seen(tmp_path, monkeypatch):
    root = tmp_path / PACKAGE.name
    root.mkdir()
    for name in ("early", "late", "same"):
        (root / f"{name}.py").write_text("x = 1\n")
    monkeypatch.setattr(provenance, "PACKAGE", root)

    def load(name):
        module = ModuleType(f"simval.{name}")
        module.__file__ = str(root / f"{name}.py")
        monkeypatch.setitem(sys.modules, f"simval.{name}", module)

    load("early")
    own = Loaded()
    (root / "early.py").write_text("x = 2\n")  # too late to matter
    (root / "late.py").write_text("x = 2\n")
    assert own.changed() == []
    load("late")
    load("same")
    assert own.changed() == ["late.py"]
    assert own.changed() == []
    monkeypatch.setattr(
        provenance, "loaded", lambda: SimpleNamespace(changed=lambda: "x")
    )
    with pytest.raises(StrangerError, match="x changed on the disk"):
        identity.require_as_read()


def test_the_gate_knows_of_other_machines(tiny_run):
    manifest = load_run(tiny_run).manifest
    kept = environment(manifest)
    assert environment_changes(kept, manifest) == ()
    other = {**manifest["machine"], "linear_algebra": "openblas 0.3 Nehalem"}
    mixed = [*manifest["environments"], {"machine": other, "cells": 1}]
    (line,) = environment_changes(kept, {**manifest, "environments": mixed})
    assert line.startswith("other machines: None -> ")
    assert "Nehalem" in line
    own = {**manifest["machine"], "processor": "other"}
    changed = {**manifest, "machine": own, "environments": []}
    assert len(environment_changes(kept, changed)) == 1
