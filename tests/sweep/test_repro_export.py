"""One cell again by its name; the table as Parquet."""

import csv

import pytest
from stores import edited

from simval.errors import InputError
from simval.sweep import load_run
from simval.sweep.repro import find_cell
from simval.sweep.suite import load_suite


@pytest.mark.ci
def test_a_cell_is_found_by_its_name(tiny_run):
    run = load_run(tiny_run)
    for cell in run.cells:
        assert find_cell(cell.name, run).name == cell.name
    for cell in load_suite("smoke").cells:
        assert find_cell(cell.name, None) == find_cell(cell.name, None, (), "smoke")
        assert find_cell(cell.name, run).name == cell.name


@pytest.mark.parametrize(
    "name",
    [
        "attitude",
        "attitude(noise_std=0.1)",
        "astrology()@1",
        "attitude(noise_std)@1",
        "attitude(noise=0.1)@1",
        "attitude(noise_std=-1)@1",
    ],
)
def test_a_name_that_is_none_is_refused(name, tiny_run):
    for run in (None, load_run(tiny_run)):
        with pytest.raises(InputError, match="there is no cell `"):
            find_cell(name, run)


def test_a_wrong_name_is_told_the_nearest(tiny_run):
    run = load_run(tiny_run)
    right = run.cells[-1].name
    with pytest.raises(InputError) as caught:
        find_cell(right.replace("samples", "sample"), run)
    assert f"the nearest are {right}, " in str(caught.value)
    with pytest.raises(InputError, match=r"in suite smoke or the run .*--suite$"):
        find_cell("what", run, (), "smoke")


@pytest.mark.ci
def test_repro_says_whether_the_bits_are_equal(simval, tiny_run):
    name = "attitude(geometry=3,noise_std=0.02,samples=65536)@1"
    code, out, _ = simval("repro", name, "--run", tiny_run)
    assert code == 0
    assert "equal to the bit" in out
    edited(
        tiny_run,
        "UPDATE rows SET value = value * (1 + 1e-15) "
        "WHERE family = 'bias' AND controlled = 0 AND entries = json_array('x')",
    )
    code, out, _ = simval("repro", name, "--run", tiny_run)
    assert code == 1
    assert "different: bias[x]" in out
    code, out, _ = simval(
        "repro", name, "--run", tiny_run, "--suite", "smoke"
    )  # the run comes first
    assert code == 1
    other = next(
        c.name for c in load_suite("smoke").cells if c.study == "attitude_order"
    )
    code, out, _ = simval("repro", other, "--run", tiny_run)
    assert code == 3
    assert "has no such cell" in out


@pytest.mark.ci
def test_parquet_holds_what_the_csv_holds(simval, tiny_run, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "out.parquet"
    code, out, _ = simval("export", tiny_run, "--out", path)
    assert code == 0
    assert out.splitlines()[-1] == str(path)
    table = parquet.read_table(path).to_pylist()
    with (tiny_run / "results.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(table) == len(rows)

    def key(row):
        return row["cell"], row["statistic"], row["predictor"]

    for a, b in zip(sorted(table, key=key), sorted(rows, key=key), strict=True):
        assert key(a) == key(b)
        assert repr(a["value"]) == b["value"]
        assert ("" if a["prediction"] is None else repr(a["prediction"])) == (
            b["prediction"]
        )
        assert a["noise_std"] == float(b["noise_std"])


def test_export_refuses_what_is_no_run(simval, tiny_run, tmp_path):
    assert simval("export", tmp_path)[0] == 2
    bad = tmp_path / "no" / "folder.parquet"
    pytest.importorskip("pyarrow")
    assert simval("export", tiny_run, "--out", bad)[0] == 2
