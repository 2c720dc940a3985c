"""Each claim of a page is computed again from ``results.csv``, by plain sums.

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
    apart = (band > 1.0) & (sigmas * error > band)
    seen = (band <= 1.0) | apart
    left = seen & sure & (sigmas * error <= band) & (off > band)
    near = seen & ~left & ~apart

    def most(which):
        if not which.any():
            return 0.0, None
        place = max(np.flatnonzero(which), key=lambda i: off[i])
        return float(off[place]), known[place]

    return {
        "points": len(rows),
        "compared": len(v),
        "unseen": int((~seen).sum()),
        "apart": int(apart.sum()),
        "allowed": int(left.sum()),
        "outside": int((sigmas > within_all(len(v), 0.95)).sum()),
        "off": int((sigmas > within_all(len(v), 0.9999)).sum()),
        "within": most(near),
        "most": most(left),
        "farthest": float(sigmas.max(initial=0.0)),
    }


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
                    "apart",
                    "allowed",
                    "outside",
                    "off",
                ):
                    assert getattr(data, key) == found[key], (drawing.name, key)
                # the same sums in another order: a few ulp of a ratio near one
                assert data.within.size == pytest.approx(found["within"][0], abs=1e-14)
                assert data.most.size == pytest.approx(found["most"][0], rel=1e-12)
                assert data.farthest.size == pytest.approx(found["farthest"], rel=1e-9)
                if "less than" not in said:  # what a limit is, is its own sentence
                    assert claim.said in said
                count += 1
    return count


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


def test_findings_of_a_small_run_are_of_all_rows(tiny_run):
    assert checked(load_run(tiny_run), table(tiny_run)) > 3


@pytest.mark.parametrize(
    "seeds",
    [pytest.param(range(6), marks=pytest.mark.ci),
     pytest.param(range(6, 200), marks=pytest.mark.slow)],
    ids=["six", "two hundred"],
)  # fmt: skip
def test_findings_of_random_suites_are_of_all_rows(tmp_path, seeds):
    runs = (drawn(seed, tmp_path / "run") for seed in seeds)
    claims = sum(checked(run, written(run, tmp_path / "run")) for run in runs)
    assert claims > 3.5 * len(seeds)


@pytest.mark.ci
def test_findings_of_smoke_are_of_all_rows(smoke_run):
    assert checked(load_run(smoke_run), table(smoke_run)) > 10
