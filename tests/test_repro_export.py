"""One cell again by its name; the table as Parquet."""

import csv

import pytest
from stores import edited

from simval.errors import InputError
from simval.sweep import load_run
from simval.sweep.repro import parse_cell


def test_a_name_is_parsed_back_to_its_cell(tiny_run):
    for cell in load_run(tiny_run).cells:
        assert parse_cell(cell.name).name == cell.name
    # what is left out takes the default
    assert parse_cell("attitude()@7").seed == 7


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("attitude", "not the name of a cell"),
        ("attitude(noise_std=0.1)", "not the name of a cell"),
        ("astrology()@1", "no study `astrology`"),
        ("attitude(noise_std)@1", "key=value"),
        ("attitude(noise=0.1)@1", "not a known key"),
        ("attitude(noise_std=-1)@1", "greater than 0"),
    ],
)
def test_a_name_that_is_none_is_refused(name, words):
    with pytest.raises(InputError, match=words):
        parse_cell(name)


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
    other = name.replace("@1", "@2")
    assert simval("repro", other, "--run", tiny_run)[0] == 3


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
