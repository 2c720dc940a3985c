"""A run that is done: as a data frame, as Parquet, and one cell of it once more."""

import csv
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from stores import edited, rewritten

from simval.errors import InputError
from simval.judge import judge_run
from simval.results import COLUMNS, plain
from simval.statistics import BIAS
from simval.studies.study import canonical
from simval.sweep import load_run
from simval.sweep.cells import CellResult
from simval.sweep.repro import find_cell
from simval.sweep.run import data_frame
from simval.sweep.suite import load_suite

NAME = "attitude(geometry=3,noise_std=0.02,samples=65536)@1"


@pytest.mark.ci
@pytest.mark.parametrize("form", ["pandas", "parquet"])
def test_a_table_holds_what_the_csv_holds(form, simval, tiny_run, tmp_path):
    if form == "pandas":
        pytest.importorskip("pandas")
        frame = load_run(tiny_run).to_pandas()
        assert frame.value.dtype == frame.noise_std.dtype == float
        assert frame.seed.dtype == frame.n.dtype == "int64"
        lines = frame.to_dict("records")
    else:
        parquet = pytest.importorskip("pyarrow.parquet")
        path = tmp_path / "out.parquet"
        code, out, _ = simval("export", tiny_run, "--out", path)
        assert (code, out.splitlines()[-1]) == (0, str(path))
        assert simval("export", tmp_path)[0] == 2
        assert (
            simval("export", tiny_run, "--out", tmp_path / "no" / "x.parquet")[0] == 2
        )
        lines = parquet.read_table(path).to_pylist()
    with (tiny_run / "results.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))

    def key(line):
        return line["cell"], line["statistic"], line["predictor"]

    judged = {
        (v.cell.name, str(v.row.statistic), v.row.predictor): repr(v.power)
        for v in judge_run(load_run(tiny_run)).verdicts
    }
    assert {row["power"] for row in rows if row["check"] == "record"} == {""}
    assert all(row["power"] == judged.get(key(row), "") for row in rows)
    found = {key(line): line for line in lines}
    assert len(found) == len(lines) == len(rows) > 100
    for row in rows:
        line = found[key(row)]
        assert line.keys() == row.keys()
        for name, text in row.items():
            if text == "":
                assert line[name] in ("", None) or line[name] != line[name]
            elif isinstance(line[name], float):
                assert repr(line[name]) == repr(float(text))
            else:
                assert str(line[name]) == text


VALUES = st.one_of(
    st.integers(-(2**62), 2**62),
    st.floats(allow_nan=False),
    st.booleans(),
    st.text('abc,\n"é', max_size=5),
)
PARAMETERS = st.dictionaries(st.sampled_from(["poses", "noise_std", "frame"]), VALUES)
NUMBERS = [1.0 / 3.0, -0.0, 1e-300]


def cell(number, parameters, status="done"):
    rows = plain([BIAS(axis) for axis in "xyz"], NUMBERS, 1e-3, 1000, 0.25, "order 2")
    return CellResult(
        position=number,
        name=f"study({number})@{number}",
        study="study",
        seed=number,
        parameters=parameters,
        status=status,
        error="",
        seconds=0.0,
        rows=rows if status == "done" else (),
    )


@pytest.mark.ci
@given(st.lists(PARAMETERS, max_size=4))
def test_any_parameters_become_columns(several):
    pd = pytest.importorskip("pandas")
    cells = [cell(number, parameters) for number, parameters in enumerate(several)]
    # of a cell that is not finished there is nothing
    frame = data_frame([*cells, cell(9, {"ignored": 1}, "pending")])
    keys = sorted({key for parameters in several for key in parameters})
    assert list(frame.columns) == ["cell", "study", "seed", *keys, *COLUMNS, "power"]
    lines = frame.to_dict("records")
    for number, parameters in enumerate(several):
        for line in lines[3 * number : 3 * number + 3]:
            assert line["seed"] == number
            for key in keys:
                value = parameters.get(key)
                if value is None:
                    assert line[key] is None or pd.isna(line[key])
                else:  # as text where studies differ in type, an integer among floats
                    own = float(value) if isinstance(value, int) else value
                    assert line[key] in (value, canonical(value), own)
    assert [line["value"] for line in lines] == NUMBERS * len(cells)


# one cell once more


@pytest.mark.ci
def test_a_cell_is_found_by_its_name(tiny_run):
    run, cells = load_run(tiny_run), load_suite("smoke").cells
    for cell in run.cells:
        assert find_cell(cell.name, run).name == cell.name
    for cell in {each.study: each for each in cells}.values():
        assert find_cell(cell.name, run) == find_cell(cell.name, None) == cell


NONE = "there is no cell `"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("what", r"in suite smoke or the run .*--suite$"),
        (NAME.replace("samples", "sample"), r"the nearest are attitude\(geometry=3"),
        *((name, NONE) for name in ("attitude", "attitude(noise_std=0.1)")),
        *((f"attitude({inside})@1", NONE)
          for inside in ("noise_std", "noise=0.1", "noise_std=-1")),
        ("astrology()@1", NONE),
    ],
)  # fmt: skip
def test_a_name_that_is_none_is_refused(name, words, tiny_run):
    with pytest.raises(InputError, match=words):
        find_cell(name, load_run(tiny_run), (), "smoke" if name == "what" else None)
    with pytest.raises(InputError, match=NONE):
        find_cell(name, None)


@pytest.mark.ci
def test_repro_says_whether_the_bits_are_equal(simval, tiny_run):
    code, out, _ = simval("repro", NAME, "--run", tiny_run)
    assert code == 0
    assert "equal to the bit" in out
    assert "of machine" not in out
    edited(
        tiny_run,
        "UPDATE rows SET value = value * (1 + 1e-15) "
        "WHERE family = 'bias' AND controlled = 0 AND entries = json_array('x')",
    )
    for more in ((), ("--suite", "smoke")):  # the run comes first
        code, out, _ = simval("repro", NAME, "--run", tiny_run, *more)
        assert code == 1
        assert "different: bias[x]" in out
    edited(tiny_run, f"UPDATE cells SET status = 'failed' WHERE cell = '{NAME}'")
    cells = load_suite("smoke").cells
    other = next(c.name for c in cells if c.study == "attitude_order")
    for name in (NAME, other):
        code, out, _ = simval("repro", name, "--run", tiny_run)
        assert code == 3
        assert "has no such cell" in out


def test_repro_says_which_machines_computed_the_run(simval, tiny_run):
    manifest = load_run(tiny_run).manifest
    own, others = manifest["machine"], ("another", "openblas 0.0 Nehalem")
    machines = [{"machine": own, "cells": 2}]
    for other in others:
        machines.append({"machine": {**own, "linear_algebra": other}, "cells": 1})
    with rewritten(tiny_run) as database:
        query = "UPDATE meta SET value = ? WHERE key = 'manifest'"
        text = json.dumps({**manifest, "environments": machines})
        database.execute(query, (text,))
    code, out, _ = simval("repro", NAME, "--run", tiny_run)
    assert code == 0
    (line,) = [line for line in out.splitlines() if "of machine" in line]
    parts = (
        f"1 by one that differs (linear_algebra: {own['linear_algebra']} -> {other})"
        for other in others
    )
    assert line == (
        "3 kinds of machine computed this run, so the last bits may differ: 2 of its "
        f"cells by the driver's; {'; '.join(parts)}"
    )
