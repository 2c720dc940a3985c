"""Cells that cost nothing and leave the rows of a real one: for grids of any size."""

from dataclasses import replace
from functools import cache

from simval.results import Outcome
from simval.streams import Streams, cell_key
from simval.studies import find_study
from simval.sweep.suite import expand

NOISES, GEOMETRIES = 10, 50
"""Greatest extent of the grid for a seed; then there are more seeds."""


def suite_of(cells):
    """A grid of so many attitude cells, or a few less."""
    noises = min(NOISES, cells)
    geometries = min(GEOMETRIES, cells // noises)
    return expand(
        f"growth-{cells}",
        {
            "title": "Growth",
            "seed": list(range(1, cells // (noises * geometries) + 1)),
            "attitude": {
                "geometry": list(range(1, geometries + 1)),
                "noise_std": [0.001 * (k + 1) for k in range(noises)],
                "samples": 65_536,
            },
        },
    )


@cache
def _template():
    study = find_study("attitude")
    parameters = study.parameters.model_validate({"samples": 65_536})
    return study.run(parameters, Streams(1, cell_key("growth"))).rows


def light(cell):
    """Rows as a cell leaves them, drawn about their predictions."""
    rows = _template()
    z = cell.streams.block(0).standard_normal(len(rows)).tolist()
    return Outcome(
        rows=tuple(
            replace(row, value=row.prediction + each * row.standard_error)
            if row.prediction is not None and row.standard_error > 0.0
            else row
            for row, each in zip(rows, z, strict=True)
        )
    )
