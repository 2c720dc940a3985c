"""`simval repro` on a run that several kinds of machine computed."""

import json

from stores import rewritten

from simval.sweep import load_run
from simval.sweep.identity import mixture

NAME = "attitude(geometry=3,noise_std=0.02,samples=65536)@1"
OTHER = "openblas 0.0 Nehalem"


def mixed(folder, *others):
    """A run of which machines with other linear algebra computed a cell each."""
    manifest = load_run(folder).manifest
    own = manifest["machine"]
    own = {"machine": own, "cells": 4 - len(others)}
    strangers = [
        {"machine": {**own["machine"], "linear_algebra": other}, "cells": 1}
        for other in others
    ]
    manifest = {**manifest, "environments": [own, *strangers]}
    with rewritten(folder) as database:
        query = "UPDATE meta SET value = ? WHERE key = 'manifest'"
        database.execute(query, (json.dumps(manifest),))
    return own["machine"]["linear_algebra"]


def test_repro_says_which_machines_computed_the_run(simval, tiny_run):
    code, out, _ = simval("repro", NAME, "--run", tiny_run)
    assert code == 0
    assert "of machine" not in out
    own = mixed(tiny_run, OTHER)
    code, out, _ = simval("repro", NAME, "--run", tiny_run)
    assert code == 0
    (line,) = [line for line in out.splitlines() if "of machine" in line]
    assert line == (
        "2 kinds of machine computed this run, so the last bits may differ: 3 of its "
        f"cells by the driver's; 1 by one that differs (linear_algebra: {own} -> "
        f"{OTHER})"
    )


def test_each_machine_is_counted(tiny_run):
    mixed(tiny_run, OTHER, "another")
    words = mixture(load_run(tiny_run).manifest)
    assert words.startswith("3 kinds of machine")
    assert words.count("; 1 by one that differs") == 2


def test_a_manifest_of_before_says_nothing(tiny_run):
    manifest = dict(load_run(tiny_run).manifest)
    assert mixture(manifest) == ""
    del manifest["environments"]
    assert mixture(manifest) == ""
