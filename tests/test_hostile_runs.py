"""A run folder of an enemy: refused in words or judged right, never more than that.

Never a traceback, a hang, a link followed, memory without a bound, or a pass of what is
not whole. `hostile.py` has the attacks; two thousand of them run by night.
"""

import resource
import shutil
import sqlite3

import numpy as np
import pytest
from hostile import attack, resealed
from test_safety import watched

from simval.cli import run as simval_command
from simval.sweep import load_run, run_suite

SMALL = """
title = "Small"
seed = 7

[attitude]
noise_std = [0.01, 0.02]
samples = 65536
"""
PICTURE = (
    b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR\x00\x00\x00\x01\x00\x00\x00\x01"
    + b"\x08\x00\x00\x00\x00:~\x9bU\x00\x00\x00\nIDATx\x9cc`\x00\x00\x00\x02\x00\x01"
    + b"H\xaf\xa4q\x00\x00\x00\x00IEND\xaeB`\x82"
)
CHUNKS, EACH, NIGHT = 25, 8, 2500
MOST = 300 * 2**20
"""Bytes by which the process may grow: what a report loads takes 100 MB."""


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A small run, with artifacts of three kinds."""
    place = tmp_path_factory.mktemp("hostile")
    (place / "small.toml").write_text(SMALL)
    run_suite(str(place / "small.toml"), place / "run")
    artifacts = place / "run" / "artifacts"
    artifacts.mkdir(exist_ok=True)
    time = np.arange(40) / 10.0
    np.savez(artifacts / "scene-die-12.npz", directions=np.eye(3))
    (artifacts / "scene-die-12.png").write_bytes(PICTURE)
    np.savez(artifacts / "convergence-x.npz", lm=10.0 ** -np.arange(5.0))
    np.savez(
        artifacts / "static-gimbal-0.npz",
        time=time,
        signal=np.ones((40, 3)),
        intervals=[[0.5, 1.0]],
    )
    resealed(place / "run")
    return place / "run"


class Judge:
    """What each command makes of a folder, beside what it makes of a good one."""

    def __init__(self, run, place, capsys):
        self.good, self.place, self.capsys = run, place, capsys
        self.cells = [(cell.name, len(cell.rows)) for cell in load_run(run).cells]

    def commands(self, folder):
        series = self.place / "series"
        shutil.rmtree(series, ignore_errors=True)
        series.mkdir()
        for name, run in (("good", self.good), ("bad", folder)):
            (series / name).symlink_to(run, target_is_directory=True)
        out = self.place / "out"
        return (
            ("gate", folder, "--no-baseline", "--junit", f"{out}.xml"),
            ("compare", self.good, folder),
            ("export", folder, "--out", f"{out}.parquet"),
            ("trend", series),
            ("report", folder, "--out", f"{out}.html"),
        )

    def code(self, words):
        self.capsys.readouterr()
        with watched(), np.errstate(all="ignore"):
            code = simval_command([str(word) for word in words])
        printed = self.capsys.readouterr()
        assert code in (0, 1, 2, 3, 4), (words, printed)
        assert (code != 2) or printed.err.startswith("error: "), (words, printed)
        assert "\x1b" not in printed.out + printed.err, words
        return code

    def check(self, number, rng, every):
        """One attack; every command, or the gate alone."""
        folder = self.place / f"bad-{number}"
        shutil.copytree(self.good, folder)
        done = attack(folder, rng)
        try:
            if done.signed:
                resealed(folder)
        except (OSError, ValueError, sqlite3.Error):
            pass  # there is nothing left that could be signed
        commands = self.commands(folder)
        codes = {w[0]: self.code(w) for w in (commands if every else commands[:1])}
        if codes["gate"] == 0:
            assert not done.lost, (done, codes)
            now = [(cell.name, len(cell.rows)) for cell in load_run(folder).cells]
            assert now == self.cells, (done, codes)
        if (self.place / "out.html").exists():
            page = (self.place / "out.html").read_text(encoding="utf-8")
            assert "<script>alert" not in page, done
            assert "cm9vdDp4OjA6" not in page, done  # root:x:0: in base64
            assert "onload=" not in page, done
        shutil.rmtree(folder)
        return done, codes


def attacked(run, place, capsys, count, seed, share):
    rng, judge = np.random.default_rng(seed), Judge(run, place, capsys)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("simval.report.environment.svg", lambda drawing: "<svg/>")
        found = [judge.check(n, rng, n % share == 0) for n in range(count)]
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown * 1024 < MOST
    return found


@pytest.mark.parametrize("seed", range(CHUNKS))
def test_two_hundred_attacks_are_refused_or_judged(seed, small, tmp_path, capsys):
    attacked(small, tmp_path, capsys, EACH, [111, seed], EACH)


@pytest.mark.slow
def test_thousands_of_attacks_are_refused_or_judged(small, tmp_path, capsys):
    found = attacked(small, tmp_path, capsys, NIGHT, 111, 2)
    refused = sum(codes["gate"] == 2 for _, codes in found)
    assert 0.5 * NIGHT < refused < NIGHT  # some are no damage, or change no verdict
