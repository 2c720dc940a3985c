"""A run folder with one damaged field: in words, never a traceback and never a pass."""

import shutil
from math import inf

import numpy as np
import pytest
from damage import damage
from every_study import SUITE
from places import EXAMPLES
from stores import raw, signed_anew

from simval.cli import run as simval_command
from simval.errors import InputError
from simval.judge import write_baseline
from simval.statistics import BIAS, COVARIANCE
from simval.sweep import load_run, run_suite

WIDE = (
    SUITE.replace('norm"', 'adjusted"')
    + """
[scene]
scene = "die"
poses = 12
[calibration]
noise_std = [0.0, 0.01]
poses = 12
hold_time = 0.02
trials = 1024
[solvers]
[attitude]
noise_std = [0.01, 0.02]
samples = 65536
[estimator]
algorithm = "align.py"
samples = 4096
[calibrator]
algorithm = "broken.py"
trials = 512
"""
)
BROKEN = """
from simval.plugins import Calibrator

def work(poses, g):
    raise RuntimeError("broken on purpose")

calibrator = Calibrator(name="broken", calibrate=work)
"""
QUICK, NIGHTLY = 25, 1000


def wide_run(folder, examples):
    """A run of every study, one of them with a plug-in and one that crashes."""
    folder.mkdir(exist_ok=True)
    (folder / "wide.toml").write_text(WIDE, encoding="utf-8")
    (folder / "broken.py").write_text(BROKEN, encoding="utf-8")
    shutil.copy(examples / "align.py", folder)
    run_suite(str(folder / "wide.toml"), folder / "run")
    return folder / "run"


class Campaign:
    """Damage copies of a run, and see what each command makes of it."""

    def __init__(self, run, folder, capsys):
        self.run, self.folder, self.capsys = run, folder, capsys
        self.baseline = folder / "baseline.json"
        loaded = load_run(run)
        if all(cell.status == "done" for cell in loaded.cells):
            write_baseline(self.baseline, loaded, "good")

    def codes(self, damaged):
        """Exit code of each command; a traceback would come through."""
        out, series = self.folder / "out", self.folder / "series"
        shutil.rmtree(series, ignore_errors=True)
        series.mkdir()
        for name, run in (("good", self.run), ("damaged", damaged)):
            (series / name).symlink_to(run, target_is_directory=True)
        commands = {
            "gate": ("gate", damaged, "--no-baseline", "--junit", f"{out}.xml"),
            "beside": ("gate", damaged, "--baseline", self.baseline),
            "compare": ("compare", self.run, damaged, "--out", f"{out}.html"),
            "trend": ("trend", series, "--csv", f"{out}.csv"),
            "report": ("report", damaged, "--out", f"{out}.html"),
            "export": ("export", damaged, "--out", f"{out}.parquet"),
        }
        if not self.baseline.exists():
            del commands["beside"]
        found = {}
        for name, words in commands.items():
            with np.errstate(all="ignore"):
                found[name] = simval_command([str(word) for word in words])
            printed = self.capsys.readouterr()
            assert found[name] in (0, 1, 2, 3, 4), (name, printed)
            if found[name] == 2:
                assert "error: " in printed.err, name
        return found

    def round(self, number, rng, *, old):
        """One damaged copy; what was done, or None where nothing came of it."""
        damaged = self.folder / f"damaged-{number}"
        shutil.copytree(self.run, damaged)
        before = content(damaged)
        done = damage(damaged, rng)
        if done is None or content(damaged) == before:
            shutil.rmtree(damaged)
            return None
        if old:
            signed_anew(damaged)
        codes = self.codes(damaged)
        if old:
            known = not done.impossible or codes["gate"] != 0
        else:
            known = set(codes.values()) == {2}
        assert known, (done, codes)
        shutil.rmtree(damaged)
        return done


def content(folder):
    with raw(folder) as database:
        tables = [
            database.execute(f"SELECT * FROM {name}").fetchall()
            for name in ("meta", "cells", "rows")
        ]
    files = [
        f for f in sorted(folder.rglob("*")) if f.is_file() and f.suffix != ".sqlite"
    ]
    return tables, [f.read_bytes() for f in files]


def attacked(run, folder, capsys, count, seed, *, old):
    campaign, rng = Campaign(run, folder, capsys), np.random.default_rng(seed)
    done = []
    for number in range(count):
        with pytest.MonkeyPatch.context() as patch:
            if number % 10:  # drawing takes most of a round: in one of ten
                patch.setattr("simval.report.environment.svg", lambda drawing: "<svg/>")
            done.append(campaign.round(number, rng, old=old))
    return [each for each in done if each is not None]


@pytest.mark.ci
@pytest.mark.parametrize("old", [False, True])
def test_one_damaged_field_is_no_traceback_and_no_pass(
    old, tiny_run, tmp_path, capsys, undrawn
):
    attacked(tiny_run, tmp_path, capsys, QUICK, [16, old], old=old)


@pytest.mark.slow
@pytest.mark.parametrize("old", [False, True])
def test_a_thousand_damaged_fields(old, tmp_path, capsys):
    run = wide_run(tmp_path, EXAMPLES)
    attacked(run, tmp_path, capsys, NIGHTLY, [17, old], old=old)


@pytest.mark.parametrize(
    ("sql", "words"),
    [
        (
            "UPDATE rows SET standard_error = -1 WHERE cell = 1 AND ordinal = 2",
            r"cell calibration\(.*\)@1: row 2, .*: `standard_error` is -1; it must be",
        ),
        (
            "UPDATE rows SET value = -value "
            "WHERE family = 'sd' AND controlled = 0 AND entries = json_array('K_x')",
            r"row \d+, sd\[K_x\]: `value` is -.*; such a statistic is 0 or more",
        ),
        (
            "UPDATE cells SET parameters = '{}' WHERE position = 3",
            "cell attitude.*: its parameters lack 'geometry=3,noise_std=0.02",
        ),
        (
            "UPDATE cells SET parameters = replace(parameters, '0.02', '0.03') "
            "WHERE position = 3",
            "cell attitude.*its parameter `noise_std` is 0.03; its name differs",
        ),
        (
            "UPDATE rows SET value = value * 1.01 WHERE cell = 2 AND ordinal = 5",
            "cell attitude.*: its entry or its rows are not what the sweep stored",
        ),
        (
            "DELETE FROM rows WHERE cell = 2 AND ordinal = 5",
            "without a gap: 5 is missing",
        ),
        (
            "UPDATE meta SET value = replace(value, 'tiny', 'tony')",
            "the manifest is not what the sweep stored",
        ),
    ],
)
def test_damage_is_named_by_cell_and_field(sql, words, tiny_run):
    with raw(tiny_run) as database:
        database.execute(sql)
    with pytest.raises(InputError, match=f"run.sqlite is damaged: .*{words}"):
        load_run(tiny_run)


def test_files_beside_the_store_are_what_the_sweep_wrote(simval, tiny_run):
    table = tiny_run / "results.csv"
    good = table.read_text()
    table.write_text(good.replace("0.01", "0.02"))
    for command in ("gate", "report", "export"):
        code, _, err = simval(command, tiny_run)
        assert code == 2
        assert f"{table} is not what the sweep wrote" in err
    table.unlink()  # what is missing is no damage: a store alone can be judged
    assert simval("gate", tiny_run, "--no-baseline")[0] == 0


def test_a_store_of_another_schema_is_refused(simval, tiny_run):
    with raw(tiny_run) as database:
        database.execute("UPDATE meta SET value = '1' WHERE key = 'schema'")
    code, _, err = simval("gate", tiny_run, "--no-baseline")
    assert code == 2
    assert "has schema 1; this program reads 2; use the version" in err


def test_damage_is_not_taken_over_when_a_run_goes_on(tiny_suite, tiny_run):
    with raw(tiny_run) as database:
        database.execute("UPDATE rows SET value = 1.5 WHERE cell = 1 AND ordinal = 1")
    with pytest.raises(InputError, match="is damaged: cell calibration"):
        run_suite(str(tiny_suite), tiny_run, resume=True)


def test_every_statistic_has_its_range(tiny_run):
    """One that is neither a share nor a size has a sign: bias, covariance, rate."""
    signed = {BIAS, COVARIANCE}
    for cell in load_run(tiny_run).cells:
        for row in cell.rows:
            family = row.statistic.family
            assert (family in signed) == ((family.least, family.most) == (-inf, inf))
