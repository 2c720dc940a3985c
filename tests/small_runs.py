"""Six small runs for the first screen of the page, from rows alone: nothing runs."""

from dataclasses import replace

import numpy as np
import rows_by_name
import side_by_side

from simval.studies import STUDIES
from simval.studies.study import Cell
from simval.sweep.run import CellResult, Run

TRIALS = 4096
MANIFEST = side_by_side.MANIFEST | {"title": "Made", "suite": "made"}


def run_of(folder, cells, **manifest):
    timing = {"wall_seconds": 1.0, "workers": 1, "cpu_seconds": 1.0}
    return Run(
        folder=folder,
        cells=tuple(cells),
        manifest=MANIFEST | {"cells": len(cells)} | manifest,
        timing=timing,
    )


def cell_of(study, rows, **parameters):
    """A finished cell of a study with these rows."""
    model = STUDIES[study].parameters(**parameters)
    cell = Cell(study, model, 1)
    return CellResult(
        name=cell.name,
        study=study,
        seed=1,
        parameters=model.model_dump(),
        status="done",
        error="",
        seconds=1.0,
        rows=tuple(rows),
    )


def row(name, predictor, prediction, off, relative, n, unit="1", check="record"):
    """A row that is `off` times its prediction, with a relative standard error."""
    return rows_by_name.row(
        name,
        prediction * off,
        unit,
        standard_error=prediction * relative,
        n=n,
        prediction=prediction,
        predictor=predictor,
        check=check,
    )


def calibration(noise, poses, off=1.002):
    """A cell of a calibration whose errors are `off` times the bound."""
    size, relative = noise / np.sqrt(poses), 1.0 / np.sqrt(6.0 * TRIALS)
    rows = []
    for letter, k, unit in (("T", 0.04, "1"), ("K", 0.026, "1"), ("B", 0.17, "m/s²")):
        for theory in ("first order", "Cramer-Rao"):
            numbers = (k * size, off, relative, TRIALS)
            rows.append(row(f"rms[{letter}]", theory, *numbers, unit=unit))
        rows.append(row(f"spread[{letter}]", "first order", *numbers, unit=unit))
        bias = (k * size**2, off, 0.5, TRIALS)
        rows.append(row(f"bias_along[{letter}]", "second order", *bias, unit=unit))
    whole = (1.0, off, relative / np.sqrt(3.0), TRIALS)
    rows.append(row("rms_over_bound", "first order", *whole))
    for entry in ("S_xy", "K_x", "K_y", "B_x"):
        unit = "m/s²" if entry == "B_x" else "1"
        numbers = (0.1 * size, off, 1.0 / np.sqrt(2.0 * TRIALS), TRIALS)
        rows.append(
            row(f"sd[{entry}]", "first order", *numbers, unit=unit, check="plain")
        )
    numbers = (9.0, off**2, np.sqrt(2.0 / 9.0 / TRIALS), TRIALS)
    rows.append(row("nees", "first order", *numbers, check="nees"))
    values = {"noise_std": noise, "poses": poses, "trials": TRIALS}
    return cell_of("calibration", rows, **values)


def attitude(noise, geometry, off=0.9999, n=4_000_000):
    """A cell of attitudes whose errors are `off` times the exact ones."""
    size = (0.9 + 0.1 * geometry) * noise
    rows = []
    for theory in ("order 2", "order 4, source", "order 4, complete", "exact"):
        check = "record" if theory == "order 4, source" else "plain"
        rows.append(row("rms", theory, size, off, 2.5e-4, n))
        for axis in "xyz":
            numbers = (size**2 / 3.0, off**2, np.sqrt(2.0 / n), n)
            name = f"covariance[{axis},{axis}]"
            rows.append(row(name, theory, *numbers, check=check))
            rows.append(row(f"bias[{axis}]", theory, size**2, 1.0, 1e-3, n))
        for name, k in (("bias_along", 1.7), ("covariance_along", 0.6)):
            rows.append(row(name, theory, k * size**2, 1.0, 1e-3, n))
        if theory != "exact":
            for part in ("bias", "covariance"):
                left = rows_by_name.row(f"left_out[{part}]", size**2, predictor=theory)
                rows.append(left)
    rows.append(row("rms_over_noise", "exact", size / noise, off, 2.5e-4, n))
    rows.append(rows_by_name.row("norm", 1.0))
    rows.append(rows_by_name.row("norm_over_noise", 1.0 / noise))
    values = {"noise_std": noise, "geometry": geometry, "samples": n}
    return cell_of("attitude", rows, **values)


def accuracy(folder):
    """Two studies over noise, and over poses and geometries."""
    return run_of(
        folder,
        [
            *(calibration(s, n) for n in (12, 40) for s in (0.003, 0.01, 0.03)),
            *(attitude(s, g) for g in (1, 3) for s in (0.005, 0.01, 0.02)),
        ],
    )


def question(folder):
    """One study over one parameter: how many poses?"""
    return run_of(folder, [calibration(0.01, n) for n in (12, 20, 40, 80)])


def own_estimator(folder):
    """A user's estimator beside two of the package's."""
    ratios = {"mine.py": 1.2, "simval:wahba": 1.01, "simval:triad": 1.1}
    cells = [
        side_by_side.cell(
            name,
            side_by_side.estimator_rows(ratio * step, 2e-3, noise),
            noise_std=noise,
        )
        for name, ratio in ratios.items()
        for noise, step in ((0.01, 1.0), (0.05, 1.1))
    ]
    return side_by_side.run_of(folder, cells)


def own_filter(folder):
    """A user's filter beside the package's, in two scenarios."""
    cells = []
    for name, ratios in (("mine.py", (2.0, 4.0)), ("simval:mekf", (1.0, 9.0))):
        for scenario, ratio in zip(
            ("gimbal slow", "magnetic disturbance"), ratios, strict=True
        ):
            numbers = (0.01, ratio, 0.05, 64)
            rows = [
                row("rms", "Cramer-Rao", *numbers, unit="rad"),
                rows_by_name.row("rms_over_bound", ratio, standard_error=0.05, n=64),
            ]
            cell = cell_of("filter", rows, scenario=scenario, seconds=8.0, trials=64)
            # by its name alone, as a run has it: no such file is read here
            values = {**cell.parameters, "algorithm": name}
            name_of_cell = f"filter(algorithm={name},scenario={scenario})@1"
            cells.append(replace(cell, name=name_of_cell, parameters=values))
    return run_of(folder, cells)


def failing(folder):
    """The first, with one standard deviation 20 standard errors too great."""

    def moved(cell):
        if cell.parameters.get("poses") != 12 or cell.parameters["noise_std"] != 0.01:
            return cell
        rows = [
            replace(r, value=r.prediction + 20.0 * r.standard_error)
            if str(r.statistic) == "sd[K_x]"
            else r
            for r in cell.rows
        ]
        return replace(cell, rows=tuple(rows))

    run = accuracy(folder)
    return replace(run, cells=tuple(map(moved, run.cells)))


def unfinished(folder):
    """The first, with no attitude cell run and one calibration crashed."""

    def ended(place, cell):
        if cell.study == "attitude":
            return replace(cell, status="pending", rows=())
        error = "Traceback\nValueError: x"
        gone = {"status": "failed", "rows": (), "error": error}
        return replace(cell, **gone) if place == 0 else cell

    run = accuracy(folder)
    cells = (ended(place, cell) for place, cell in enumerate(run.cells))
    return replace(run, cells=tuple(cells))
