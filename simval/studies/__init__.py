"""The named experiments: what simval can be asked, one file each. Read this first.

A study wires the layers below it into one experiment:

    scene -> readings -> algorithm -> errors -> moments, beside theory's prediction

It is a module with two names:

- ``Parameters``: a pydantic model (subclass of `StudyParameters`) of one cell's
  parameters, scalars only, each with its unit in the description and a default;
- ``run(parameters, streams) -> Outcome``: a pure function of these parameters and
  of the cell's random streams (``streams.block(i)`` is the generator of block i).
  It returns rows (`simval.results.Row`) and artifacts for the report.

To add a study, write the module and add its line to `STUDIES`; suites, the command
line and the report take it by its name. A study never draws, prints or judges.
"""

from collections.abc import Mapping
from types import MappingProxyType

from simval.errors import InputError
from simval.studies import (
    attitude,
    attitude_efficiency,
    attitude_limits,
    attitude_order,
    calibration,
    calibrator,
    coverage,
    custom_scene,
    detector,
    end_to_end,
    estimator,
    ladder,
    scene,
    solvers,
)
from simval.studies.study import Study, StudyParameters

__all__ = ["STUDIES", "Study", "StudyParameters", "find_study"]

STUDIES: Mapping[str, Study] = MappingProxyType(
    {
        "scene": Study(
            "scene",
            "Scenes: is rest at rest, and do the poses suffice?",
            scene.Parameters,
            scene.run,
            scene.cost,
        ),
        "calibration": Study(
            "calibration",
            "Calibration recovery: tumble, distort, average the holds, calibrate",
            calibration.Parameters,
            calibration.run,
            calibration.cost,
        ),
        "ladder": Study(
            "ladder",
            "Bias ladder: bias, spread and efficiency of each calibration residual",
            ladder.Parameters,
            ladder.run,
            ladder.cost,
        ),
        "coverage": Study(
            "coverage",
            "Coverage: do the reported error bars of a calibration hold?",
            coverage.Parameters,
            coverage.run,
            coverage.cost,
        ),
        "solvers": Study(
            "solvers",
            "Solvers: how each method of the calibration comes to the same answer",
            solvers.Parameters,
            solvers.run,
            solvers.cost,
        ),
        "attitude": Study(
            "attitude",
            "Attitude moments: bias and covariance of the two-vector quaternion",
            attitude.Parameters,
            attitude.run,
            attitude.cost,
        ),
        "attitude_order": Study(
            "attitude_order",
            "Convergence order: how fast each attitude formula becomes exact",
            attitude_order.Parameters,
            attitude_order.run,
            attitude_order.cost,
        ),
        "attitude_efficiency": Study(
            "attitude_efficiency",
            "Efficiency: what the closed form costs beside the Cramer-Rao bound",
            attitude_efficiency.Parameters,
            attitude_efficiency.run,
            attitude_efficiency.cost,
        ),
        "attitude_limits": Study(
            "attitude_limits",
            "Limits: the noise at which each attitude formula stops to hold",
            attitude_limits.Parameters,
            attitude_limits.run,
            attitude_limits.cost,
        ),
        "detector": Study(
            "detector",
            "Static detector: scored against what the simulation knows to be at rest",
            detector.Parameters,
            detector.run,
            detector.cost,
        ),
        "end_to_end": Study(
            "end_to_end",
            "Error budget: tumble, detect, calibrate, gravity and field to attitude",
            end_to_end.Parameters,
            end_to_end.run,
            end_to_end.cost,
        ),
        "estimator": Study(
            "estimator",
            "An attitude estimator of one's own, in a process of its own",
            estimator.Parameters,
            estimator.run,
        ),
        "calibrator": Study(
            "calibrator",
            "A calibrator of one's own, in a process of its own",
            calibrator.Parameters,
            calibrator.run,
        ),
        "custom_scene": Study(
            "custom_scene",
            "A scene of one's own, in a process of its own",
            custom_scene.Parameters,
            custom_scene.run,
        ),
    }
)


def find_study(name: str) -> Study:
    """Find a study by its name.

    Parameters
    ----------
    name : str
        A key of `STUDIES`.

    Returns
    -------
    Study
        The study.

    Raises
    ------
    InputError
        If there is no such study; the message lists those there are.
    """
    if name not in STUDIES:
        msg = f"there is no study `{name}`; the studies are {', '.join(STUDIES)}"
        raise InputError(msg)
    return STUDIES[name]
