"""The races by name."""

from collections.abc import Iterable

from simval.bench import (
    attitude,
    calibration,
    filters,
    gyroscope,
    noise,
    scene,
    startup,
    trials,
)
from simval.bench.race import Race
from simval.errors import InputError
from simval.text import did_you_mean

RACES: tuple[Race, ...] = (
    Race(
        name="estimators",
        title="Attitude estimates, checks included",
        item="estimates",
        contenders=attitude.estimators,
    ),
    Race(
        name="predictions",
        title="Predicted bias and covariance of one attitude cell",
        item="predictions",
        contenders=attitude.predictions,
    ),
    Race(
        name="montecarlo",
        title="Full Monte Carlo pass beside the generator's own rate",
        item="samples",
        contenders=trials.monte_carlo,
    ),
    Race(
        name="threads",
        title="Full Monte Carlo pass in threads",
        item="samples",
        contenders=trials.threads,
        clock="wall",
    ),
    Race(
        name="reductions",
        title="Precision of the covariance from 65 536 evaluations, in plain samples",
        item="plain samples",
        contenders=trials.reductions,
    ),
    Race(
        name="scene",
        title="Steps of the gimbal, eight runs together, one thread",
        item="steps",
        contenders=scene.simulation,
    ),
    Race(
        name="calibration",
        title="Calibrations of 40 poses, parameters only, tolerance 1e-12",
        item="fits",
        contenders=calibration.batch,
    ),
    Race(
        name="residuals",
        title="Calibrations by residual, a batch each",
        item="fits",
        contenders=calibration.residuals,
    ),
    Race(
        name="samples",
        title="One calibration of many samples",
        item="samples",
        contenders=calibration.samples,
    ),
    Race(
        name="allan",
        title="Overlapping Allan variances of a million rows",
        item="row averages",
        contenders=noise.allan,
    ),
    Race(
        name="gyroscope",
        title="Calibrations of a gyroscope, 39 moves of 200 samples each",
        item="fits",
        contenders=gyroscope.contenders,
    ),
    Race(
        name="filter",
        title="Attitude filters, and the bound on them, at 100 Hz",
        item="rows of a trial",
        contenders=filters.contenders,
    ),
    Race(
        name="startup",
        title="Starts of commands",
        item="starts",
        contenders=startup.starts,
        clock="children",
    ),
)


def find_races(names: Iterable[str]) -> tuple[Race, ...]:
    """Select races by name.

    Parameters
    ----------
    names : iterable of str
        Names; none means all.

    Returns
    -------
    tuple of Race
        In the order of the table.

    Raises
    ------
    InputError
        If a name is not known.
    """
    wanted, known = list(names), [race.name for race in RACES]
    unknown = [name for name in wanted if name not in known]
    if unknown:
        near = did_you_mean(unknown[0], known)
        msg = f"there is no race `{unknown[0]}`{near}; there are {', '.join(known)}"
        raise InputError(msg)
    return tuple(race for race in RACES if not wanted or race.name in wanted)
