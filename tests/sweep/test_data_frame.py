"""A run as a data frame: what results.csv holds, to the bit, a line for each row."""

import csv
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simval.errors import InputError
from simval.results import COLUMNS, plain
from simval.statistics import BIAS
from simval.studies.study import canonical
from simval.sweep import load_run
from simval.sweep.cells import CellResult
from simval.sweep.run import data_frame

VALUES = st.one_of(
    st.integers(-(2**62), 2**62),
    st.floats(allow_nan=False),
    st.booleans(),
    st.text('abc,\n"é', max_size=5),
)
PARAMETERS = st.dictionaries(st.sampled_from(["poses", "noise_std", "frame"]), VALUES)


def cell(number, parameters, status="done"):
    rows = plain(
        [BIAS(axis) for axis in "xyz"],
        [1.0 / 3.0, -0.0, 1e-300],
        1e-3,
        1000,
        0.25,
        "order 2",
    )
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


def test_it_holds_what_the_csv_holds(tiny_run):
    pytest.importorskip("pandas")
    frame = load_run(tiny_run).to_pandas()
    with (tiny_run / "results.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(frame.columns) == list(rows[0])
    assert len(frame) == len(rows) > 100
    found = {
        (line["cell"], line["statistic"], line["predictor"]): line
        for line in frame.to_dict("records")
    }
    assert len(found) == len(rows)
    for row in rows:
        line = found[row["cell"], row["statistic"], row["predictor"]]
        for name, text in row.items():
            if text == "":
                assert line[name] in ("", None) or line[name] != line[name]
            elif isinstance(line[name], float):
                assert repr(line[name]) == repr(float(text))
            else:
                assert str(line[name]) == text
    attitude = frame[(frame.study == "attitude") & (frame.statistic == "bias[x]")]
    assert set(attitude.noise_std) == {0.01, 0.02}
    assert frame.value.dtype == frame.noise_std.dtype == float
    assert frame.seed.dtype == frame.n.dtype == "int64"


@pytest.mark.ci
@given(st.lists(PARAMETERS, max_size=4))
def test_any_parameters_become_columns(several):
    pd = pytest.importorskip("pandas")
    cells = [cell(number, parameters) for number, parameters in enumerate(several)]
    frame = data_frame([*cells, cell(9, {"ignored": 1}, "pending")])
    keys = sorted({key for parameters in several for key in parameters})
    assert list(frame.columns) == ["cell", "study", "seed", *keys, *COLUMNS]
    assert len(frame) == 3 * len(cells)
    lines = frame.to_dict("records")
    for number, parameters in enumerate(several):
        for line in lines[3 * number : 3 * number + 3]:
            assert line["seed"] == number
            for key in keys:
                value = parameters.get(key)
                if value is None:
                    assert line[key] is None or pd.isna(line[key])
                else:  # as text where studies differ in type
                    assert line[key] in (value, canonical(value), float_of(value))
    assert [line["value"] for line in lines] == [1.0 / 3.0, -0.0, 1e-300] * len(cells)


def float_of(value):
    """An integer in a column that has a float too."""
    return float(value) if isinstance(value, int) else value


def test_a_run_without_a_finished_cell_has_no_line():
    pytest.importorskip("pandas")
    frame = data_frame([cell(0, {"poses": 9}, "pending"), cell(1, {}, "failed")])
    assert len(frame) == 0
    assert list(frame.columns) == ["cell", "study", "seed", *COLUMNS]


def test_without_pandas_it_says_what_to_install(tiny_run, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"`pandas`: .*pip install .*pandas>="):
        load_run(tiny_run).to_pandas()
