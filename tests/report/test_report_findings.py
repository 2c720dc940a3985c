"""Each finding of a page is computed again from ``results.csv``, by plain sums.

Nothing here knows how the page draws: a claim says which study, statistics and
predictor it is about, and every row of the table that is of these must be in it.
"""

import csv
import re
from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
import small_runs

from simval.report.page import sections
from simval.sweep import load_run

COLUMNS = ("value", "standard_error", "prediction", "remainder")


def table(folder):
    with (folder / "results.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def written(run, folder):
    """The rows of a run that was made by hand, as a sweep writes them."""
    folder.mkdir(exist_ok=True)
    with (folder / "results.csv").open("w", encoding="utf-8", newline="") as file:
        out = csv.writer(file)
        out.writerow(["cell", "study", "statistic", "predictor", "check", *COLUMNS])
        for cell in run.cells:
            for r in cell.rows:
                predicted = "" if r.prediction is None else r.prediction
                numbers = r.value, r.standard_error, predicted, r.remainder
                words = cell.name, cell.study, r.statistic, r.predictor, r.check
                out.writerow([*words, *numbers])
    return table(folder)


def about(rows, claim, cells):
    """Rows that a claim is about, of all cells of its studies with this in the name."""
    studies = {cell.study for cell in claim.cells}
    what = {getattr(each, "name", None) or str(each) for each in claim.what}
    return [
        row
        for row in rows
        if row["study"] in studies
        and cells in row["cell"]
        and {row["statistic"], row["statistic"].partition("[")[0]} & what
        and claim.by in (None, row["predictor"])
    ]


def within_all(count, confidence):
    return NormalDist().inv_cdf(0.5 + 0.5 * confidence ** (1.0 / max(count, 1)))


def recomputed(rows):
    """How far values are from their predictions, from the text of the table."""
    known = [r for r in rows if r["prediction"] not in ("", "nan")]
    numbers = [[float(r[c]) for c in COLUMNS] for r in known]
    good = [n[2] != 0.0 and bool(np.isfinite(n[:3]).all()) for n in numbers]
    known = [r for r, ok in zip(known, good, strict=True) if ok]
    v, s, p, rest = np.array(numbers).reshape(-1, 4)[good].T
    off, error, room = np.abs(v / p - 1.0), s / np.abs(p), rest / np.abs(p)
    sigmas = np.zeros(len(v))
    sure = error > 0.0
    sigmas[sure] = np.maximum(off - room, 0.0)[sure] / error[sure]
    band = within_all(len(v), 0.95) * error
    seen = band <= 1.0
    left = seen & sure & (sigmas * error <= band) & (off > band)
    near = seen & ~left

    def most(which):
        if not which.any():
            return 0.0, None
        place = max(np.flatnonzero(which), key=lambda i: off[i])
        return float(off[place]), known[place]

    return {
        "points": len(rows),
        "compared": len(v),
        "unseen": int((~seen).sum()),
        "allowed": int(left.sum()),
        "outside": int((sigmas > within_all(len(v), 0.95)).sum()),
        "off": int((sigmas > within_all(len(v), 0.9999)).sum()),
        "within": most(near),
        "most": most(left),
        "farthest": float(sigmas.max(initial=0.0)),
    }


def percents(text):
    return float(text) / 100.0


def same(said, number):
    """Two digits of a share that is not rounding."""
    return said == pytest.approx(number, rel=0.051) or (number < 1e-5 and said <= 1e-5)


def named(row, words):
    """The words name the row: its entries, and how many poses its cell has."""
    entries = re.findall(r"\[(.*)\]", row["statistic"])
    poses = re.findall(r"poses=(\d+)", row["cell"])
    told = all(", ".join(each.split(",")) in words for each in entries)
    return told and (" poses" not in words or f"{poses[0]} poses" in words)


def agrees_with(sentence, found):
    """Every number of a sentence is that of the rows."""
    if found["off"]:
        (off, of) = re.search(r": (\d+) of (\d+) values?", sentence).groups()
        assert (int(off), int(of)) == (found["off"], found["compared"])
        (far,) = re.search(r"by ([\d.]+) standard errors", sentence).groups()
        assert float(far) == pytest.approx(found["farthest"], abs=0.051)
        return
    plain = found["compared"] - found["unseen"] - found["allowed"]
    told = re.search(
        r"within ([\d.]+ %|rounding) in (all|\d+ of) (\d+) values"
        r"(?: \(most: (.*?)\)(?:;|\.$))?", sentence + "."
    )  # fmt: skip
    if plain > 0 and found["compared"] > 1:
        share, count, last, most = told.groups()
        assert int(last) == found["compared"]
        assert count == ("all" if plain == found["compared"] else f"{plain} of")
        size = 0.0 if share == "rounding" else percents(share.split()[0])
        assert same(size, found["within"][0])
        assert most is None or named(found["within"][1], most)
    if found["allowed"]:
        count, share, every, of = re.search(
            r"(?:(\d+) agrees?|agrees) with [^;]* within its stated remainder, "
            r"([\d.]+) %(?:, in (all|\d+ of) (\d+) values)?", sentence
        ).groups()  # fmt: skip
        every = of if every == "all" else every and every.split()[0]
        assert int(count or every) == found["allowed"]
        assert same(percents(share), found["most"][0])
    if found["outside"] and found["compared"] > 1:  # one value says its own
        assert f"; {found['outside']} of {found['compared']} value" in sentence
    if 0 < found["unseen"] < found["compared"]:
        assert f"{found['unseen']} cannot be told from zero" in sentence


def checked(run, rows):
    """Compute all claims of a page again, and return how many there are."""
    count = 0
    for section in sections(run):
        for drawing in section.drawings:
            said = " ".join((drawing.finding, drawing.fold))
            assert not (" agrees with theory" in said and not drawing.claims), said
            for claim in drawing.claims:
                # what begins with a geometry is about it alone, else about all
                alone = re.match(r" ?Random geometry no. (\d+): ", said)
                own = about(rows, claim, f"geometry={alone[1]}," if alone else "")
                found = recomputed(own)
                data = claim.found
                for key in (
                    "points",
                    "compared",
                    "unseen",
                    "allowed",
                    "outside",
                    "off",
                ):
                    assert getattr(data, key) == found[key], (drawing.name, key)
                # the same sums in another order: a few ulp of a ratio near one
                assert data.within == pytest.approx(found["within"][0], abs=1e-14)
                assert data.most == pytest.approx(found["most"][0], rel=1e-12)
                assert data.farthest == pytest.approx(found["farthest"], rel=1e-9)
                if "less than" in said:
                    limit_is(said, own, rows)
                else:
                    assert claim.said in said
                    agrees_with(claim.said, found)
                count += 1
    return count


def limit_is(said, own, rows):
    """The greatest bias that cannot be seen, over the scatter of the same entry."""
    scatter = {
        (r["cell"], r["statistic"].partition("[")[2]): float(r["prediction"])
        for r in rows
        if r["statistic"].startswith("sd[") and r["predictor"] == "first order"
    }
    z = within_all(len(own), 0.95)
    shares, told = [], []
    for r in own:
        by = scatter[r["cell"], r["statistic"].partition("[")[2]]
        bound = abs(float(r["value"])) + z * float(r["standard_error"])
        shares.append(bound / by)
        told.append(abs(float(r["prediction"])) / by)
    most, count, theory = re.search(
        r"less than ([\d.]+) % of the scatter in all (\d+) values; "
        r"theory puts it at ([\d.]+) %",
        said,
    ).groups()
    assert int(count) == len(own)
    assert same(percents(most), max(shares))
    assert same(percents(theory), max(told))


def scattered(cell, rng):
    """A cell whose values scatter about their predictions, some of them far off."""
    rows = []
    for row in cell.rows:
        if row.prediction is not None and row.standard_error > 0.0:
            sigmas = rng.standard_normal() * rng.choice([1.0, 1.0, 1.0, 4.0])
            rest = row.standard_error * rng.choice([0.0, 0.0, 0.0, 20.0])
            error = row.standard_error * rng.choice([1.0, 1.0, 1.0, 1e3])
            value = row.prediction + sigmas * error + rest * rng.uniform(-1.0, 1.0)
            row = replace(
                row, value=float(value), standard_error=float(error), remainder=rest
            )
        rows.append(row)
    return replace(cell, rows=tuple(rows))


def drawn(seed, folder):
    """A random suite: more settings than a figure draws, or few."""
    rng = np.random.default_rng([32, 14, seed])
    poses = rng.choice(np.arange(12, 60), int(rng.integers(1, 12)), replace=False)
    noises = rng.choice(
        [0.003, 0.01, 0.02, 0.03], int(rng.integers(1, 4)), replace=False
    )
    shapes = rng.choice(np.arange(1, 20), int(rng.integers(0, 9)), replace=False)
    cells = [
        *(small_runs.calibration(float(s), int(n)) for n in poses for s in noises),
        *(small_runs.attitude(float(s), int(g)) for g in shapes for s in noises),
    ]
    cells = [scattered(cell, rng) for cell in cells]
    keep = rng.random(len(cells)) < rng.choice([0.6, 1.0])
    kept = [cell for cell, own in zip(cells, keep, strict=True) if own] or cells[:1]
    return small_runs.run_of(folder, kept)


def family(seeds, folder):
    claims = 0
    for seed in seeds:
        run = drawn(seed, folder)
        claims += checked(run, written(run, folder))
    return claims


@pytest.mark.ci
def test_findings_are_of_all_rows_of_the_table(tmp_path):
    assert family(range(6), tmp_path / "run") > 20


@pytest.mark.slow
def test_findings_of_two_hundred_random_suites_are_of_all_rows(tmp_path, monkeypatch):
    # a slope is no claim, and fitting them takes most of the time
    monkeypatch.setattr("simval.report.declared.fitted_slope", lambda *curve: None)
    assert family(range(200), tmp_path / "run") > 800


def test_findings_of_a_small_run_and_of_parts_of_it_are_of_all_rows(tiny_run):
    run, rows = load_run(tiny_run), table(tiny_run)
    assert checked(run, rows) > 3
    rng = np.random.default_rng(14)
    for _ in range(3):
        part = [cell for cell in run.cells if rng.random() < 0.6] or run.cells[:1]
        names = {cell.name for cell in part}
        own = [row for row in rows if row["cell"] in names]
        checked(replace(run, cells=tuple(part)), own)


@pytest.mark.slow
@pytest.mark.parametrize("suite", ["smoke", "reports/sample.toml"])
def test_findings_of_the_suites_are_of_all_rows(tmp_path, suite):
    from places import ROOT

    from simval import run_suite

    name = str(ROOT / suite) if suite.endswith(".toml") else suite
    run_suite(name, tmp_path / "run")
    run, rows = load_run(tmp_path / "run"), table(tmp_path / "run")
    assert checked(run, rows) > 10
